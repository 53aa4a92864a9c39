"""How far vertices may move: cap, curvature, walls, gaps, limbs, the bed."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from toys import sphere

from genmf_mi.geometry.displacement_bounds import (
    BED_CONTACT_LIMIT,
    CURVATURE_LIMIT,
    TANGENTIAL_LIMIT,
    THIN_FEATURE_LIMIT,
    base,
    curvatures,
    displacement_bounds,
    lateral_thickness,
)


def nowhere(points: np.ndarray, _directions: np.ndarray) -> np.ndarray:
    return np.full(len(points), np.inf)


def block(width: float, height: float, depth: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A box in small triangles, centred, and its angle-weighted normals."""
    box = trimesh.creation.box([width, height, depth])
    vertices, faces = trimesh.remesh.subdivide_to_size(box.vertices, box.faces, 0.12)
    mesh = trimesh.Trimesh(vertices, faces)
    mesh.merge_vertices()
    return np.array(mesh.vertices), np.asarray(mesh.faces), np.array(mesh.vertex_normals)


def box_exit(half):
    """The distance from points in a box of the half extents ``half [3]`` to its walls, along directions."""

    def gap(points, directions):
        with np.errstate(divide="ignore", invalid="ignore"):
            walls = (np.sign(directions) * half - points) / directions
        walls[np.abs(directions) < 1e-9] = np.inf
        leaves = walls.min(axis=1)
        return np.where(leaves > 1e-9, leaves, np.inf)

    return gap


def bounds_of(*arguments):
    """Inward, outward, tangential."""
    bounds = displacement_bounds(*arguments)
    return bounds.inward, bounds.outward, bounds.tangential


def aloft(vertices, faces, normals, *rest):
    """:func:`bounds_of` a surface far above the bed."""
    lone = np.concatenate([vertices, [[0.0, -100.0, 0.0]]])
    return tuple(x[:-1] for x in bounds_of(lone, faces, np.concatenate([normals, [[0.0, -1.0, 0.0]]]), *rest))


class TestDisplacementBounds:
    def test_sphere(self):
        """Inwards it converges at the centre, outwards it opens; the cap counts where it is smaller."""
        vertices, faces, normals = sphere(4, radius=0.3)
        convex, concave = curvatures(vertices, faces, normals)
        np.testing.assert_allclose(convex, 1 / 0.3, rtol=1e-6)
        np.testing.assert_allclose(concave, 0, atol=1e-9)
        inward, outward, tangential = aloft(vertices, faces, normals, 10.0, 0.0, nowhere)
        np.testing.assert_allclose(inward, CURVATURE_LIMIT * 0.3, rtol=1e-6)
        np.testing.assert_allclose(outward, 10.0, rtol=1e-4)
        inside_out = aloft(vertices, faces[:, ::-1], -normals, 10.0, 0.0, nowhere)
        np.testing.assert_allclose(inside_out[1], CURVATURE_LIMIT * 0.3, rtol=1e-6)
        inward, outward, tangential = aloft(vertices, faces, normals, 0.05, 0.0, nowhere)
        edges = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
        assert 0 < tangential.min() <= tangential.max() <= TANGENTIAL_LIMIT * edges.max()
        for x in (inward, outward):
            assert (np.hypot(x, tangential) <= 0.05 * (1 + 1e-9)).all()
            assert (np.hypot(x, tangential) > 0.049).all()

    def test_thin_wall(self):
        """Two opposite walls may together take what exceeds the wall that must remain; outwards the cap holds."""
        vertices, faces, normals = block(1.0, 0.2, 1.0)

        def gap(points, directions):
            """Exact for the upper and lower side, far elsewhere."""
            through = (np.abs(directions[:, 1]) > 0.99) & (np.sign(directions[:, 1]) != np.sign(points[:, 1]))
            return np.where(through, 0.2, np.inf)

        middle = (np.abs(normals[:, 1]) > 0.99) & (np.abs(vertices[:, [0, 2]]).max(axis=1) < 0.3)
        middle &= vertices[:, 1] > 0  # the lower side is the base
        for wall in (0.0, 0.05, 0.15):
            inward, outward, _ = aloft(vertices, faces, normals, 0.15, wall, gap)
            assert (2 * inward[middle] <= 0.2 - wall).all()
            assert (inward[middle] > 0.4 * (0.2 - wall) * 0.98).all()
            np.testing.assert_allclose(outward[middle], 0.15, rtol=0.07)
        inward, outward, tangential = aloft(vertices, faces, normals, 0.15, 0.25, gap)
        assert (inward[middle] == 0).all() and (tangential[middle] == 0).all()
        assert (outward[middle] > 0.14).all()

    def test_narrow_gap(self):
        """Both sides of a slot may grow towards each other, and must not meet."""
        vertices, faces, normals = sphere(3)

        def gap(points, directions):
            """A tenth ahead, far elsewhere: the body is bulky."""
            return np.where(np.einsum("nk,nk->n", points, directions) > 0.99, 0.1, 5.0)

        _, outward, _ = aloft(vertices, faces, normals, 0.5, 0.0, gap)
        assert (outward > 0.02).all() and (2 * outward < 0.1).all()

    @pytest.mark.parametrize(
        ("size", "width"), [((1.0, 0.2, 0.2), 0.2), ((0.3, 2.0, 0.2), 0.3), ((1.0, 0.2, 0.8), 0.8)]
    )
    def test_lateral_thickness(self, size, width):
        """A rod is as wide as it is thick; a plate is as wide as its shorter side, however thin it is."""
        vertices, _, normals = block(*size)
        gap = box_exit(np.array(size) / 2)
        thin = np.argmin(size)
        central = np.delete(np.abs(vertices) / size, thin, axis=1).max(axis=1) < 0.1  # corners are narrower
        through = gap(vertices, -normals)
        found = lateral_thickness(vertices, normals, through, gap)[central & (np.abs(normals[:, thin]) > 0.999)]
        # Four directions: at worst the shortest way across is missed by an eighth of a turn
        assert (found >= width * (1 - 1e-6)).all() and (found <= width * 1.09).all()

    def test_limbs_keep_their_silhouette(self):
        vertices, faces, normals = block(0.2, 2.0, 0.2)
        inward, outward, _ = bounds_of(vertices, faces, normals, 0.1, 0.0, box_exit(np.array([0.1, 1.0, 0.1])))
        side = np.abs(vertices[:, 1]) < 0.5
        assert max(inward[side].max(), outward[side].max()) <= THIN_FEATURE_LIMIT * 0.2 * 1.09

    def test_a_tight_spot_limits_its_surroundings(self):
        vertices, faces, normals = sphere(3)
        near_pole = vertices[:, 1] > 0.999
        _, outward, _ = aloft(
            vertices, faces, normals, 0.5, 0.0, lambda *_: np.append(np.where(near_pole, 0.01, 1.0), 1.0)
        )
        tight = outward < 0.01
        assert 5 < tight.sum() < 50 and (vertices[tight, 1] > 0.9).all()

    def test_what_stands_on_the_bed_stays_on_it(self):
        """Of two feet neither is lifted, whatever the relief, and nothing comes to lie below them."""
        left, faces, normals = sphere(3, radius=0.3)
        right = left + np.array([1.0, 0.01, 0.0])
        vertices, normals = np.concatenate([left, right]), np.concatenate([normals, normals])
        inward, outward, _ = bounds_of(vertices, np.concatenate([faces, faces + len(left)]), normals, 0.1, 0.0, nowhere)
        lowest = vertices[:, 1].min()
        for foot in (np.arange(len(left)), len(left) + np.arange(len(right))):
            at = foot[vertices[foot, 1].argmin()]
            assert max(inward[at], outward[at]) <= BED_CONTACT_LIMIT * 0.01 * (1 + 1e-9)
        assert (vertices + outward[:, None] * normals)[:, 1].min() >= lowest
        high = vertices[:, 1] > 0
        np.testing.assert_allclose(outward[high], 0.1, rtol=0.03)

    def test_flat_base_is_pinned(self):
        vertices, faces, normals = block(1.0, 0.6, 0.8)
        standing = vertices[:, 1] == vertices[:, 1].min()
        np.testing.assert_array_equal(base(vertices, faces), np.flatnonzero(standing))
        for x in bounds_of(vertices, faces, normals, 0.05, 0.0, nowhere):
            assert (x[standing] == 0).all()
            assert (x[vertices[:, 1] > 0] > 0).all()

    def test_no_base(self):
        """A ball touches the bed in a point; a tilted block on an edge; a block with a pin stands on little."""
        vertices, faces, _ = sphere(3)
        assert len(base(vertices, faces)) == 0
        vertices, faces, _ = block(1.0, 0.6, 0.8)
        assert len(base(vertices @ trimesh.transformations.rotation_matrix(0.5, [0, 0, 1])[:3, :3].T, faces)) == 0
        pin = trimesh.creation.box([0.05, 0.1, 0.05])
        pin.apply_translation([0, -0.34, 0])
        joined = trimesh.boolean.union([trimesh.Trimesh(vertices, faces), pin])
        assert len(base(joined.vertices, joined.faces)) == 0

    def test_concave_bend_limits_outwards(self):
        """The inner corner of an angle; the outer edge limits inwards."""
        angle = trimesh.boolean.difference(
            [
                trimesh.creation.box([1, 1, 1]),
                trimesh.creation.box(
                    [0.5, 1, 2], transform=trimesh.transformations.translation_matrix([0.25, 0.25, 0])
                ),
            ]
        )
        vertices, faces = trimesh.remesh.subdivide_to_size(angle.vertices, angle.faces, 0.1, max_iter=20)
        mesh = trimesh.Trimesh(vertices, faces)
        mesh.merge_vertices()
        vertices, faces = np.array(mesh.vertices), np.asarray(mesh.faces)
        convex, concave = curvatures(vertices, faces, np.array(mesh.vertex_normals))
        ends = np.abs(vertices[:, 2]) > 0.3
        corner = np.isclose(vertices[:, 0], 0) & np.isclose(vertices[:, 1], -0.25) & ~ends
        flat = np.isclose(vertices[:, 0], -0.5) & (np.abs(vertices[:, 1]) < 0.3) & ~ends
        assert corner.sum() >= 3 and (concave[corner] > 5).all() and (convex[corner] < 1e-6).all()
        assert flat.sum() >= 3 and (concave[flat] < 1e-6).all() and (convex[flat] < 1e-6).all()
