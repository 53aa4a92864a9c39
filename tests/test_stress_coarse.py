"""The coarse stress that the network is given: what it is, where it reaches, and who is given which."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from stress_samples import N, ball, write_samples

from genmf_mi.core.errors import ConfigError
from genmf_mi.core.frame import Frame
from genmf_mi.stress.data import reader
from genmf_mi.stress.fem import coarse
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.coarse import coarse_stress
from genmf_mi.stress.model import compute, weights
from genmf_mi.stress.model.network import Architecture, StressNetwork, to_stress, to_target
from genmf_mi.stress.model.predictor import Predictor

CELL = 2 / (N - 1)
EDGE_MM = 10.0
ASKING = Architecture(4, block_size=2, poolings=2, coarse_mm=EDGE_MM, grid=N)
SETTINGS = fem.Settings(grid=N, size_mm=80.0)


@pytest.fixture(scope="module")
def phi() -> np.ndarray:
    return ball((0.9, 0.6, 0.7))


def solved(phi: np.ndarray, edge_mm: float = EDGE_MM) -> np.ndarray:
    return coarse_stress(torch.from_numpy(phi)[None], SETTINGS, edge_mm)[0].numpy()


@pytest.fixture(scope="module")
def known(phi: np.ndarray) -> np.ndarray:
    return solved(phi)


def test_is_the_solver_on_a_coarse_mesh(phi: np.ndarray, known: np.ndarray) -> None:
    """Edges are in proportion to the part: 8 mm on one of 80 mm."""
    settings = replace(SETTINGS, edge_mm=8.0)
    simulation = fem.simulate_distance(phi, Frame((0.0, 0.0, 0.0), 1.0, 80.0), settings, fem.Laps())
    field, _ = simulation.on_grid()
    assert field[phi <= 0].mean() > 0.01
    np.testing.assert_allclose(known[phi <= 0], field[phi <= 0], rtol=1e-4)


def test_reaches_beyond_the_surface(phi: np.ndarray, known: np.ndarray) -> None:
    """Outside, each sample has the value of a sample close to the surface."""
    near = (phi > 0) & (phi < 3 * CELL)
    shell = known[(phi <= 0) & (phi > -2 * CELL)]
    assert (known[near] >= shell.min()).all() and (known[near] <= shell.max()).all()
    assert (known[phi > (coarse.BEYOND_CELLS + 0.1) * CELL] == 0).all()


def test_a_body_that_the_mesh_cannot_hold_has_none() -> None:
    x = np.linspace(-1, 1, N)[:, None, None]
    speck = (np.sqrt(x**2 + x.T**2 + x.transpose(1, 0, 2) ** 2) - 0.04).astype(np.float32)
    assert (solved(speck, 60.0) == 0).all()
    shape = torch.from_numpy(speck)[None].requires_grad_()
    coarse_stress(shape, SETTINGS, 60.0).sum().backward()
    assert not shape.grad.any()


def test_a_thin_body_has_a_finer_mesh() -> None:
    """Walls of two cells, through which a mesh of three would see."""
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
    told = float((shape.grad[0] * torch.from_numpy(change)).sum())
    step = 0.5 * CELL
    ahead, behind = (float(solved(phi + s * step * change, 5.0)[inner[0]].mean()) for s in (1, -1))
    assert told == pytest.approx((ahead - behind) / (2 * step), rel=0.12)


def test_an_untrained_network_adds_nothing_of_its_own(known: np.ndarray, phi: np.ndarray) -> None:
    """What it is given comes back; odd sides too."""
    net = StressNetwork(ASKING)
    shape, field = (torch.from_numpy(x[None, None, :, :, 2:29]) for x in (phi, known))
    assert torch.equal(net(shape, field), to_target(field))


def test_is_given_to_those_who_ask(known: np.ndarray, phi: np.ndarray) -> None:
    shape, field = (torch.from_numpy(x)[None, None] for x in (phi, known))
    with pytest.raises(ConfigError, match="coarse mesh"):
        StressNetwork(ASKING)(shape)
    with pytest.raises(ConfigError, match="coarse mesh"):
        StressNetwork(replace(ASKING, coarse_mm=0.0))(shape, field)
    net = StressNetwork(ASKING)
    torch.nn.init.normal_(net.fusion.out.weight)
    assert not torch.equal(net(shape, field) - to_target(field), net(shape, 2 * field) - to_target(2 * field))


def test_predictor_solves_for_it_or_holds_on_to_one(tmp_path: Path, known: np.ndarray, phi: np.ndarray) -> None:
    torch.manual_seed(0)
    weights.save(tmp_path / "w.safetensors", StressNetwork(ASKING), "compact", asdict(SETTINGS), {})
    judge = Predictor(tmp_path / "w.safetensors", precision="float32")
    shape, field = torch.from_numpy(phi)[None], torch.from_numpy(known)[None]
    assert torch.allclose(judge.coarse(shape), field, rtol=1e-4), "to the tolerance of the solver"
    assert torch.allclose(judge.field(shape), judge.field(shape, coarse=field), rtol=1e-3)
    assert not torch.equal(judge.field(shape), judge.field(shape, coarse=0.5 * field))
    net, _ = weights.load(tmp_path / "w.safetensors")
    told = to_stress(compute.log_stress(net, shape[None], False, field[None]))[0].clamp_min(0)
    inside = shape <= 0
    assert torch.allclose(judge.field(shape, box=(slice(0, N),) * 3)[inside], told[inside], atol=1e-6)


def test_predictor_follows_it(tmp_path: Path, phi: np.ndarray) -> None:
    """An untrained network adds nothing, so that all derivatives are those of the solver."""
    weights.save(tmp_path / "w.safetensors", StressNetwork(ASKING), "compact", asdict(SETTINGS), {})
    judge = Predictor(tmp_path / "w.safetensors", precision="float32")
    gradients = []
    for field in (judge.field, lambda shape: coarse_stress(shape, SETTINGS, EDGE_MM)):
        shape = torch.from_numpy(phi)[None].requires_grad_()
        field(shape)[shape.detach() <= 0].mean().backward()
        gradients.append(shape.grad)
    assert gradients[0].abs().max() > 0
    assert torch.allclose(*gradients, atol=1e-4 * float(gradients[1].abs().max()))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_samples(tmp_path_factory.mktemp("coarse") / "data")


def test_samples_with_it(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    solved = []

    def stand_in(phi: torch.Tensor, settings: fem.Settings, edge_mm: float) -> torch.Tensor:
        assert (settings.grid, edge_mm) == (N, EDGE_MM)
        solved.append(phi)
        return phi - 2

    monkeypatch.setattr(reader, "coarse_stress", stand_in)
    samples = reader.StressSamples(data, "train", augment=True, cache=tmp_path, coarse_mm=EDGE_MM)
    torch.manual_seed(0)
    for _ in range(4):
        for item in (1, 2):
            phi, _, known = samples.with_coarse(item)
            assert torch.allclose(known + 2, phi, atol=2e-3), "in the same symmetry"
    assert len(solved) == 2, "kept in the cache"
    assert reader.StressSamples(data, "train").with_coarse(0)[2] is None
