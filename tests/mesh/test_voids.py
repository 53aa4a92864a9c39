"""A shell around a void is made solid where only a pinhole opens it, and left where there is a way in."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.mesh.solid import solidify
from genmf_mi.mesh.voids import filled


def shell(opening: float) -> trimesh.Trimesh:
    """A ball of radius 1 whose wall is 0.03 thick, with a round hole of this radius on top."""
    outer, inner = trimesh.creation.icosphere(4, radius=1.0), trimesh.creation.icosphere(4, radius=0.97)
    wall = trimesh.boolean.difference([outer, inner])
    drill = trimesh.creation.cylinder(opening, 0.5, sections=12).apply_translation([0, 0, 1])
    return trimesh.boolean.difference([wall, drill])


@pytest.mark.parametrize("opening", [0.004, 0.02])
def test_a_pinhole_is_no_opening(opening):
    mesh = shell(opening)
    vertices, faces, count = filled(np.array(mesh.vertices), np.array(mesh.faces))
    solid = trimesh.Trimesh(vertices, faces)
    assert count == 1 and solid.is_watertight
    assert mesh.volume < 0.5 < 4.0 < solid.volume < 4.19
    body = solidify("shell", np.array(mesh.vertices), np.array(mesh.faces))
    assert body.report["voids_filled"] == 1 and body.report["volume"] == pytest.approx(solid.volume, rel=1e-6)


def test_a_bowl_stays_a_bowl():
    mesh = shell(0.3)
    _, faces, count = filled(np.array(mesh.vertices), np.array(mesh.faces))
    assert count == 0 and len(faces) == len(mesh.faces)


def test_what_is_thick_is_not_looked_at():
    ball = trimesh.creation.icosphere(3)
    assert filled(np.array(ball.vertices), np.array(ball.faces))[2] == 0
