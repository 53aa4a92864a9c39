"""The settings of the page are those of the command line, and there are words for all of them."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from importlib import resources

import numpy as np
import pytest

from genmf_mi.cli.refine import parse
from genmf_mi.core.config import PRESETS, RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.ui import options, regions
from genmf_mi.ui.app import SCRIPTS
from genmf_mi.ui.workspace import STATES

STATIC = resources.files("genmf_mi.ui").joinpath("static")


def texts(language: str) -> dict[str, str]:
    return json.loads(STATIC.joinpath(f"{language}.json").read_text(encoding="utf-8"))


def test_settings_become_words_that_mean_the_same():
    wanted = {
        "preset": "draft", "up": "-z", "size_mm": 80, "printer": "fdm-0.2", "stand": "best", "max_relief_mm": 0.8,
        "stress": True, "score_vgg": True, "view_jitter": [10, 5], "iterations": 12,
    }  # fmt: skip
    preset, up, config = options.configured(wanted)
    chosen = parse(["toy.glb", *options.arguments(preset, up, config)])
    assert chosen.config == config and chosen.up == "-z" and chosen.preset == "draft"
    assert config.size_mm == 80 and config.view_jitter == (10.0, 5.0)


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_are_the_command_lines(preset):
    assert parse(["toy.glb", *options.arguments(*options.configured({"preset": preset}))]).config == PRESETS[preset]


@pytest.mark.parametrize(
    ("wanted", "message"),
    [([], "object"), ({"preset": "best"}, "no preset best"), ({"up": "w"}, "w is no axis"), ({"size_mm": "80"}, "'80'"),
     ({"size_mm": True}, "size_mm cannot be True"), ({"printer": "cheap"}, "choose one of smooth"),
     ({"nothing": 1}, "no setting nothing"), ({"device": "cpu"}, "no setting device"), ({"iterations": 1.5}, "1.5"),
     ({"size_mm": -1}, "must be positive"), ({"view_jitter": [1]}, "2 numbers"), ({"weights": {}}, "no setting w")],
)  # fmt: skip
def test_other_settings_are_refused(wanted, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        options.configured(wanted)


def test_options_are_those_of_the_settings():
    offered = options.options()
    json.dumps(offered, allow_nan=False)
    named = {each["name"]: each for each in offered["settings"]}
    assert set(named) == set(options.SHOWN) <= set(asdict(RefineConfig()))
    assert named["size_mm"]["help"] == "Longest side of the printed part."
    assert named["printer"]["choices"] == list(offered["printers"])
    assert set(named["stand"]["choices"]) == {"auto", "best", *offered["directions"]}
    assert offered["presets"]["default"]["size_mm"] == RefineConfig().size_mm
    for up in offered["up"]:
        parse(["toy.glb", f"--up={up}"])


def test_languages_have_the_same_texts():
    """The help of the settings is English in ``core/config.py``, so only other languages have words for it."""
    english, german = set(texts("en")), set(texts("de"))
    assert german - {key for key in german if key.startswith("help.")} == english
    assert {key for key in german if key.startswith("help.")} == {f"help.{name}" for name in options.SHOWN}
    for language in ("en", "de"):
        assert all(text.strip() for text in texts(language).values())
    for key, text in texts("en").items():
        assert set(re.findall(r"\{\w+\}", text)) == set(re.findall(r"\{\w+\}", texts("de")[key])), key


def test_everything_has_words():
    english = texts("en")
    offered = options.options()
    needed = {f"state.{state}" for state in STATES} | {f"preset.{name}" for name in PRESETS}
    needed |= {f"setting.{name}" for name in options.SHOWN} | {f"paint.{kind}" for kind in regions.KINDS}
    needed |= {f"{each['name']}.{choice}" for each in offered["settings"] for choice in each.get("choices", ())}
    needed |= {f"up.{up}" for up in offered["up"]}
    sources = [STATIC.joinpath(name).read_text(encoding="utf-8") for name in (*SCRIPTS, "index.html")]
    for source in sources:
        needed |= set(re.findall(r'\bt\("([\w.-]+)"', source)) | set(re.findall(r'data-t(?:-\w+)?="([\w.-]+)"', source))
    assert not {key for key in needed if key not in english}


def test_findings_and_stages_have_words():
    english = texts("en")
    analysis = resources.files("genmf_mi.ui").joinpath("analysis.py").read_text(encoding="utf-8")
    codes = set(re.findall(r'"code": "([\w-]+)"', analysis)) | set(re.findall(r'^\s+\("([\w-]+)", "', analysis, re.M))
    assert len(codes) == 11 and {f"finding.{code}" for code in codes} <= set(english)
    room = resources.files("genmf_mi").joinpath("pipeline")
    sources = [path.read_text(encoding="utf-8") for path in room.iterdir() if path.name.endswith(".py")]
    stages = {name for source in sources for name in re.findall(r'progress\.stage\("([^"]+)"\)', source)}
    assert len(stages) > 10
    words = {re.split("[:,]", name)[0] for name in stages}
    unknown = {name for name in words if f"stage.{name}" not in english}
    assert unknown <= {"preparing the textured object", "refining without the stress stage"}  # not for refinements here


REGIONS = {
    "format": "genmf-regions", "version": 1,
    "strokes": [{"kind": "flat", "points": [[0, 0, 1]], "normals": [[0, 0, 1]], "radius_mm": 4.0}],
}  # fmt: skip


def test_regions_are_checked():
    assert regions.checked(REGIONS) == REGIONS
    assert regions.checked(None) is None and regions.checked({**REGIONS, "strokes": []}) is None


@pytest.mark.parametrize(
    "change",
    [{"kind": "evil"}, {"points": []}, {"normals": []}, {"points": [[0, 0]]}, {"points": [[0, 0, "x"]]},
     {"radius_mm": 0}, {"radius_mm": "4"}, {"kind": "stronger", "factor": -1}, {"points": [[0, 0, float("nan")]]}],
)  # fmt: skip
def test_damaged_regions_are_refused(change):
    with pytest.raises(ConfigError):
        regions.checked({**REGIONS, "strokes": [{**REGIONS["strokes"][0], **change}]})


@pytest.mark.parametrize("given", [[], {}, {**REGIONS, "version": 2}, {**REGIONS, "strokes": 3}])
def test_other_regions_are_refused(given):
    with pytest.raises(ConfigError):
        regions.checked(given)


def test_page_is_lit_as_the_scenes_are(tmp_path):
    """Reading the scenes takes Mitsuba, which the server does without."""
    from genmf_mi.render import bridge, scene, scene_file, variant

    variant.use("cpu")
    bridge.write_ply(tmp_path / "a.ply", np.eye(3), np.array([[0, 1, 2]]))
    material = scene.load(scene_file.find("default"), tmp_path / "a.ply", radius=1.0).material
    assert set(material) == set(options.LOOK["material"])
    assert material.pop("lights") == options.LOOK["material"]["lights"]
    for name, value in material.items():
        assert np.allclose(value, options.LOOK["material"][name]), name
