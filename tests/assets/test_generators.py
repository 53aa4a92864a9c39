"""Files as generators write them: sign, axes, scale, weights, colours; refusals; meshes turned into Φ."""

from __future__ import annotations

import os
import pickle
import re
from itertools import permutations, product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh
from safetensors.numpy import save_file
from scipy.spatial import cKDTree

from genmf_mi.assets.asset import Asset
from genmf_mi.assets.generators import files, instantmesh, trellis
from genmf_mi.assets.generators.from_mesh import convert
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import AssetError
from genmf_mi.mesh import topology
from genmf_mi.sdf import grid
from genmf_mi.sdf.flexicubes import FlexiCubes, bounded_weights

HALF = np.array([0.2, 0.4, 0.3])
NOSE = np.array([0.1, 0.2, 0.35])


def figure(p: np.ndarray) -> np.ndarray:
    """Distance bound of a tall box with a nose in front (+z), above the middle and to the right; y up, file units."""
    q = np.abs(p) - HALF
    box = np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0)
    return np.minimum(box, np.linalg.norm(p - NOSE, axis=-1) - 0.12)


def check_figure(shape: SdfAsset, cell: float) -> None:
    """That ``shape`` is the figure: closed, in the right frame, at the right size, and its Φ about a distance."""
    vertices, faces = shape.surface()
    assert topology.is_closed(faces) and topology.volume(vertices, faces) > 0
    assert np.abs(figure(vertices)).max() < 1.5 * cell
    np.testing.assert_allclose(vertices.min(axis=0), -HALF, atol=1.5 * cell)
    np.testing.assert_allclose(vertices.max(axis=0), [0.22, 0.4, 0.47], atol=1.5 * cell)
    step = 2 / shape.resolution
    around = np.argwhere(np.abs(shape.phi) < 3 * step)
    exact = figure(shape.restore(step * around - 1)) / shape.half
    near = np.abs(exact) < 1.5 * step
    assert near.sum() > 300
    assert np.median(shape.phi[tuple(around[near].T)] / exact[near]) == pytest.approx(1, abs=0.15)


def assert_same_points(found: np.ndarray, expected: np.ndarray, atol: float) -> None:
    """That both are the same points in any order."""
    assert len(found) == len(expected)
    distance, partner = cKDTree(expected).query(found)
    assert distance.max() < atol and len(np.unique(partner)) == len(expected)


def write(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    """As a generator's user would, with the writer that the suffix asks for."""
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    elif path.suffix == ".safetensors":
        save_file({key: np.ascontiguousarray(array) for key, array in arrays.items()}, path)
    else:
        torch.save({key: torch.as_tensor(array) for key, array in arrays.items()}, path)
    return path


def of_instantmesh(n: int = 24, sign: float = -5.0, seed: int = 0) -> dict[str, np.ndarray]:
    """Raw outputs with InstantMesh's shapes: z up, the front along +x, the side of the grid 2.1, no metric scale.

    sign: -5 is a field that is positive inside.
    """
    random = np.random.default_rng(seed)
    ticks = (np.arange(n + 1) / n - 0.5) * 2.1
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    sdf = sign * figure(np.stack([y, z, x], axis=-1))
    return {
        "sdf": sdf.reshape(1, -1, 1).astype(np.float32),
        "deformation": random.standard_normal((1, (n + 1) ** 3, 3), dtype=np.float32),
        "weights": 0.1 * random.standard_normal((1, n**3, 21), dtype=np.float32),
    }


def instantmesh_mesh(arrays: dict[str, np.ndarray], n: int) -> np.ndarray:
    """Vertices as InstantMesh's application would write them: its own steps, in its own frame, then y up."""
    m = n + 1
    phi = torch.tensor(arrays["sdf"].reshape(m, m, m))
    phi = -phi if phi[0, 0, 0] < 0 else phi
    move = torch.tanh(torch.tensor(arrays["deformation"].reshape(m, m, m, 3))) / (n * 4)
    made = FlexiCubes(0.5)(phi, move / 1.05, torch.tensor(arrays["weights"][0]), training=False)
    return (made.vertices.numpy() * 1.05)[:, [1, 2, 0]]


class TestInstantMesh:
    @pytest.mark.parametrize("suffix", files.FORMATS)
    @pytest.mark.parametrize("sign", [-5.0, 5.0])
    def test_sign_axes_scale_and_weights(self, tmp_path, suffix, sign):
        """Positive inside or negative, the surface is the one that the generator would mesh, to rounding."""
        arrays = of_instantmesh(sign=sign)
        shape = files.load(write(tmp_path / f"figure{suffix}", arrays))
        assert (shape.name, shape.resolution, shape.half, shape.spread) == ("figure", 24, 1.05, 0.5)
        check_figure(shape, 2.1 / 24)
        assert_same_points(shape.surface()[0], instantmesh_mesh(arrays, 24), atol=2e-6)

    def test_full_size(self, tmp_path):
        """128 cells and the scale 2.1, as the released configuration has them."""
        arrays = of_instantmesh(128)
        shape = files.load(write(tmp_path / "figure.safetensors", arrays))
        assert shape.phi.shape == (129, 129, 129) and shape.weights.shape == (128**3, 21)
        assert np.abs(shape.deformation).max() <= 1 / (4 * 128) / 1.05
        check_figure(shape, 2.1 / 128)

    def test_sdf_alone_and_another_scale(self, tmp_path):
        arrays = {"sdf": of_instantmesh()["sdf"].reshape(25, 25, 25), "scale": np.array(4.2)}
        shape = files.load(write(tmp_path / "a.npz", arrays))
        assert shape.weights is None and shape.deformation is None and not shape.textured
        np.testing.assert_allclose(np.ptp(shape.surface()[0], axis=0), [0.84, 1.6, 1.54], atol=0.3)

    def test_half_precision(self, tmp_path):
        arrays = {key: array.astype(np.float16) for key, array in of_instantmesh().items()}
        check_figure(files.load(write(tmp_path / "a.npz", arrays)), 2.1 / 24)

    def test_colours_of_the_mesh_that_it_extracts(self, tmp_path):
        """Vertices in the generator's frame, sRGB bytes; light towards the top, which is +z there."""
        arrays = of_instantmesh()
        vertices, faces = instantmesh.build("a", **arrays).surface()
        grey = np.clip(0.5 + vertices[:, 1], 0, 1)
        colours = np.rint(255 * np.stack([grey, 0 * grey, 1 - grey], axis=1)).astype(np.uint8)
        arrays |= {"vertices": vertices[:, [2, 0, 1]], "faces": faces, "colours": colours}
        shape = files.load(write(tmp_path / "a.npz", arrays))
        assert shape.textured
        np.testing.assert_allclose(shape.closest_albedo(vertices), to_linear(colours / 255), atol=1e-3)
        del arrays["faces"]
        with pytest.raises(AssetError, match="no faces"):
            files.load(write(tmp_path / "a.npz", arrays))


def of_trellis(n: int = 64, painted: bool = True, seed: int = 0, band: float = 3) -> dict[str, np.ndarray]:
    """Sparse cubes with TRELLIS's layout: z up, the grid ± 1/2, the inside of the body unknown, the bias not yet added.

    Cubes that share a corner disagree about it by noise whose mean is zero only over all of them.
    """
    random = np.random.default_rng(seed)
    corner = np.array([[c & 1, c >> 1 & 1, c >> 2] for c in range(8)])
    ticks = (np.arange(n) + 0.5) / n - 0.5
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    coords = np.argwhere(np.abs(figure(np.stack([x, z, -y], axis=-1))) < band / n)
    place = (coords[:, None] + corner) / n - 0.5
    upright = np.stack([place[..., 0], place[..., 2], -place[..., 1]], axis=-1)
    sdf = figure(upright) + 1 / n + 0.02 / n * random.standard_normal((len(coords), 8))
    parts = [sdf, random.standard_normal((len(coords), 24)), 0.5 * random.standard_normal((len(coords), 21))]
    if painted:
        colours = np.zeros((len(coords), 8, 6))
        colours[..., 0], colours[..., 1] = 4 * upright[..., 1], -2
        parts.append(colours.reshape(len(coords), 48))
    return {"coords": coords.astype(np.int32), "feats": np.concatenate(parts, axis=1).astype(np.float32)}


def trellis_mesh(arrays: dict[str, np.ndarray], n: int) -> np.ndarray:
    """Vertices of the extractor's own steps, cube by cube, turned upright; the inside is filled beforehand."""
    m = n + 1
    total, count = np.zeros((m, m, m, 4)), np.zeros((m, m, m, 1))
    weights = np.zeros((n, n, n, 21), np.float32)
    for coord, feat in zip(arrays["coords"], arrays["feats"], strict=True):
        for c in range(8):
            at = tuple(coord + np.array([c & 1, c >> 1 & 1, c >> 2]))
            total[at] += [feat[c], *feat[8 + 3 * c : 11 + 3 * c]]
            count[at] += 1
        weights[tuple(coord)] = feat[32:53]
    mean = total / np.maximum(count, 1)
    place = np.stack(np.meshgrid(*[np.arange(m) / n - 0.5] * 3, indexing="ij"), axis=-1)
    far = figure(np.stack([place[..., 0], place[..., 2], -place[..., 1]], axis=-1))
    phi = np.where(count[..., 0] > 0, mean[..., 0] - 1 / n, np.sign(far))
    move = 0.5 / n * np.tanh(mean[..., 1:]) * 2
    made = FlexiCubes(0.99)(*(torch.tensor(x, dtype=torch.float32) for x in (phi, move)),
                            torch.tensor(weights.reshape(-1, 21)), training=False)  # fmt: skip
    vertices = made.vertices.numpy() / 2
    return np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1)


@pytest.fixture(scope="module")
def trellis_figure() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Arrays, and the vertices that they stand for."""
    arrays = of_trellis()
    return arrays, trellis_mesh(arrays, 64)


class TestTrellis:
    @pytest.mark.parametrize("suffix", files.FORMATS)
    def test_sign_axes_scale_and_weights(self, trellis_figure, tmp_path, suffix):
        arrays, vertices = trellis_figure
        shape = files.load(write(tmp_path / f"figure{suffix}", arrays | {"resolution": np.array(64)}))
        assert (shape.resolution, shape.half, shape.spread) == (64, 0.5, 0.99)
        assert shape.weights.shape == (len(arrays["coords"]), 21) and shape.report["samples_filled"] > 0
        check_figure(shape, 1 / 64)
        assert_same_points(shape.surface()[0], vertices, atol=2e-6)

    def test_hollow_structures_are_filled(self):
        """Without that, an inner wall would be meshed where the known cubes end."""
        shape = trellis.build("a", **of_trellis(painted=False), resolution=64)
        assert topology.bodies(shape.surface()[1]).max() == 0

    def test_colours(self):
        """Sigmoid of the first three of six channels; red towards the top, which is +z there."""
        shape = trellis.build("a", **of_trellis(), resolution=64)
        vertices, _ = shape.surface()
        red = 1 / (1 + np.exp(-4 * vertices[:, 1]))
        rest = np.broadcast_to([1 / (1 + np.exp(2)), 0.5], (len(red), 2))
        np.testing.assert_allclose(shape.closest_albedo(vertices), to_linear(np.column_stack([red, rest])), atol=0.02)

    def test_full_size(self, tmp_path):
        """64 · 4 cells, whole numbers with the batch in front."""
        arrays = of_trellis(256, painted=False, band=1.2)
        arrays["coords"] = np.column_stack([0 * arrays["coords"][:, 0], arrays["coords"]])
        shape = files.load(write(tmp_path / "figure.safetensors", arrays))
        assert shape.phi.shape == (257, 257, 257)
        check_figure(shape, 1 / 256)


class TestRefusals:
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"sdf": np.ones((1, 25**3, 1))}, "the level set is empty"),
            ({"sdf": -np.ones((1, 25**3, 1))}, "the level set is empty"),
            ({"sdf": np.ones((1, 999, 1))}, "no cubic grid"),
            ({"sdf": np.ones((5, 25, 8))}, "no cubic grid"),
            ({"sdf": np.ones((2, 2, 2))}, "no cubic grid"),
            ({"deformation": np.zeros((24**3, 3))}, "deformation of shape .* does not fit sdf"),
            ({"weights": np.zeros((24**3, 20))}, r"weights of shape .* must be \(13824, 21\)"),
            ({"weights": np.zeros((25**3, 21))}, "weights of shape .* does not fit sdf"),
            ({"scale": np.array(0.0)}, "scale must be positive"),
            ({"scale": np.ones(3)}, "scale must be one number"),
        ],
    )
    def test_instantmesh(self, tmp_path, change, message):
        with pytest.raises(AssetError, match=message) as caught:
            files.load(write(tmp_path / "bad.npz", of_instantmesh() | change))
        assert "bad.npz" in str(caught.value)

    @pytest.mark.parametrize("key", ["sdf", "deformation", "weights"])
    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_numbers_that_are_none(self, tmp_path, key, value):
        arrays = of_instantmesh()
        arrays[key][0, 1234, 0] = value
        with pytest.raises(AssetError, match=f"{key} has numbers that are none"):
            files.load(write(tmp_path / "bad.npz", arrays))

    def test_a_border_of_both_signs(self, tmp_path):
        ramp = np.broadcast_to(np.linspace(-1, 1, 25), (25, 25, 25))
        with pytest.raises(AssetError, match="neither side is the outside"):
            files.load(write(tmp_path / "bad.npz", {"sdf": ramp}))

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda a: a["coords"].__setitem__((0, 0), 64), "outside of a grid of 64 cells"),
            (lambda a: a["coords"].__setitem__((0, 0), -1), "outside of a grid of 64 cells"),
            (lambda a: a["coords"].__setitem__(0, a["coords"][1]), "the same cube twice"),
            (lambda a: a.update(coords=a["coords"].astype(float)), "must be whole numbers"),
            (lambda a: a.update(coords=a["coords"][:0], feats=a["feats"][:0]), "must be whole numbers"),
            (lambda a: a.update(coords=np.column_stack([np.arange(len(a["coords"])), a["coords"]])), "of one object"),
            (lambda a: a.update(feats=a["feats"][:, :52]), "53 channels"),
            (lambda a: a.update(feats=a["feats"][1:]), "53 channels"),
            (lambda a: a["feats"].__setitem__((5, 40), np.nan), "numbers that are none"),
            (lambda a: a["feats"].__setitem__((slice(None), slice(0, 8)), 1), "the level set is empty"),
            (lambda a: a.update(resolution=np.array(100_000)), "out of range"),
        ],
    )
    def test_trellis(self, tmp_path, change, message):
        arrays = of_trellis(painted=False) | {"resolution": np.array(64)}
        change(arrays)
        with pytest.raises(AssetError, match=message) as caught:
            files.load(write(tmp_path / "bad.npz", arrays))
        assert "bad.npz" in str(caught.value)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"phi": np.ones((9, 9, 8))}, "phi must be a cube"),
            ({"phi": np.ones((3, 3, 3))}, "phi must be a cube"),
            ({"phi": np.ones((9, 9, 9))}, "the level set is empty"),
            ({"phi": np.full((9, 9, 9), np.nan)}, "phi has numbers that are none"),
            ({"deformation": np.zeros((8, 8, 8, 3))}, "deformation must have the shape"),
            ({"weights": np.zeros((512, 20))}, "weights must have the shape"),
            ({"weights": np.full((512, 21), np.inf)}, "weights has numbers that are none"),
            ({"centre": np.zeros(2)}, "centre must be three numbers"),
            ({"half": np.array(np.nan)}, "half must be one number"),
        ],
    )
    def test_files_of_our_own(self, tmp_path, change, message):
        phi = np.ones((9, 9, 9), np.float32)
        phi[4, 4, 4] = -1
        with pytest.raises(AssetError, match=message) as caught:
            files.load(write(tmp_path / "bad.npz", {"phi": phi} | change))
        assert "bad.npz" in str(caught.value)

    def test_pickles_with_code_are_not_run(self, tmp_path):
        class Trap:
            def __reduce__(self):
                return os.mkdir, (str(tmp_path / "sprung"),)

        torch.save({"sdf": Trap()}, tmp_path / "a.pt")
        np.savez(tmp_path / "a.npz", sdf=np.array([Trap()], dtype=object))
        (tmp_path / "b.pt").write_bytes(pickle.dumps({"sdf": Trap()}))
        (tmp_path / "b.npz").write_bytes(pickle.dumps({"sdf": Trap()}))
        for name in ("a.pt", "a.npz", "b.pt"):
            with pytest.raises(AssetError, match=f"{name} holds pickled objects, which could run code"):
                files.load(tmp_path / name)
        with pytest.raises(AssetError, match="is no NPZ file"):
            files.load(tmp_path / "b.npz")
        assert not (tmp_path / "sprung").exists()

    @pytest.mark.parametrize("suffix", files.FORMATS)
    def test_damaged_files(self, tmp_path, suffix):
        whole = write(tmp_path / f"a{suffix}", {"sdf": np.ones(1000)})
        damaged = tmp_path / f"damaged{suffix}"
        for content in (b"", b"not a file of this kind", whole.read_bytes()[:-300]):
            damaged.write_bytes(content)
            with pytest.raises(AssetError, match="damaged"):
                files.load(damaged)

    def test_other_files(self, tmp_path):
        with pytest.raises(AssetError, match="is not there"):
            files.load(tmp_path / "a.npz")
        (tmp_path / "a.ckpt").write_bytes(b"")
        with pytest.raises(AssetError, match="unknown kind"):
            files.load(tmp_path / "a.ckpt")
        with pytest.raises(AssetError, match=r"holds planes\. It needs sdf"):
            files.load(write(tmp_path / "b.npz", {"planes": np.ones(3)}))
        torch.save(torch.ones(3), tmp_path / "c.pt")
        with pytest.raises(AssetError, match="must be a dictionary"):
            files.load(tmp_path / "c.pt")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"phi": np.ones((9, 9, 8))}, "must be a cube"),
            ({"phi": np.float32(1)}, "must be a cube"),
            ({"rows": np.zeros(512, int)}, "rows point to weights"),
            ({"phi": np.ones((9, 9, 9))}, "negative nowhere"),
            ({"phi": -np.ones((9, 9, 9))}, "negative on the border"),
            ({"deformation": np.full((9, 9, 9, 3), 0.2)}, "more than half a cell"),
            ({"deformation": np.zeros((9, 9, 9, 2))}, "deformation must have the shape"),
            ({"weights": np.zeros((511, 21))}, "weights must have the shape"),
            ({"weights": np.zeros((5, 21)), "rows": np.full(512, 5)}, "rows point to weights"),
            ({"half": -1.0}, "half positive"),
        ],
    )
    def test_in_process(self, change, message):
        phi = np.ones((9, 9, 9), np.float32)
        phi[4, 4, 4] = -1
        SdfAsset("a", phi)
        with pytest.raises(AssetError, match=message):
            SdfAsset("a", **({"phi": phi} | change))


ROTATIONS = [
    np.eye(3, dtype=int)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
]


@pytest.mark.parametrize("sparse", [False, True])
def test_turned_grids_give_the_turned_surface(sparse):
    """All rotations and mirror images of a random grid; α and β go with their corners and edges."""
    random, n = np.random.default_rng(0), 5
    phi = np.ones((n + 1, n + 1, n + 1), np.float32)
    phi[1:-1, 1:-1, 1:-1] = random.random((n - 1, n - 1, n - 1)) - 0.45
    move = 0.1 * random.standard_normal((n + 1, n + 1, n + 1, 3)).astype(np.float32)
    weights, rows = random.standard_normal((n**3, 21)).astype(np.float32), None
    if sparse:
        rows, weights = random.permutation(n**3).astype(np.int32) - 25, weights[25:]

    def vertices(phi, move, weights, rows):
        extract = FlexiCubes(0.9, None if rows is None else torch.tensor(rows))
        return extract(*map(torch.tensor, (phi, move, weights)), training=False).vertices.double().numpy()

    original = vertices(phi, move, weights, rows)
    for rotation in ROTATIONS:
        found = vertices(*grid.turned(rotation, phi, move, weights, rows))
        assert_same_points(found, original @ rotation.T, atol=3e-6)


def test_what_reaches_the_border_is_cut_off():
    ticks = np.linspace(-1, 1, 17)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    phi, report = grid.sealed(grid.outside_positive(np.maximum(np.hypot(x, y) - 0.3, z - 0.5), "rod"))
    assert report["samples_cut_off"] > 0 and report["samples_filled"] == 0
    assert topology.is_closed(SdfAsset("rod", grid.scaled(phi)).surface()[1])


class TestTexturedMesh:
    def mesh(self, rotation: np.ndarray, shift: float = 0.0) -> Asset:
        shape = instantmesh.build("a", **of_instantmesh())
        vertices, faces = shape.surface()
        return Asset.from_arrays(
            "textured", (vertices + shift) @ rotation, faces, colours=np.clip(vertices + 0.5, 0, 1)
        )

    @pytest.mark.parametrize("rotation", [np.eye(3), instantmesh.TO_Y_UP])
    def test_in_either_frame(self, tmp_path, rotation):
        shape = files.load(write(tmp_path / "a.npz", of_instantmesh()), textured=self.mesh(rotation))
        vertices, _ = shape.surface()
        np.testing.assert_allclose(shape.closest_albedo(vertices), np.clip(vertices + 0.5, 0, 1), atol=1e-4)

    def test_of_another_object(self, tmp_path):
        with pytest.raises(AssetError, match="textured is not where a is"):
            files.load(write(tmp_path / "a.npz", of_instantmesh()), textured=self.mesh(np.eye(3), shift=0.5))


@pytest.fixture(scope="module")
def converted() -> tuple[Asset, SdfAsset]:
    made = trimesh.creation.torus(2.0, 0.8, major_sections=48, minor_sections=24)
    vertices = np.array(made.vertices) + np.array([5, 6, 7])
    asset = Asset.from_arrays("ring", vertices, made.faces, colours=0.5 + 0.5 * np.sin(vertices))
    return asset, convert(asset, samples=65)


class TestConvert:
    def test_shape_and_frame(self, converted):
        asset, shape = converted
        vertices, faces = shape.surface()
        assert topology.is_closed(faces)
        cell = 2 * shape.half / 64
        np.testing.assert_allclose(vertices.min(axis=0), asset.vertices.min(axis=0), atol=cell)
        np.testing.assert_allclose(vertices.max(axis=0), asset.vertices.max(axis=0), atol=cell)
        assert topology.volume(vertices, faces) == pytest.approx(topology.volume(asset.vertices, asset.faces), rel=0.02)
        assert np.abs(shape.to_grid(vertices)).max() == pytest.approx(0.95, abs=0.01)
        assert shape.report["lost_fraction"] < 0.05

    def test_colours_are_those_of_the_mesh(self, converted):
        asset, shape = converted
        assert shape.textured and shape.coloured is asset
        vertices, _ = shape.surface()
        np.testing.assert_allclose(shape.closest_albedo(vertices), asset.closest_albedo(vertices))

    @pytest.mark.parametrize("suffix", [".npz", ".safetensors"])
    def test_written_and_read_again(self, converted, tmp_path, suffix):
        _, shape = converted
        found = files.load(files.save(shape, tmp_path / f"ring{suffix}"))
        np.testing.assert_array_equal(found.phi, shape.phi)
        np.testing.assert_allclose(found.surface()[0], shape.surface()[0], rtol=1e-6)
        points, _ = shape.surface()
        np.testing.assert_allclose(found.closest_albedo(points), shape.closest_albedo(points), atol=0.03)
        textured = files.load(tmp_path / f"ring{suffix}", textured=shape.coloured)
        np.testing.assert_allclose(textured.closest_albedo(points), shape.closest_albedo(points))

    def test_weights_are_written_too(self, tmp_path):
        shape = trellis.build("a", **of_trellis(), resolution=64)
        found = files.load(files.save(shape, tmp_path / "a.npz"))
        np.testing.assert_array_equal(found.surface()[0], shape.surface()[0])
        assert found.spread == shape.spread and found.textured

    def test_other_suffixes_are_refused(self, converted, tmp_path):
        with pytest.raises(AssetError, match="must be one of"):
            files.save(converted[1], tmp_path / "a.pt")


class TestDocumentedLines:
    """The lines of docs/generators.md, run with stand-ins for the generators."""

    def lines(self, word: str) -> str:
        text = (Path(__file__).parents[1] / "docs" / "generators.md").read_text(encoding="utf-8")
        (found,) = (block for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL) if word in block)
        return found

    def test_instantmesh(self, tmp_path):
        arrays = of_instantmesh()
        vertices, faces = instantmesh.build("a", **arrays).surface()
        outputs = tuple(torch.tensor(arrays[key]) for key in ("sdf", "deformation", "weights"))
        mesh = vertices[:, [2, 0, 1]], faces, np.full((len(vertices), 3), 200, np.uint8)
        model = SimpleNamespace(
            synthesizer=SimpleNamespace(get_geometry_prediction=lambda planes, verts, indices: outputs),
            geometry=SimpleNamespace(verts=torch.zeros(1, 3), indices=None),
            extract_mesh=lambda planes: mesh,
            grid_scale=2.1,
        )
        exec(self.lines("get_geometry_prediction"), {"model": model, "planes": 0, "np": np, "name": tmp_path / "a"})
        shape = files.load(tmp_path / "a.npz")
        check_figure(shape, 2.1 / 24)
        np.testing.assert_allclose(shape.closest_albedo(vertices[:5]), to_linear(np.full((5, 3), 200 / 255)), rtol=1e-4)

    def test_trellis(self, tmp_path):
        arrays = of_trellis(32)

        class Extractor:
            res = 32

            def __call__(self, cubes, training):
                cubes.feats[:, :8] -= 1 / self.res  # as the extractor does, in place
                return "mesh"

        decoder = SimpleNamespace(mesh_extractor=Extractor())
        cubes = SimpleNamespace(
            coords=torch.tensor(np.insert(arrays["coords"], 0, 0, axis=1)), feats=torch.tensor(arrays["feats"])
        )
        pipeline = SimpleNamespace(models={"slat_decoder_mesh": decoder})
        exec(self.lines("mesh_extractor"), {"pipeline": pipeline, "np": np, "name": tmp_path / "a"})
        assert decoder.mesh_extractor(cubes) == "mesh"
        check_figure(files.load(tmp_path / "a.npz"), 1 / 32)


def test_the_generators_ranges():
    """α, β in 1 ± 0.5 and γ in 0.25 to 0.75, as InstantMesh trains them."""
    weights = bounded_weights(torch.full((1, 21), 100.0), instantmesh.SPREAD)
    assert [float(part.max()) for part in weights] == pytest.approx([1.5, 1.5, 0.75])
