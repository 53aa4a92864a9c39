"""Warpage after the release from the bed: a slow oracle of a bar, and laws that any part obeys."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from genmf_mi.core.frame import Frame
from genmf_mi.stress.fem import warpage
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.tet_mesh import TetMesh

PLA = material("pla")
STRAIN = PLA.expansion_per_k * (PLA.stress_free_celsius - 25.0)
"""By which a layer contracts."""


def bar(length: float, width: float, height: float, cells: tuple[int, int, int]) -> TetMesh:
    """A block of six tetrahedra a cube, in mm, from the origin on."""
    axes = [np.linspace(0, side, n + 1) for side, n in zip((length, width, height), cells, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(len(points)).reshape([n + 1 for n in cells])
    tetrahedra = []
    for order in permutations(range(3)):
        corner = np.zeros((4, 3), dtype=int)
        for step, axis in enumerate(order, start=1):
            corner[step] = corner[step - 1]
            corner[step, axis] += 1
        cut = [index[tuple(slice(a, a + n) for a, n in zip(c, cells, strict=True))].ravel() for c in corner]
        tetrahedra.append(np.stack(cut, axis=1))
    return TetMesh(points, np.concatenate(tetrahedra)).oriented()


def block(*half: float) -> np.ndarray:
    """Signed distance of a block about the origin, ``[33,33,33]``."""
    axis = np.linspace(-1, 1, 33)
    beyond = np.abs(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)) - half
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
    return (outside + np.minimum(beyond.max(axis=-1), 0)).astype(np.float32)


def lift(mesh: TetMesh, layers: int, settings: Settings | None = None, name: str = "pla") -> warpage.Warpage:
    motion = warpage.released(mesh, material(name), settings or Settings(), layers)
    return warpage.measured(mesh.points, motion, layers)


@pytest.fixture(scope="module")
def built() -> warpage.Warpage:
    return lift(bar(100, 10, 20, (40, 4, 10)), 10)


def test_the_ends_of_a_bar_rise(built) -> None:
    """By some hundredths of a millimetre for PLA: about half the length times the strain."""
    assert 0.25 * 100 * STRAIN < built.flatness_mm < 100 * STRAIN
    assert min(built.corners_mm) > 0.5 * built.flatness_mm
    assert np.ptp(built.corners_mm) < 0.2 * built.flatness_mm, "a bar is symmetric"


def test_one_layer_stays_flat() -> None:
    """A body that cools as a whole only shrinks; up to what the springs of the clamp hold back."""
    assert lift(bar(100, 10, 20, (20, 2, 5)), 1).flatness_mm < 0.02 * 100 * STRAIN


def test_is_proportional_to_the_contraction(built) -> None:
    protocol = replace(Settings().protocol, ambient_end_celsius=42.5)
    half = lift(bar(100, 10, 20, (40, 4, 10)), 10, Settings(protocol=protocol))
    assert half.flatness_mm == pytest.approx(built.flatness_mm / 2, rel=1e-3)


def test_abs_warps_more_than_pla(built) -> None:
    assert lift(bar(100, 10, 20, (40, 4, 10)), 10, name="abs").flatness_mm > 4 * built.flatness_mm


def test_grows_with_the_length_and_falls_with_the_height(built) -> None:
    """As measured on blocks of ABS beyond some millimetres of height (Armillotta et al., 2018)."""
    assert lift(bar(50, 10, 20, (20, 4, 10)), 10).flatness_mm < 0.8 * built.flatness_mm
    assert lift(bar(100, 10, 5, (40, 4, 10)), 10).flatness_mm > 1.3 * built.flatness_mm


def test_measured_leaves_out_rigid_motion() -> None:
    """A turned and lifted plate is flat; one corner that is bent up is found."""
    x, y = np.meshgrid(np.linspace(0, 10, 11), np.linspace(0, 8, 9), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    points = np.concatenate([points, [[5, 4, 100]]])
    motion = np.zeros_like(points)
    motion[:, 2] = 0.3 + 0.01 * points[:, 0] - 0.02 * points[:, 1]
    assert warpage.measured(points, motion, 1).flatness_mm < 1e-9
    motion[np.all(points[:, :2] == [10, 8], axis=1), 2] += 0.5
    bent = warpage.measured(points, motion, 1)
    assert np.argmax(bent.corners_mm) == 3
    assert bent.corners_mm[3] == pytest.approx(bent.flatness_mm)


def test_stress_load_is_the_virtual_work() -> None:
    """Against σ:ε of every single displacement, for a stress that is no pressure."""
    mesh = bar(3, 2, 2, (2, 1, 1))
    elements, random = P1(mesh), np.random.default_rng(0)
    stress = random.normal(size=(len(mesh.cells), 3, 3))
    stress = stress + stress.swapaxes(1, 2)
    load = elements.stress_load(stress)
    for node, axis in ((0, 0), (3, 1), (7, 2)):
        motion = np.zeros_like(mesh.points)
        motion[node, axis] = 1.0
        work = (elements.volumes[:, None, None] * stress * elements.strain(motion)).sum()
        assert load[node, axis] == pytest.approx(work)


def test_of_a_signed_distance() -> None:
    """The base is that of the build direction, and a wall thinner than a cell of the mesh has no warpage."""
    frame = Frame((0.0, 0.0, 0.0), 1.0, 100.0)
    flat = warpage.warpage(block(0.9, 0.3, 0.3), frame, Settings())
    assert flat is not None
    assert 0.02 < flat.flatness_mm < 0.2
    assert warpage.warpage(block(0.9, 0.004, 0.9), frame, Settings()) is None
