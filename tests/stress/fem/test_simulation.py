"""A simulation from a surface to figures: its stages, their time and their share of the work."""

from __future__ import annotations

import time

import pytest
import trimesh

from genmf_mi.core.progress import Progress
from genmf_mi.stress.fem import elasticity, volume_mesh
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.simulation import simulate, simulate_tetrahedra
from genmf_mi.stress.fem.stages import DONE, PartialProgress
from genmf_mi.stress.fem.statistics import summary, surface_band_depth

SETTINGS = Settings(edge_mm=16.0, grid=33)
BALL = trimesh.creation.icosphere(subdivisions=2)


class Recorder(Progress):
    """Records the stages and the fractions done."""

    def __init__(self) -> None:
        self.stages: list[str] = []
        self.done: list[float] = []
        self.warnings: list[str] = []

    def stage(self, name: str) -> None:
        self.stages.append(name)

    def advance(self, done: float, total: float, values=None) -> None:
        self.done.append(done / total)

    def warn(self, message: str) -> None:
        self.warnings.append(message)


def test_seconds_are_wall_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Waiting counts, as it does everywhere else where seconds are reported."""
    original = elasticity.stress

    def slow(*arguments):
        time.sleep(0.4)
        return original(*arguments)

    monkeypatch.setattr(elasticity, "stress", slow)
    seconds = summary(simulate(BALL.vertices, BALL.faces, SETTINGS))["seconds"]
    assert list(seconds) == list(DONE)
    assert seconds["stress"] >= 0.4
    assert all(value == round(value, 3) for value in seconds.values())


def test_progress_goes_forward() -> None:
    """Every stage is reported when it begins, and the fraction done never falls; each time step of the heat counts."""
    progress = Recorder()
    simulate(BALL.vertices, BALL.faces, SETTINGS, progress=progress)
    assert progress.stages == list(DONE)
    assert progress.done == sorted(progress.done) and progress.done[-1] == DONE["stress"]
    assert sum(DONE["tetrahedra"] < done < DONE["heat"] for done in progress.done) == SETTINGS.protocol.steps - 1


def test_a_part_of_the_work() -> None:
    whole = Recorder()
    half = PartialProgress(whole, 0.5, 1.0)
    half.stage("second")
    half.advance(1, 4)
    half.warn("slow")
    assert (whole.stages, whole.done, whole.warnings) == (["second"], [0.625], ["slow"])


def test_tetrahedra_are_simulated_as_they_are(tmp_path) -> None:
    """The mesh of a simulation, in other units and written to a file, gives the same field."""
    import meshio

    first = simulate(BALL.vertices, BALL.faces, SETTINGS)
    path = tmp_path / "ball.vtu"
    meshio.Mesh(7.0 * first.mesh.points, [("tetra", first.mesh.cells)]).write(path)
    assert volume_mesh.is_volume_mesh(path) and not volume_mesh.is_volume_mesh("ball.ply")
    progress = Recorder()
    again = simulate_tetrahedra(volume_mesh.read(path), SETTINGS, progress=progress)
    assert progress.stages == [name for name in DONE if name != "tetrahedra"]
    assert again.thin_fraction == 0.0 and again.dropped == []
    # The box of the mesh is a little smaller than that of the surface, and is scaled to the same longest side.
    assert again.field.von_mises.mean() == pytest.approx(first.field.von_mises.mean(), rel=0.1)


def test_the_surface_band_in_normalised_units() -> None:
    assert surface_band_depth(100.0) == pytest.approx(0.076)
    assert surface_band_depth(50.0) == pytest.approx(0.152)
