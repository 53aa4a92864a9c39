"""Files as generators write them: sign, axes, scale, weights, colours, and the lines of the documentation."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from generator_files import (
    assert_same_points,
    check_figure,
    instantmesh_mesh,
    of_instantmesh,
    of_trellis,
    trellis_mesh,
    write,
)

from genmf_mi.assets.asset import Asset
from genmf_mi.assets.generators import files, instantmesh, trellis
from genmf_mi.assets.suffixes import FIELDS
from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import AssetError
from genmf_mi.mesh import topology
from genmf_mi.sdf.flexicubes import bounded_weights


class TestInstantMesh:
    @pytest.mark.parametrize("suffix", FIELDS)
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


@pytest.fixture(scope="module")
def trellis_figure() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Arrays, and the vertices that they stand for."""
    arrays = of_trellis()
    return arrays, trellis_mesh(arrays, 64)


class TestTrellis:
    @pytest.mark.parametrize("suffix", FIELDS)
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
        assert topology.components(shape.surface()[1]).max() == 0

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
        with pytest.raises(AssetError, match="textured is not at the position of a"):
            files.load(write(tmp_path / "a.npz", of_instantmesh()), textured=self.mesh(np.eye(3), shift=0.5))


class TestDocumentedLines:
    """The lines of docs/generators.md, run with stand-ins for the generators."""

    def lines(self, word: str) -> str:
        text = (Path(__file__).parents[2] / "docs" / "generators.md").read_text(encoding="utf-8")
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
