"""Soft edges of masks against distances that an oracle finds by relaxing edges until nothing changes."""

from __future__ import annotations

import numpy as np
from toys import sphere

from genmf_mi.geometry.fade import faded

WIDTH = 0.4


def relaxed(values, vertices, faces, width):
    """Bellman and Ford: no vertex is higher than a neighbour by more than their distance allows."""
    result = values.astype(np.float64).copy()
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.concatenate([ends, ends[:, ::-1]])
    rise = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1) / width
    while True:
        lower = result.copy()
        np.minimum.at(lower, ends[:, 1], result[ends[:, 0]] + rise)
        if np.allclose(lower, result, atol=1e-14):
            return result
        result = lower


def test_as_the_oracle():
    vertices, faces, _ = sphere(3)
    values = np.random.default_rng(0).uniform(0, 3, len(vertices))
    values[vertices[:, 0] > 0.3] = 0
    ours = faded(values, vertices, faces, WIDTH)
    np.testing.assert_allclose(ours, relaxed(values, vertices, faces, WIDTH), atol=1e-9)
    assert (ours[vertices[:, 0] > 0.3] == 0).all(), "exactly"


def test_grows_to_one_within_the_width():
    vertices, faces, _ = sphere(5)
    black = vertices[:, 2] < 0
    ours = faded(np.where(black, 0.0, 1.0), vertices, faces, WIDTH)
    height = np.arcsin(np.clip(vertices[:, 2], -1, 1))
    assert (ours[height > WIDTH] == 1).all() and (ours[black] == 0).all()
    between = (height > 0.05) & (height < WIDTH)
    share = ours[between] / (height[between] / WIDTH)
    # Along edges it is somewhat farther, and the last black vertex is up to an edge below the outline
    assert share.min() > 0.95 and share.max() < 1.7 and share.mean() < 1.3


def test_what_rises_slowly_stays():
    vertices, faces, _ = sphere(3)
    slow = 0.5 + 0.5 * vertices[:, 1]
    np.testing.assert_allclose(faded(slow, vertices, faces, 1.9), slow, rtol=1e-12)


def test_the_other_side_of_a_thin_wall_is_far_away():
    """A plate: its rim is farther than the width, its back closer."""
    import trimesh

    plate = trimesh.creation.box((10, 10, 0.2)).subdivide_to_size(0.7)
    vertices, faces = np.array(plate.vertices), np.array(plate.faces)
    black = (np.abs(vertices[:, :2]) < 1).all(axis=1) & (vertices[:, 2] > 0)
    ours = faded(np.where(black, 0.0, 1.0), vertices, faces, 2.0)
    assert black.sum() > 5 and (ours[vertices[:, 2] < 0] == 1).all()
