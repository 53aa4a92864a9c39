"""Distances along rays, per-vertex values as images, and the PLY files that scenes are loaded around."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from render_shapes import loaded, seamless

from genmf_mi.core.errors import OutputError
from genmf_mi.render import bridge, scene, variant
from genmf_mi.render.scene import View

VIEWS = (View(20, 10), View(150, -25))


def test_vertex_values_at_pixel_centres(tmp_path):
    """Pictures of the coordinates are points; seen from the camera they must lie at the centres of their pixels."""
    variant.use("cpu")
    vertices, faces = seamless()
    part = loaded(tmp_path, 0.9 * vertices, faces)
    bridge.render(part, VIEWS[:1], torch.tensor(vertices, dtype=torch.float32))
    pictures = [bridge.render_vertex_values(part, VIEWS, faces, coordinate) for coordinate in vertices.T]
    points = np.stack(pictures, axis=-1)
    half = np.tan(np.radians(28 / 2))
    for view, picture in zip(VIEWS, points, strict=True):
        camera = scene.camera_to_world(view, part.distance)
        rows, columns = np.nonzero(np.isfinite(picture[..., 0]))
        assert 1000 < len(rows) < 96 * 96 * 0.8
        local = (picture[rows, columns] - camera[:3, 3]) @ camera[:3, :3]  # x to the left, y up, z along the view
        x, y = 0.5 - local[:, 0] / local[:, 2] / half / 2, 0.5 - local[:, 1] / local[:, 2] / half / 2
        np.testing.assert_allclose(96 * x, columns + 0.5, atol=0.01)
        np.testing.assert_allclose(96 * y, rows + 0.5, atol=0.01)
        assert np.isnan(picture[0]).all()
        assert (np.linalg.norm(picture[rows, columns], axis=1) < np.linalg.norm(camera[:3, 3])).all()


def test_gaps_between_two_plates(tmp_path):
    """A bracket like a U: walls 0.3 thick, 0.8 apart."""
    variant.use("cpu")
    outer, inner = trimesh.creation.box([1.4, 1, 1]), trimesh.creation.box([0.8, 1, 2])
    inner.apply_translation([0, 0.3, 0])
    bracket = trimesh.boolean.difference([outer, inner])
    part = loaded(tmp_path, bracket.vertices, bracket.faces)
    points = np.array([[-0.7, 0.2, 0.1], [-0.7, 0.2, 0.1], [-0.4, 0.2, 0.1], [-0.4, 0.2, 0.1]])
    directions = np.array([[-1.0, 0, 0], [1, 0, 0], [-1, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(
        bridge.free_ray_distance(part.scene, points, directions), [np.inf, 0.3, 0.3, 0.8], rtol=1e-5
    )


def test_written_mesh_reads_back(tmp_path):
    vertices, faces = seamless()
    values = np.random.default_rng(0).random(len(vertices)).astype(np.float32)
    normals = bridge.write_ply(tmp_path / "a.ply", vertices, faces, attributes={"vertex_albedo": values})
    read = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_allclose(read.vertices, vertices, atol=1e-7)
    np.testing.assert_array_equal(read.faces, faces)
    np.testing.assert_array_equal(read.metadata["_ply_raw"]["vertex"]["data"]["albedo_0"], values)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    corners = trimesh.Trimesh(vertices, faces, process=False)
    angle_weighted = trimesh.geometry.weighted_vertex_normals(
        len(vertices), faces, corners.face_normals, corners.face_angles, use_loop=False
    )
    np.testing.assert_allclose(normals, angle_weighted, atol=2e-3)

    given = bridge.write_ply(tmp_path / "b.ply", vertices, faces, normals=-normals)
    np.testing.assert_allclose(given, -normals, atol=1e-7)
    data = trimesh.load(tmp_path / "b.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(np.column_stack([data[k] for k in ("nx", "ny", "nz")]), -normals, atol=1e-6)


def test_mesh_that_cannot_be_written(tmp_path, full_disk):
    variant.use("cpu")
    with pytest.raises(OutputError, match="nowhere"):
        bridge.write_ply(tmp_path / "nowhere" / "a.ply", *seamless())
    with full_disk(), pytest.raises(OutputError, match=r"File too large.*TMPDIR"):
        bridge.write_ply(tmp_path / "a.ply", *seamless())


def test_wall_thickness():
    """Of a box of 3 x 2 x 1, in its own unit; a single face has nothing behind it."""
    box = trimesh.creation.box([3.0, 2.0, 1.0])
    vertices, faces = np.array(box.vertices), np.array(box.faces)
    walls = bridge.wall_thickness(vertices, faces, np.arange(12))
    expected = np.abs(box.face_normals) @ [3.0, 2.0, 1.0]
    np.testing.assert_allclose(walls, expected, rtol=1e-4)
    assert bridge.wall_thickness(np.eye(3), np.array([[0, 1, 2]]), np.array([0])).tolist() == [np.inf]
