"""Scenes around Φ: the same image as the extracted mesh gives."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion
from torch.nn.functional import normalize

from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.errors import OutputError, SceneError
from genmf_mi.core.frame import Frame
from genmf_mi.render import bridge, scene, sdf_scene, variant
from genmf_mi.render.scene import GRID, View

CENTRE, HALF = (5.0, 6.0, 7.0), 3.0
VIEWS = (View(0, 20), View(110, -30), View(215, 60))


def blob(m: int = 65) -> np.ndarray:
    """Φ ``[m,m,m]`` of a ball with one bump each to the right, above and in front, of different sizes, off the middle;
    the four are blended, so that the normal has no jumps."""
    ticks = np.linspace(-1, 1, m)
    p = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1) - (0.1, -0.15, 0.05)
    balls = (((0, 0, 0), 0.4), ((0.45, 0, 0), 0.2), ((0, 0.5, 0.1), 0.25), ((-0.1, 0.1, 0.45), 0.15))
    distances = [np.linalg.norm(p - np.array(c), axis=-1) - r for c, r in balls]
    return (-np.log(sum(np.exp(-d / 0.05) for d in distances)) * 0.05).astype(np.float32)


def shown_as_both(folder: Path, m: int) -> SimpleNamespace:
    """The blob on a grid of ``m`` samples, as a mesh and as that grid."""
    variant.use("cpu")
    shape = SdfAsset("blob", blob(m), centre=CENTRE, half=HALF)
    vertices, faces = shape.surface()
    frame = Frame.of(vertices, size_mm=1.0)
    vertices = frame.normalise(vertices)
    bridge.write_ply(folder / "blob.ply", vertices, faces)
    options = {"radius": float(np.linalg.norm(vertices, axis=1).max()), "resolution": 128, "samples": 16}
    grid = sdf_scene.write_grid(shape, folder / "blob.vol")
    part = scene.load(scene.find("strawberry", GRID), grid, holds=GRID, **options, **sdf_scene.placement(shape, frame))
    mesh = scene.load(scene.find("strawberry"), folder / "blob.ply", **options)
    return SimpleNamespace(shape=shape, frame=frame, grid=grid, options=options,
                           seen=bridge.render(mesh, VIEWS), found=bridge.render(part, VIEWS))  # fmt: skip


@pytest.fixture(scope="module")
def shown(tmp_path_factory) -> SimpleNamespace:
    return shown_as_both(tmp_path_factory.mktemp("blob"), 65)


def disagreement(shown: SimpleNamespace) -> dict[str, float]:
    """Mean differences: of coverage everywhere, of the others (the normal in degrees) where pixels are full."""
    seen, found = shown.seen, shown.found
    inner = np.stack([binary_erosion(mask > 0.999, iterations=2) for mask in seen.coverage[:, 0].numpy()])[:, None]
    assert inner.sum() > 10_000
    assert (found.coverage[inner] > 0.999).all(), "rays slip through"
    cosine = (normalize(seen.normal) * normalize(found.normal)).sum(dim=1, keepdim=True)[inner]
    return {
        "coverage": float((seen.coverage - found.coverage).abs().mean()),
        "depth": float((seen.depth - found.depth).abs()[inner].mean()),
        "grey": float((seen.grey - found.grey).abs()[inner].mean()),
        "normal": float(np.degrees(np.arccos(cosine.clamp(-1, 1).numpy())).mean()),
    }


class TestPicture:
    def test_agrees_with_the_mesh(self, shown, tmp_path):
        """At 65 samples outlines to 0.15 % of the picture, depth to 5 % of a cell, grey to 0.004, normals to 1°; with
        half as many samples three times as much, as dual vertices lie inside of bulges by the square of a cell."""
        fine, coarse = disagreement(shown), disagreement(shown_as_both(tmp_path, 33))
        cell = 2 * shown.shape.half * shown.frame.scale / shown.shape.resolution
        assert fine["coverage"] < 1.5e-3 and fine["depth"] < 0.05 * cell
        assert fine["grey"] < 4e-3 and fine["normal"] < 1
        assert 3 * fine["coverage"] < coarse["coverage"] and 3 * fine["depth"] < coarse["depth"]

    @pytest.mark.parametrize("axes", [(2, 1, 0), (1, 0, 2), (0, 2, 1)])
    def test_any_other_order_of_the_axes_would_show(self, shown, axes, tmp_path):
        turned = SdfAsset("turned", np.ascontiguousarray(shown.shape.phi.transpose(axes)), centre=CENTRE, half=HALF)
        grid = sdf_scene.write_grid(turned, tmp_path / "turned.vol")
        placement = sdf_scene.placement(turned, shown.frame)
        part = scene.load(scene.find("default", GRID), grid, holds=GRID, **shown.options, **placement)
        assert (bridge.render(part, VIEWS).coverage - shown.seen.coverage).abs().mean() > 0.02

    def test_from_plain_mitsuba(self, shown):
        """The file's own camera and defaults: the grid is the cube ± 1."""
        import mitsuba as mi

        path = str(scene.find("strawberry", GRID))
        plain = mi.load_file(path, grid=str(shown.grid), azimuth="30", elevation="10", resolution="64")
        image = np.array(mi.render(plain))
        options = {"radius": 4.3 * np.sin(np.radians(14)) / scene.MARGIN, "resolution": 64, "samples": 4}
        placement = sdf_scene.placement(SdfAsset("blob", blob()), Frame((0, 0, 0), 1.0, 1.0))
        same = scene.load(path, shown.grid, holds=GRID, **options, **placement)
        np.testing.assert_allclose(image[..., 0], bridge.render(same, [View(30, 10)]).grey[0, 0], atol=1e-4)
        assert image[..., 5].max() == pytest.approx(1)

    def test_documented_lines(self, shown, tmp_path, monkeypatch):
        text = (Path(__file__).parents[2] / "docs" / "generators.md").read_text(encoding="utf-8")
        (lines,) = (b for b in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL) if "mi.load_file" in b)
        monkeypatch.chdir(tmp_path)
        Path("bus.vol").write_bytes(shown.grid.read_bytes())
        names = {}
        exec(lines, names)
        assert names["image"].shape == (384, 384, 6) and np.array(names["image"])[..., 5].max() == pytest.approx(1)

    def test_a_mesh_scene_holds_no_grid(self, shown):
        with pytest.raises(SceneError, match=r'strawberry.xml has no <default name="grid" .* no grid can be put in'):
            scene.load(scene.find("strawberry"), shown.grid, radius=1.0, holds=GRID)
        with pytest.raises(SceneError, match=r'strawberry_sdf.xml has no <default name="mesh"'):
            scene.load(scene.find("strawberry", GRID), shown.grid, radius=1.0)

    def test_no_space(self, shown, full_disk, tmp_path):
        with pytest.raises(OutputError, match=r"blob\.vol"), full_disk():
            sdf_scene.write_grid(shown.shape, tmp_path / "blob.vol")
        assert not list(tmp_path.iterdir())
