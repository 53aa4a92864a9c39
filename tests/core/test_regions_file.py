"""Files of painted strokes: what is read is what was written, and what is wrong is said."""

from __future__ import annotations

import json

import numpy as np
import pytest

from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.regions import Regions, Stroke

STROKE = {"kind": "flat", "points": [[0, 0, 1], [0, 1, 1]], "normals": [[0, 0, 1], [0, 0, 2]], "radius_mm": 4.0}


def text(*strokes, **changes) -> str:
    return json.dumps({"format": "genmf-regions", "version": 1, "strokes": list(strokes)} | changes)


def test_round_trip(tmp_path):
    told = [
        STROKE,
        STROKE | {"kind": "stronger", "factor": 3},
        STROKE | {"kind": "matters"},
        STROKE | {"kind": "erase"},
    ]
    (tmp_path / "a.json").write_text(text(*told))
    read = Regions.read(tmp_path / "a.json")
    assert [(s.kind, s.radius_mm) for s in read.strokes] == [(t["kind"], 4.0) for t in told]
    assert [s.factor for s in read.strokes][1:3] == [3, 2]
    np.testing.assert_array_equal(read.strokes[0].points, STROKE["points"])
    again = Regions.from_json(read.to_json())
    assert again.to_json() == read.to_json()
    assert json.loads(read.to_json())["strokes"][0] == STROKE, "no factor where it says nothing"


def test_keys_that_are_not_known_are_left_alone():
    assert len(Regions.from_json(text(STROKE | {"colour": "red"}, author="somebody")).strokes) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not JSON"),
        ("[1]", '"format" is not "genmf-regions"'),
        (text(STROKE, format="svg"), '"format"'),
        (text(STROKE, version=2), "version 2 .* only 1"),
        (text(STROKE, version=None), "version None"),
        (text(), "no strokes"),
        (text(strokes={}), "no strokes"),
        (text(3), "stroke 1 of .* not an object"),
        (text(STROKE, STROKE | {"kind": "bumpy"}), "stroke 2 of .* kind 'bumpy'.*flat, stronger, matters, erase"),
        (text(STROKE | {"kind": ["flat"]}), "kind"),
        (text({k: v for k, v in STROKE.items() if k != "normals"}), "stroke 1 of .* has no normals"),
        (text(STROKE | {"points": []}), "points that are not rows"),
        (text(STROKE | {"points": [[0, 0]]}), "points that are not rows"),
        (text(STROKE | {"points": [[0, 0, 0], [1, 2]]}), "points that are not rows"),
        (text(STROKE | {"points": [[0, float("nan"), 0], [0, 0, 0]]}), "points that are not rows"),
        (text(STROKE | {"points": "abc"}), "points that are not rows"),
        (text(STROKE | {"normals": [[0, 0, 1]]}), "2 points and 1 normals"),
        (text(STROKE | {"normals": [[0, 0, 1], [0, 0, 0]]}), "normal of length 0"),
        (text(STROKE | {"radius_mm": 0}), "radius_mm of 0"),
        (text(STROKE | {"radius_mm": float("inf")}), "radius_mm that is no finite number"),
        (text(STROKE | {"radius_mm": True}), "radius_mm that is no"),
        (text(STROKE | {"kind": "stronger", "factor": 0.5}), "factor 0.5: it must be 1 to 5"),
        (text(STROKE | {"kind": "matters", "factor": "2"}), "factor that is no"),
    ],
)
def test_refused(content, message):
    with pytest.raises(ConfigError, match=message):
        Regions.from_json(content, "a.json")


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00\x81")
    for name in ("missing.json", "binary.json"):
        with pytest.raises(ConfigError, match=f"cannot read the regions .*{name}"):
            Regions.read(tmp_path / name)


class TestSettings:
    def test_names_of_copies_stand_for_files(self, tmp_path):
        stroke = Stroke("flat", np.zeros((1, 3)), np.ones((1, 3)), 1.0)
        told = RefineConfig(regions=Regions((stroke,)), mask=tmp_path / "My Mask.PNG", flat_faces=("lid",)).to_dict()
        assert (told["regions"], told["mask"], told["flat_faces"]) == ("regions.json", "mask.png", ["lid"])
        assert RefineConfig(mask="vertex-colours").to_dict()["mask"] == "vertex-colours"
        assert RefineConfig().to_dict()["regions"] is None

    @pytest.mark.parametrize(
        ("changes", "message"),
        [({"mask": "mask.obj"}, "mask mask.obj is of an unknown kind"), ({"mask_fade_mm": 0.0}, "mask-fade-mm")],
    )
    def test_out_of_range(self, changes, message):
        with pytest.raises(ConfigError, match=message):
            RefineConfig(**changes)
