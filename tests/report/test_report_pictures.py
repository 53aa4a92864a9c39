"""The pictures: what a maker sees must be right."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import Image
from toy_report import view

from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import OutputError
from genmf_mi.report import pictures, write_before_after, write_report


def test_pictures_are_composed_in_linear_light():
    mask = np.full((3, 3), 0.25, dtype=np.float32)
    shown = np.asarray(pictures.compose(0.8 * mask, mask))[1, 1] / 255
    bare = np.asarray(pictures.compose(0 * mask, 0 * mask))[1, 1] / 255
    np.testing.assert_allclose(to_linear(shown), 0.8 * 0.25 + 0.75 * to_linear(bare), atol=0.01)


def test_before_and_after_share_one_exposure(tmp_path):
    shown = view("front")
    write_before_after(tmp_path / "a.png", [shown], "ladybird")
    picture = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)
    assert 1600 <= picture.shape[1] <= 2400
    width = (picture.shape[1] - 2 * pictures._MARGIN - 2 * pictures._GAP) // 3
    _, before, after = (
        picture[196 : 196 + width, x : x + width]
        for x in range(pictures._MARGIN, picture.shape[1] - width, width + pictures._GAP)
    )
    right = np.s_[20:-20, width // 2 + 30 : -20]
    assert np.array_equal(before[right], after[right])
    assert (before[width // 2, width // 4] - after[width // 2, width // 4]).min() > 10


def test_silhouette_that_moves_leaves_no_dark_rim():
    shown = view("front")
    shrunk = np.where(shown.mask * (np.arange(64) > 20) > 0, shown.after, 0)
    for after_mask in (None, shown.mask * (shrunk > 0)):
        moved = dataclasses.replace(shown, after=shrunk, after_mask=after_mask)
        empty = dataclasses.replace(shown, after=0 * shrunk, after_mask=0 * shrunk)
        picture, backdrop = (np.asarray(pictures.picture(v, "after")) for v in (moved, empty))
        assert np.array_equal(picture[32, :20], backdrop[32, :20])


def test_views_with_most_change_come_first(report):
    assert [shown.label[:10] for shown in pictures.by_change(report.views)] == ["azimuth 60", "azimuth 0°"]


@pytest.mark.parametrize("wide", [0.3, 1.0, 3.0])
def test_box_holds_the_object_and_is_never_too_tall(wide):
    shown = view("front", wide=wide)
    left, top, right, bottom = pictures.framing([shown])
    rows, columns = np.nonzero(shown.mask > 0.05)
    assert left < columns.min() and columns.max() < right and top < rows.min() and rows.max() < bottom
    assert (bottom - top) / (right - left) <= 1.3


def test_relief_colours_are_white_at_zero_and_symmetric_in_lightness():
    at = np.linspace(-1, 1, 41)
    colours = pictures.relief_colour(at, 1.0)
    luminance = to_linear(colours) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance[:21]) > 0).all() and (np.diff(luminance[20:]) < 0).all()
    assert (colours[:18, 2] > colours[:18, 0]).all() and (colours[-18:, 0] > colours[-18:, 2]).all()
    assert colours[20].min() > 0.95
    np.testing.assert_array_equal(pictures.relief_colour(np.array([np.nan, 9.0]), 1.0), colours[[20, 40]])


def test_title_of_any_length_and_script_fits(tmp_path):
    write_before_after(tmp_path / "a.png", [view("front")], "Übergrößenträger <b> " * 30 + "\n")
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    assert (picture[:100, -pictures._MARGIN :] == pictures._PAPER).all()


def test_no_views_is_an_error(tmp_path, report):
    with pytest.raises(OutputError, match="no views"):
        write_before_after(tmp_path / "a.png", [], "x")
    with pytest.raises(OutputError, match="no views"):
        write_report(tmp_path / "a.html", dataclasses.replace(report, views=[]))
    assert not list(tmp_path.iterdir())
