"""Meshes converted to Φ, and the files of our own that hold it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from generator_files import of_trellis

from genmf_mi.assets.asset import Asset
from genmf_mi.assets.generators import files, trellis
from genmf_mi.assets.generators.from_mesh import sdf_from_mesh
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.errors import AssetError
from genmf_mi.core.progress import Progress
from genmf_mi.mesh import measures, topology


@pytest.fixture(scope="module")
def converted() -> tuple[Asset, SdfAsset]:
    made = trimesh.creation.torus(2.0, 0.8, major_sections=48, minor_sections=24)
    vertices = np.array(made.vertices) + np.array([5, 6, 7])
    asset = Asset.from_arrays("ring", vertices, made.faces, colours=0.5 + 0.5 * np.sin(vertices))
    return asset, sdf_from_mesh(asset, samples=65)


class TestSdfFromMesh:
    def test_shape_and_frame(self, converted):
        asset, shape = converted
        vertices, faces = shape.surface()
        assert topology.is_closed(faces)
        cell = 2 * shape.half / 64
        np.testing.assert_allclose(vertices.min(axis=0), asset.vertices.min(axis=0), atol=cell)
        np.testing.assert_allclose(vertices.max(axis=0), asset.vertices.max(axis=0), atol=cell)
        assert measures.signed_volume(vertices, faces) == pytest.approx(
            measures.signed_volume(asset.vertices, asset.faces), rel=0.02
        )
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

    def test_progress_names_the_stages(self):
        class Stages(Progress):
            def __init__(self):
                self.names = []

            def stage(self, name):
                self.names.append(name)

        stages, ball = Stages(), trimesh.creation.icosphere(2)
        sdf_from_mesh(Asset.from_arrays("ball", ball.vertices, ball.faces), 17, stages)
        assert stages.names == ["making it solid", "measuring distances on 17³ samples"]
