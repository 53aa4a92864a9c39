"""Finer triangles where they are needed: still closed, the same surface, within the budget."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from toys import sphere

from genmf_mi.mesh import measures, solid, topology
from genmf_mi.mesh.manifold import is_solid
from genmf_mi.mesh.refine import halve_edges
from genmf_mi.mesh.solid import HALVED_SHARE, Solid


class TestHalveEdges:
    @pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 1.0])
    def test_closed_and_on_the_same_surface(self, share):
        vertices, faces, _ = sphere()
        chosen = np.random.default_rng(0).random(len(faces)) < share
        fine, triangles = halve_edges(vertices, faces, chosen)
        np.testing.assert_array_equal(fine[: len(vertices)], vertices)
        assert topology.is_closed(triangles)
        assert measures.signed_volume(fine, triangles) == pytest.approx(measures.signed_volume(vertices, faces))
        assert len(triangles) >= len(faces) + 3 * chosen.sum()
        assert len(np.unique(triangles)) == len(fine)

    def test_one_face_and_its_neighbours(self):
        """One face becomes four, each of its three neighbours two."""
        vertices, faces, _ = sphere()
        fine, triangles = halve_edges(vertices, faces, np.arange(len(faces)) == 7)
        assert len(triangles) == len(faces) + 3 + 3 and len(fine) == len(vertices) + 3
        area = measures.face_areas(fine, triangles)
        assert area.sum() == pytest.approx(measures.face_areas(vertices, faces).sum())

    def test_all_faces_is_a_subdivision(self):
        vertices, faces, _ = sphere()
        _, triangles = halve_edges(vertices, faces, np.ones(len(faces), bool))
        assert len(triangles) == 4 * len(faces)
        assert np.unique(np.sort(triangles, axis=1), axis=0).shape == triangles.shape


class TestRefine:
    @staticmethod
    def ball() -> Solid:
        mesh = trimesh.creation.icosphere(4, 0.5)
        return Solid(np.array(mesh.vertices), np.array(mesh.faces, np.int64), {})

    @staticmethod
    def equator(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        return np.maximum(0.1 - np.abs(vertices[faces, 1]).min(axis=1), 0)

    def meshed(self) -> Solid:
        return solid.remesh(self.ball(), 0.02, 7_000)

    def test_small_where_it_matters(self):
        made = solid.refine(self.meshed(), self.ball(), self.equator, 20_000)
        assert is_solid(made.vertices, made.faces) and len(made.faces) <= 20_000
        size = np.sqrt(measures.face_areas(made.vertices, made.faces))
        height = np.abs(made.vertices[made.faces, 1]).max(axis=1)
        assert np.median(size[height < 0.03]) < 0.3 * np.median(size[height > 0.3])
        # The new vertices are on the ball, not on the flat triangles between the old ones
        assert np.abs(np.linalg.norm(made.vertices, axis=1) - 0.5).max() < 0.002
        report = made.report["remesh"]
        assert report["faces"] == len(made.faces) and report["finer_faces"] > 0.4 * len(made.faces)

    def test_no_finer_than_finest(self):
        meshed = self.meshed()
        edge = meshed.report["remesh"]["edge_length"]
        made = solid.refine(meshed, self.ball(), self.equator, 20_000, finest=0.9 * edge)
        np.testing.assert_array_equal(made.faces, meshed.faces)
        once = solid.refine(meshed, self.ball(), self.equator, 20_000, finest=0.4 * edge)
        assert len(meshed.faces) < len(once.faces) <= HALVED_SHARE * 20_000

    def test_nothing_matters(self):
        made = solid.refine(self.meshed(), self.ball(), lambda vertices, faces: np.zeros(len(faces)), 20_000)
        assert made.report["remesh"]["finer_faces"] == 0
