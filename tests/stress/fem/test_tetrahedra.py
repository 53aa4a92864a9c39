"""Isosurface stuffing: conforming, well shaped, and true to the shape."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from genmf_mi.core.errors import SolidError
from genmf_mi.sdf.distance import axis, signed_distance
from genmf_mi.stress.fem import tetrahedra, volume_mesh
from genmf_mi.stress.fem.tet_mesh import FACES, TetMesh, largest_component
from genmf_mi.stress.fem.tetrahedra import isosurface_stuffing


def shapes() -> dict[str, np.ndarray]:
    ticks = axis(49)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    block = trimesh.creation.box((1.9, 1.1, 0.7))
    return {
        "ball": np.sqrt(x**2 + y**2 + z**2) - 0.83,
        "torus": np.hypot(np.hypot(x, z) - 0.6, y) - 0.27,
        "block": signed_distance(block.vertices, block.faces, 49),
        "rough": np.sqrt(x**2 + y**2 + z**2) - 0.7 + 0.08 * np.sin(9 * x) * np.sin(9 * y) * np.sin(9 * z),
    }


def dihedral_angles(mesh: TetMesh) -> np.ndarray:
    """In degrees, ``[T,6]``."""
    corner = mesh.points[mesh.cells]
    normals = []
    for a, b, c in FACES:
        n = np.cross(corner[:, b] - corner[:, a], corner[:, c] - corner[:, a])
        normals.append(n / np.linalg.norm(n, axis=1, keepdims=True))
    cosine = [-(normals[i] * normals[j]).sum(axis=1) for i in range(4) for j in range(i)]
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))).T


@pytest.mark.parametrize("name", ["ball", "torus", "block", "rough"])
@pytest.mark.parametrize("edge", [0.09, 0.137])
def test_mesh_is_sound(name: str, edge: float) -> None:
    mesh = isosurface_stuffing(shapes()[name], edge)
    assert (mesh.volumes > 0).all()
    angles = dihedral_angles(mesh)
    assert angles.min() > 10.78 and angles.max() < 164.74, "the bounds proved by Labelle & Shewchuk, table 1"
    assert mesh.quality.min() > tetrahedra.QUALITY_FLOOR

    surface = trimesh.Trimesh(mesh.points, mesh.boundary(), process=False)
    assert surface.is_watertight and surface.is_winding_consistent
    assert surface.volume == pytest.approx(mesh.volumes.sum(), rel=1e-9), "no overlaps and no gaps"


def test_volumes() -> None:
    ball = isosurface_stuffing(shapes()["ball"], 0.08).volumes.sum()
    assert ball == pytest.approx(4 / 3 * np.pi * 0.83**3, rel=0.01)
    assert isosurface_stuffing(shapes()["block"], 0.08).volumes.sum() == pytest.approx(1.9 * 1.1 * 0.7, rel=0.02)


def test_volume_is_lost_to_flat_facets_alone() -> None:
    """A facet of size h cuts h²/R off a curved surface. A vertex snapped off the surface would show in the order."""
    ticks = axis(97)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    ball = np.sqrt(x**2 + y**2 + z**2) - 0.5
    exact = 4 / 3 * np.pi * 0.5**3
    coarse, fine = (1 - isosurface_stuffing(ball, edge).volumes.sum() / exact for edge in (0.16, 0.08))
    assert 0 < fine < coarse < 0.1
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.3)


def test_other_components_are_left_out() -> None:
    ticks = axis(49)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    two = np.minimum(np.sqrt((x + 0.4) ** 2 + y**2 + z**2) - 0.45, np.sqrt((x - 0.6) ** 2 + y**2 + z**2) - 0.2)
    mesh, rest = largest_component(isosurface_stuffing(two, 0.1))
    assert len(rest) == 1 and rest[0] == pytest.approx(4 / 3 * np.pi * 0.2**3, rel=0.1)
    assert mesh.points[:, 0].max() < 0.2


def test_components_that_share_an_edge_only_are_separate() -> None:
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-2, 0, 0], [0, -2, 0]], dtype=float)
    cells = np.array([[0, 2, 3, 1], [0, 4, 5, 1]])
    mesh, rest = largest_component(TetMesh(points, cells))
    assert len(mesh.cells) == 1 and rest == pytest.approx([1 / 6])


def test_refusals(tmp_path: Path) -> None:
    phi = shapes()["ball"]
    with pytest.raises(SolidError, match="not numbers"):
        isosurface_stuffing(np.where(phi > 0.5, np.nan, phi), 0.1)
    with pytest.raises(SolidError, match="nothing is inside"):
        isosurface_stuffing(abs(phi) + 0.1, 0.1)
    (tmp_path / "broken.vtu").write_text("<VTKFile>")
    with pytest.raises(SolidError, match="cannot read"):
        volume_mesh.read(tmp_path / "broken.vtu")


def test_reading_a_volume_mesh(tmp_path: Path) -> None:
    import meshio

    mesh = isosurface_stuffing(shapes()["torus"], 0.15)
    flipped = mesh.cells.copy()
    flipped[::2] = flipped[::2][:, [0, 2, 1, 3]]
    meshio.Mesh(mesh.points, [("tetra", flipped)]).write(tmp_path / "torus.vtu")
    again = volume_mesh.read(tmp_path / "torus.vtu")
    assert (again.volumes > 0).all()
    assert again.volumes.sum() == pytest.approx(mesh.volumes.sum())

    points = mesh.points.copy()
    points[mesh.cells[0]] = points[mesh.cells[0, 0]]
    meshio.Mesh(points, [("tetra", mesh.cells)]).write(tmp_path / "flat.vtu")
    with pytest.raises(SolidError, match="zero volume"):
        volume_mesh.read(tmp_path / "flat.vtu")
    meshio.Mesh(points, [("triangle", mesh.boundary())]).write(tmp_path / "surface.vtu")
    with pytest.raises(SolidError, match="no linear tetrahedra"):
        volume_mesh.read(tmp_path / "surface.vtu")
