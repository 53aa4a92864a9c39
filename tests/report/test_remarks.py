"""What a user is told of a part before printing it."""

from __future__ import annotations

import numpy as np
import trimesh

from genmf_mi.fabrication.checks import pieces
from genmf_mi.report.remarks import LISTED, remarks


def parts(*boxes: tuple[tuple[float, float, float], tuple[float, float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Boxes, each by its lowest corner and its extents."""
    made = []
    for corner, extents in boxes:
        box = trimesh.creation.box(extents)
        box.apply_translation(np.array(corner) + np.array(extents) / 2)
        made.append(box)
    whole = trimesh.util.concatenate(made)
    return np.array(whole.vertices), np.array(whole.faces)


BODY = ((-20.0, -20.0, 0.0), (40.0, 40.0, 30.0))


class TestPieces:
    def test_none_of_one_body(self):
        assert pieces(*parts(BODY)) == []

    def test_size_place_and_gap(self):
        halo = ((-5.0, -5.0, 33.0), (10.0, 10.0, 2.0))
        stone = ((25.0, -10.0, 0.0), (4.0, 6.0, 5.0))
        first, second = pieces(*parts(stone, BODY, halo))
        assert first["size_mm"] == [10, 10, 2] and second["size_mm"] == [4, 6, 5]
        assert (first["above_bed_mm"], first["gap_mm"]) == (33, 3)
        assert (second["above_bed_mm"], second["gap_mm"]) == (0, 5)
        np.testing.assert_allclose(first["centre_mm"], [-4.5, 0, 34])  # the whole reaches from -20 to 29
        np.testing.assert_allclose(second["centre_mm"], [22.5, -7, 2.5])

    def test_are_told_with_what_to_do(self):
        halo = ((-5.0, -5.0, 33.0), (10.0, 10.0, 2.0))
        (told,) = remarks({"pieces": pieces(*parts(BODY, halo))})
        place = "10 × 10 × 2.0 mm, in the middle, 33 mm above the bed, 3.0 mm from the body"
        assert told.startswith(f"1 piece floats free of the main body: {place}.")
        assert "mesh editor" in told

    def test_of_many_the_largest_are_told(self):
        many = [((-20.0 + 4 * i, 25.0, 0.0), (1.0 + 0.1 * i, 1.0, 1.0)) for i in range(9)]
        (told,) = remarks({"pieces": pieces(*parts(BODY, *many))})
        assert told.startswith("9 pieces float free") and f"and {9 - LISTED} more" in told
        assert "14 mm to the right and" not in told and "standing on the bed" in told


def test_how_it_stands():
    assert remarks({"stand": {"name": "upright", "up": [0, 1, 0]}}) == []
    for stand, words in (
        ({"name": "upright", "unsteady": True}, "--stand auto"),
        ({"name": "on-back", "asked": "auto"}, "printed lying, on back"),
        ({"name": "tilted", "asked": "auto"}, "on a slanted flat side"),
        ({"name": "upright", "asked": "auto", "unsteady": True}, "no flat side"),
    ):
        (told,) = remarks({"stand": stand})
        assert words in told
    assert remarks({"stand": {"name": "upright", "asked": "auto"}}) == []


def test_what_was_left_out():
    dropped, note = remarks({"solid": {"stray_bodies_dropped": 2}, "asset_notes": ["the map \udcff is left out"]})
    assert dropped.startswith("2 components of less than 1 % of the volume were left out")
    assert note == "Of the file, the map ÿ is left out."
