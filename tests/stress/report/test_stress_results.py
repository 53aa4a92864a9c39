"""What is computed from a simulated field: figures, the grid, the picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from genmf_mi.core.frame import HALF_EXTENT, Frame
from genmf_mi.sdf.distance import axis
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.grid import to_grid
from genmf_mi.stress.fem.materials import MATERIALS, Material, material
from genmf_mi.stress.fem.statistics import summary, weighted_percentiles
from genmf_mi.stress.fem.tetrahedra import isosurface_stuffing
from genmf_mi.stress.report import picture
from genmf_mi.stress.report.comparison import in_layer, layer_ratio


@pytest.fixture(scope="module")
def simulation() -> fem.Simulation:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    return fem.simulate(mesh.vertices * [1, 0.7, 0.8], mesh.faces, fem.Settings(edge_mm=8.0, grid=33))


def test_stress_follows_the_material(simulation: fem.Simulation) -> None:
    """σ is proportional to E; with less expansion there is less of it."""
    mesh, protocol = simulation.field.mesh, simulation.settings.protocol
    pla = material("pla")
    stiff = Material(**{**vars(pla), "youngs_modulus_mpa": 2 * pla.youngs_modulus_mpa})
    found = fem.solve(mesh, stiff, protocol)
    assert np.allclose(found.von_mises, 2 * simulation.field.von_mises, rtol=1e-3, atol=1e-5)
    assert set(MATERIALS) == {"pla", "petg", "abs", "resin"}


def test_the_sphere_cools_between_the_bounds(simulation: fem.Simulation) -> None:
    temperature = simulation.field.temperature
    assert 25.0 < temperature.min() < temperature.max() < 60.0
    numbers = summary(simulation)
    assert numbers["mesh"]["dropped_bodies"] == 0 and numbers["mesh"]["thin_fraction"] == 0.0
    assert 0.0 < numbers["surface_band"]["volume_fraction"] < 1.0


def test_grid_reproduces_a_linear_field(simulation: fem.Simulation) -> None:
    mesh, phi = simulation.mesh, simulation.phi
    field, filled = to_grid(mesh, mesh.points @ [1.0, -2.0, 3.0], phi)
    ticks = np.linspace(-1, 1, 33)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    wrong = abs(field - (x - 2 * y + 3 * z))[phi <= 0] > 1e-5
    assert wrong.sum() <= filled < 0.1 * (phi <= 0).sum()
    assert (field[phi > 0] == 0).all()


def test_the_surface_band_is_weighted_by_volume() -> None:
    """A ball of 50 mm whose stress is the depth: closed forms of the share of the band and of its mean."""
    x, y, z = np.meshgrid(axis(65), axis(65), axis(65), indexing="ij")
    frame = Frame((0.0, 0.0, 0.0), HALF_EXTENT, 100.0)
    phi = (np.sqrt(x**2 + y**2 + z**2) - HALF_EXTENT).astype(np.float32)
    mesh = isosurface_stuffing(phi, 3.0 / frame.mm_per_unit)
    elements = P1(mesh.with_points(frame.to_print(mesh.points)))
    depth = 50.0 - frame.mm_per_unit * np.linalg.norm(mesh.points[mesh.cells].mean(axis=1), axis=1)
    nodes = np.zeros(len(mesh.points))
    field = fem.Field(elements, nodes, np.zeros((len(nodes), 3)), np.zeros((len(depth), 3, 3)), depth, nodes, 0)
    band = summary(fem.Simulation(fem.Settings(), frame, phi, mesh, field, [], 0.0, {}))["surface_band"]
    radii = np.linspace(46.0, 50.0, 4001)
    assert band["volume_fraction"] == pytest.approx(1 - 0.92**3, rel=0.03)
    assert band["mean"] == pytest.approx(np.average(50.0 - radii, weights=radii**2), rel=0.03)


def test_the_layer_is_one_place_in_both(simulation: fem.Simulation) -> None:
    """The layer of a part under its own surface is its surface band, wherever in its file the other one stands."""
    share = np.average(in_layer(simulation, simulation), weights=simulation.field.elements.volumes)
    assert share == pytest.approx(summary(simulation)["surface_band"]["volume_fraction"])
    half = replace(simulation, field=replace(simulation.field, von_mises=simulation.field.von_mises / 2))
    assert layer_ratio(simulation, half) == pytest.approx(0.5)
    elsewhere = replace(half, frame=replace(half.frame, centre=(900.0, 0.0, 0.0), scale=7.0))
    assert layer_ratio(simulation, elsewhere) == pytest.approx(0.5)
    deep = replace(simulation, phi=simulation.phi - 9.0)
    assert layer_ratio(deep, simulation) is None


def test_weighted_percentiles() -> None:
    assert weighted_percentiles(np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 2.0]), (25.0, 75.0, 100.0)) == [1, 2, 3]


def test_picture_shows_the_part_in_colour(simulation: fem.Simulation, tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "stress.png"
    picture.write_picture(path, [("a ball", simulation)], "ball", pixels=80)
    image = np.asarray(Image.open(path).convert("RGB")).astype(float)
    colourful = np.ptp(image, axis=2) > 60
    assert 0.05 < colourful.mean() < 0.6


def test_two_shapes_share_one_scale(simulation: fem.Simulation, tmp_path: Path) -> None:
    """A row for each; half the stress in the second, so that only the first has the colours of the upper half."""
    from PIL import Image

    half = replace(simulation, field=replace(simulation.field, von_mises_nodes=simulation.field.von_mises_nodes / 2))
    path = tmp_path / "compare.png"
    picture.write_picture(path, [("before", simulation), ("after", half)], "two balls", pixels=80)
    sheet = np.asarray(Image.open(path).convert("RGB")).astype(float)
    views = sheet[:, : int(0.9 * sheet.shape[1])]
    colourful, red = np.ptp(views, axis=2) > 60, views[..., 0] - views[..., 1:].max(axis=2) > 60
    middle = len(views) // 2
    assert all(part.mean() > 0.05 for part in (colourful[:middle], colourful[middle:]))
    assert red[:middle].mean() > 0.01 and red[middle:].mean() < 0.001


def test_print_frame_is_upright() -> None:
    """What is up (y) in the asset is up (z) in the field."""
    frame = Frame.of(np.array([[0, 0, 0], [1, 2, 1.0]]), 100.0)
    top = frame.to_print(np.array([[0, 0.95, 0], [0, -0.95, 0]]))
    assert top[0, 2] - top[1, 2] == pytest.approx(100.0)
