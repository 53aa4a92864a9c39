"""The adjoint of the solver against differences of the solver: node by node, and for a surface that moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from genmf_mi.stress.fem.grid import locate_points
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.problem import Field, Problem
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.fem.sensitivity import nodal_gradient, read_at, surface_gradient
from genmf_mi.stress.fem.tet_mesh import TetMesh
from genmf_mi.stress.fem.tetrahedra import isosurface_stuffing

PLA = material("pla")
SLOW = replace(Protocol(), clamp_fraction=0.1)
"""A clamp that the coarse meshes of these tests resolve."""


@pytest.fixture(scope="module")
def body() -> tuple[TetMesh, np.ndarray]:
    """A lopsided egg of 100 mm, z up, and samples of a grid inside."""
    ticks = np.linspace(-1, 1, 33)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    phi = np.sqrt((x * (1 + 0.2 * z)) ** 2 + (1.3 * y) ** 2 + z**2) - 0.85 + 0.06 * np.sin(4 * x + 2 * y)
    return isosurface_stuffing(phi, 0.3), phi


class Case:
    """A weighted sum of the field at fixed places, as a function of the nodes."""

    def __init__(self, mesh: TetMesh, phi: np.ndarray) -> None:
        self.mesh = mesh.with_points(50 * mesh.points)
        self.location = locate_points(mesh, phi)
        self.point = 50 * self.location.point
        self.weight = np.random.default_rng(0).uniform(0, 1, len(self.point)) / len(self.point)

    def solved(self, points: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> tuple[Problem, Field]:
        monkeypatch.setattr("genmf_mi.stress.fem.elasticity.TOLERANCE", 1e-11)
        monkeypatch.setattr("genmf_mi.stress.fem.heat.TOLERANCE", 1e-12)
        problem = Problem(self.mesh.with_points(points), PLA, SLOW)
        return problem, problem.solve()

    def scalar(self, points: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> float:
        _, field = self.solved(points, monkeypatch)
        corners = field.mesh.cells[self.location.cell]
        ones = np.ones((len(corners), 4, 1))
        system = np.concatenate([ones, field.mesh.points[corners]], axis=2).transpose(0, 2, 1)
        shares = np.linalg.solve(system, np.concatenate([ones[:, :1, 0], self.point], axis=1)[..., None])[..., 0]
        return float(self.weight @ (shares * field.von_mises_nodes[corners]).sum(axis=1))

    def gradient(self, monkeypatch: pytest.MonkeyPatch) -> tuple[Problem, np.ndarray]:
        problem, field = self.solved(self.mesh.points, monkeypatch)
        return problem, nodal_gradient(problem, field, read_at(self.location.cell, self.point, self.weight))


def difference(case: Case, way: np.ndarray, monkeypatch: pytest.MonkeyPatch, step: float = 1e-3) -> float:
    ahead, behind = (case.scalar(case.mesh.points + s * way, monkeypatch) for s in (step, -step))
    return (ahead - behind) / (2 * step)


def test_nodal_gradient(body, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every term counts: interpolation, stress, springs, heat."""
    case = Case(*body)
    _, gradient = case.gradient(monkeypatch)
    rng = np.random.default_rng(1)
    height = case.mesh.points[:, 2]
    low = height < height.min() + 0.1 * np.ptp(height)
    for chosen in (np.ones_like(low), low):
        for _ in range(2):
            way = rng.normal(size=gradient.shape) * chosen[:, None]
            expected = difference(case, way, monkeypatch)
            assert (gradient * way).sum() == pytest.approx(expected, rel=1e-4, abs=1e-9)


def test_surface_gradient(body, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a surface that moves, with the nodes inside as far as they are, and harmonic, between."""
    case = Case(*body)
    problem, gradient = case.gradient(monkeypatch)
    inner = np.ones(len(gradient), dtype=bool)
    inner[problem.elements.boundary] = False
    surface = surface_gradient(problem, gradient)
    assert not surface[inner].any()
    way = np.stack([np.sin(case.mesh.points[:, (i + 1) % 3] / 20 + i) for i in range(3)], axis=1)
    stiffness = problem.elements.stiffness().tocsr()
    for axis in range(3):
        load = -stiffness[inner][:, ~inner] @ way[~inner, axis]
        way[inner, axis] = np.linalg.solve(stiffness[inner][:, inner].toarray(), load)
    assert (surface * way).sum() == pytest.approx(difference(case, way, monkeypatch), rel=1e-3)
