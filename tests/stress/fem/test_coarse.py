"""The coarse stress: the solver's field on a coarse mesh, where it reaches, and its derivative."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from genmf_mi.core.frame import Frame
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.stress.fem import coarse
from genmf_mi.stress.fem.coarse import coarse_stress
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.simulation import simulate_distance

N = 33
CELL = 2 / (N - 1)
EDGE_MM = 10.0
SETTINGS = Settings(grid=N, size_mm=80.0)


@pytest.fixture(scope="module")
def phi() -> np.ndarray:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    return signed_distance(mesh.vertices * [0.9, 0.6, 0.7], mesh.faces, N)


def solved(phi: np.ndarray, edge_mm: float = EDGE_MM) -> np.ndarray:
    return coarse_stress(torch.from_numpy(phi)[None], SETTINGS, edge_mm)[0].numpy()


@pytest.fixture(scope="module")
def expected(phi: np.ndarray) -> np.ndarray:
    return solved(phi)


def test_is_the_solver_on_a_coarse_mesh(phi: np.ndarray, expected: np.ndarray) -> None:
    """Edges are in proportion to the part: 8 mm on one of 80 mm."""
    settings = replace(SETTINGS, edge_mm=8.0)
    simulation = simulate_distance(phi, Frame((0.0, 0.0, 0.0), 1.0, 80.0), settings)
    field, _ = simulation.on_grid()
    assert field[phi <= 0].mean() > 0.01
    np.testing.assert_allclose(expected[phi <= 0], field[phi <= 0], rtol=1e-4)


def test_reaches_beyond_the_surface(phi: np.ndarray, expected: np.ndarray) -> None:
    """Outside, each sample has the value of a sample close to the surface."""
    near = (phi > 0) & (phi < 3 * CELL)
    shell = expected[(phi <= 0) & (phi > -2 * CELL)]
    assert (expected[near] >= shell.min()).all() and (expected[near] <= shell.max()).all()
    assert (expected[phi > (coarse.BEYOND_CELLS + 0.1) * CELL] == 0).all()


def test_a_body_that_the_mesh_cannot_hold_has_none() -> None:
    x = np.linspace(-1, 1, N)[:, None, None]
    speck = (np.sqrt(x**2 + x.T**2 + x.transpose(1, 0, 2) ** 2) - 0.04).astype(np.float32)
    assert (solved(speck, 60.0) == 0).all()
    shape = torch.from_numpy(speck)[None].requires_grad_()
    coarse_stress(shape, SETTINGS, 60.0).sum().backward()
    assert not shape.grad.any()


def test_a_thin_body_has_a_finer_mesh() -> None:
    """Walls of two cells, through which a mesh of three cells would fall."""
    ticks = np.linspace(-1, 1, N)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    ball = np.sqrt(x**2 + y**2 + z**2) - 0.8
    shell = np.maximum(ball, -ball - 2 * CELL).astype(np.float32)
    thick, thin = (coarse.CoarseBody(body, SETTINGS, 10.0) for body in (ball.astype(np.float32), shell))
    assert thin.edge < thick.edge == pytest.approx(10 * 0.8 / thick.mm)
    volume = 4 / 3 * np.pi * (0.8**3 - (0.8 - 2 * CELL) ** 3)
    assert thin.mesh.volumes.sum() == pytest.approx(volume, rel=0.12)


CHANGES = {
    "everywhere": lambda x, y, z: np.ones_like(x),
    "at one side": lambda x, y, z: np.sin(2 * x + 0.5),
    "at the top": lambda x, y, z: np.clip(y, 0, 1),
}


@pytest.mark.parametrize("name", CHANGES)
def test_derivative_against_other_meshes(phi: np.ndarray, name: str) -> None:
    """A surface that moves by half a cell, its nodes along or all of it meshed anew: the mean stress of a fixed inner
    region changes alike, as far as the one mesh and the other agree (some per cent of the change)."""
    ticks = np.linspace(-1, 1, N)
    change = CHANGES[name](*np.meshgrid(ticks, ticks, ticks, indexing="ij")).astype(np.float32)
    inner = torch.from_numpy(phi < -3 * CELL)[None]
    shape = torch.from_numpy(phi)[None].requires_grad_()
    coarse_stress(shape, SETTINGS, 5.0)[inner].mean().backward()
    predicted = float((shape.grad[0] * torch.from_numpy(change)).sum())
    step = 0.5 * CELL
    ahead, behind = (float(solved(phi + s * step * change, 5.0)[inner[0]].mean()) for s in (1, -1))
    assert predicted == pytest.approx((ahead - behind) / (2 * step), rel=0.12)
