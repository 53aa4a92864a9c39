"""Relief is taken back where the surface would cut through itself, and nowhere else."""

from __future__ import annotations

import numpy as np
from toys import noise, sphere

from genmf_mi.geometry.back_off import back_off
from genmf_mi.mesh.self_intersections import self_intersections


class TestBackOff:
    @staticmethod
    def folded(vertices: np.ndarray, normals: np.ndarray, seed: int) -> np.ndarray:
        """Smooth relief, and a patch of a dozen vertices that are thrown about by more than an edge length."""
        offsets = 0.02 * np.sin(5 * vertices[:, :1]) * normals
        patch = np.linalg.norm(vertices - vertices[seed], axis=1) < 0.15
        return offsets + patch[:, None] * 0.1 * noise(len(vertices), 3)

    def test_a_folded_patch(self):
        vertices, faces, normals = sphere(4)
        offsets = self.folded(vertices, normals, 100)
        first = len(self_intersections(vertices + offsets, faces))
        assert first > 0
        result, report = back_off(vertices, faces, offsets, self_intersections)
        assert len(self_intersections(vertices + result, faces)) == 0
        assert report["self_intersections_before"] == 0 and report["untangled"] == first
        changed = (result != offsets).any(axis=1)
        assert report["vertices_held_back"] == changed.sum() > 0
        assert changed.mean() < 0.1 and changed[100]
        share = (result * offsets).sum(axis=1) / np.maximum((offsets**2).sum(axis=1), 1e-20)
        np.testing.assert_allclose(result, share[:, None] * offsets, atol=1e-9)
        assert share.min() >= 0 and share.max() <= 1 + 1e-9

    def test_what_crossed_before_may_cross_still(self):
        """An asset's own defect is left as it is, and costs the relief elsewhere nothing."""
        vertices, faces, normals = sphere(4)
        vertices = vertices + self.folded(vertices, normals, 100)
        before = len(self_intersections(vertices, faces))
        offsets = self.folded(vertices, normals, 900)
        result, report = back_off(vertices, faces, offsets, self_intersections)
        assert report["self_intersections_before"] == before > 0
        assert len(self_intersections(vertices + result, faces)) <= before
        assert (result == offsets).all(axis=1).mean() > 0.8

    def test_sound_relief_is_left_alone(self):
        vertices, faces, normals = sphere(3)
        offsets = 0.02 * np.sin(5 * vertices[:, :1]) * normals
        result, report = back_off(vertices, faces, offsets, self_intersections)
        np.testing.assert_array_equal(result, offsets)
        assert report == {
            "self_intersections_before": 0, "untangled": 0, "vertices_held_back": 0, "relief_backed_off": 0
        }  # fmt: skip

    def test_a_spot_that_does_not_give_way_costs_its_surroundings_only(self):
        """Far more rounds than relief is halved in, and yet the relief on the other side stays."""
        vertices, faces, normals = sphere(4)
        near = np.linalg.norm(vertices - vertices[0], axis=1) < 0.5

        def stubborn(points, _faces):
            """Faces about vertex 0, as long as there is any relief near it."""
            moved = np.abs(points - vertices)[near].max() > 1e-9
            return np.flatnonzero((faces == 0).any(axis=1)) if moved else np.empty(0, np.int64)

        offsets = 0.1 * normals
        result, report = back_off(vertices, faces, offsets, stubborn)
        assert np.abs(result[near]).max() == 0
        far = vertices @ vertices[0] < -0.5
        np.testing.assert_array_equal(result[far], offsets[far])
        assert 0.05 < report["relief_backed_off"] < 0.8
        assert report["vertices_held_back"] == (result != offsets).any(axis=1).sum()

    def test_without_end_to_intersections_the_initial_surface_is_left(self):
        """Rather no relief than a part that cuts through itself; the report says so."""
        vertices, faces, normals = sphere(2)

        def stubborn(points, _faces):
            return np.arange(3) if np.abs(points - vertices).max() > 1e-9 else np.empty(0, np.int64)

        result, report = back_off(vertices, faces, 0.1 * normals, stubborn)
        assert np.abs(result).max() == 0
        assert report["relief_backed_off"] == 1
