"""OpenEXR files of the buffers, written by OpenEXR and read back by Mitsuba."""

from __future__ import annotations

import os

import numpy as np
import pytest
import torch

from genmf_mi.core.errors import OutputError
from genmf_mi.render import variant
from genmf_mi.render.bridge import Buffers
from genmf_mi.render.exr import write_buffers
from genmf_mi.render.scene import View

mi = pytest.importorskip("mitsuba")
VIEWS = (View(0, 20), View(60, -10))


@pytest.fixture
def buffers() -> Buffers:
    """Random numbers, also such as no 8-bit or half-float file holds."""
    generator = torch.Generator().manual_seed(0)
    images = [torch.randn(2, channels, 20, 30, generator=generator) for channels in (1, 1, 3, 1)]
    images[1] += 1e5
    images[2][0, 0, 0, 0] = 1e-8
    return Buffers(*images)


def read(path) -> dict[str, np.ndarray]:
    variant.use("cpu")
    bitmap = mi.Bitmap(str(path))
    assert bitmap.component_format() == mi.Struct.Type.Float32
    names = [field.name for field in bitmap.struct_()]
    return dict(zip(names, np.moveaxis(np.array(bitmap), 2, 0), strict=True))


def test_round_trip(tmp_path, buffers):
    paths = write_buffers(tmp_path / "exr", VIEWS, buffers)
    assert [path.name for path in paths] == sorted(os.listdir(tmp_path / "exr")) == ["view_00.exr", "view_01.exr"]
    for i, path in enumerate(paths):
        channels = read(path)
        assert set(channels) == {"Y", "Z", "A", "N.X", "N.Y", "N.Z"}
        np.testing.assert_array_equal(channels["Y"], buffers.grey[i, 0])
        np.testing.assert_array_equal(channels["Z"], buffers.depth[i, 0])
        np.testing.assert_array_equal(channels["A"], buffers.coverage[i, 0])
        np.testing.assert_array_equal(np.stack([channels[f"N.{axis}"] for axis in "XYZ"]), buffers.normal[i])


def test_the_view_is_named_in_the_file(tmp_path, buffers):
    import OpenEXR

    path = write_buffers(tmp_path, VIEWS, buffers)[1]
    assert OpenEXR.File(str(path)).header()["comments"] == VIEWS[1].label


def test_where_nothing_can_be_written(tmp_path, buffers):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write"):
        write_buffers(tmp_path / "file", VIEWS, buffers)


def test_disk_full(tmp_path, buffers, full_disk):
    """No half file stays."""
    with full_disk(), pytest.raises(OutputError, match="cannot write"):
        write_buffers(tmp_path, VIEWS, buffers)
    assert os.listdir(tmp_path) == []
