"""STL: text as programs write it, several solids, truncated files, and colours per face."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.assets import asset
from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import AssetError


def text(name: str, mesh: trimesh.Trimesh) -> str:
    rows = [f"solid {name}"]
    for corners in mesh.triangles:
        rows += ["facet normal 0 0 0", " outer loop", *("  vertex {} {} {}".format(*p) for p in corners), " endloop"]
        rows += ["endfacet"]
    return "\n".join([*rows, f"endsolid {name}", ""])


def binary(mesh: trimesh.Trimesh, attribute: np.ndarray, header: bytes = b"") -> bytes:
    row = np.zeros(len(mesh.faces), np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]))
    row["c"], row["a"] = mesh.triangles, attribute
    return header.ljust(80, b"\0")[:80] + np.uint32(len(row)).tobytes() + row.tobytes()


BALL = trimesh.creation.icosphere(2)
DARK = BALL.triangles_center[:, 2] > 0


def written(path, content: str | bytes) -> asset.Asset:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return asset.load(path)


class TestText:
    @pytest.mark.parametrize("change", [str, str.upper, lambda s: s.replace("\n", "\r\n"), lambda s: "\n  " + s])
    def test_as_programs_write_it(self, tmp_path, change):
        found = written(tmp_path / "a.stl", change(text("ball", BALL)))
        assert len(found.faces) == len(BALL.faces)
        np.testing.assert_allclose(np.ptp(found.vertices, axis=0), [2, 2, 2], atol=0.2)

    def test_several_solids_are_all_read(self, tmp_path):
        other = BALL.copy().apply_translation([5, 0, 0])
        found = written(tmp_path / "a.stl", text("one", BALL) + text("two", other))
        assert len(found.faces) == 2 * len(BALL.faces) and np.ptp(found.vertices[:, 0]) == pytest.approx(7)

    @pytest.mark.parametrize("keep", [0.3, 0.77, 0.995])
    def test_truncated(self, tmp_path, keep):
        whole = text("ball", BALL)
        with pytest.raises(AssetError, match="truncated"):
            written(tmp_path / "a.stl", whole[: int(keep * len(whole))])

    def test_not_numbers(self, tmp_path):
        with pytest.raises(AssetError, match="not numbers"):
            written(tmp_path / "a.stl", text("ball", BALL).replace("1.0", "one", 1))


class TestBinary:
    def test_a_header_that_says_solid(self, tmp_path):
        found = written(tmp_path / "a.stl", binary(BALL, np.zeros(len(DARK)), b"solid of a clumsy program"))
        assert len(found.faces) == len(BALL.faces) and not found.textured

    def test_magics_colours(self, tmp_path):
        """Red lowest; a face with the highest bit has the colour of the part."""
        attribute = np.where(DARK, 31 | 10 << 5 | 0 << 10, 1 << 15)
        found = written(tmp_path / "a.stl", binary(BALL, attribute, b"COLOR=\x40\x80\xc0\xff"))
        rgb = found.albedo_at(np.arange(len(DARK)), np.full((len(DARK), 3), 1 / 3))
        np.testing.assert_allclose(
            rgb[DARK], np.tile(to_linear(np.array([255, 82, 0]) / 255), (DARK.sum(), 1)), atol=5e-3
        )
        part = to_linear(np.array([0x40, 0x80, 0xC0]) / 255)
        np.testing.assert_allclose(rgb[~DARK], np.tile(part, ((~DARK).sum(), 1)), atol=5e-3)

    def test_viscam_colours(self, tmp_path):
        """Blue lowest; only faces with the highest bit have a colour."""
        attribute = np.where(DARK, 1 << 15 | 31 << 10 | 10 << 5 | 0, 7)
        found = written(tmp_path / "a.stl", binary(BALL, attribute))
        rgb = found.albedo_at(np.arange(len(DARK)), np.full((len(DARK), 3), 1 / 3))
        np.testing.assert_allclose(
            rgb[DARK][:, :2], np.tile(to_linear(np.array([255, 82]) / 255), (DARK.sum(), 1)), atol=5e-3
        )
        np.testing.assert_allclose(rgb[~DARK], 1)

    def test_numbers_that_mean_no_colour(self, tmp_path):
        assert not written(tmp_path / "a.stl", binary(BALL, np.arange(len(DARK)) % 3)).textured
        assert not written(tmp_path / "b.stl", binary(BALL, np.full(len(DARK), 1 << 15 | 5))).textured
