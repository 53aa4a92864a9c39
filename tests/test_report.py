"""The pictures and the report: what a maker sees must be right, self-contained and safe to open."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import re
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest
from lxml import html
from PIL import Image
from scipy.spatial import cKDTree

from genmf_mi.core.colour import to_linear, to_srgb
from genmf_mi.core.errors import OutputError
from genmf_mi.report import Report, View, curves, packing, pictures, tables, write_before_after, write_report
from genmf_mi.report.page import notes, render, tiles

METRICS = {
    "before": {"ssim": 0.7988, "lpips_alex": 0.2257, "g_ssim": 0.7801},
    "displacement": {"ssim": 0.7920, "lpips_alex": 0.1856, "g_ssim": 0.7846},
    "after": {"ssim": 0.8253, "lpips_alex": 0.1418, "g_ssim": 0.7701},
    "unseen": {"before": {"lpips_alex": 0.2010}, "after": {"lpips_alex": 0.1344}},
    "relief_mm": {"max": 0.93, "p99": 0.71, "mean": 0.2},
    "solid": {"watertight": True, "bodies": 1, "self_intersections": 0, "volume_mm3": 81234.5},
    "seconds": {"total": 142.3},
    "iterations": 40,
}

MATERIAL = {
    "albedo": 0.7, "ambient": 0.1, "key": [0.0, 0.0, 1.0], "fill": [1.0, 0.0, 0.0], "key_weight": 0.6,
    "fill_weight": 0.3, "sharpness": 5.0, "lights": "camera"}  # fmt: skip


def sphere(rows: int = 40, columns: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """A closed sphere of radius 0.95 with the poles as single vertices."""
    polar, turn = np.linspace(0, np.pi, rows + 2)[1:-1], np.arange(columns) * 2 * np.pi / columns
    p, t = (grid.ravel() for grid in np.meshgrid(polar, turn, indexing="ij"))
    ring = np.stack([np.sin(p) * np.sin(t), np.cos(p), np.sin(p) * np.cos(t)], axis=1)
    vertices = np.concatenate([ring, [[0, 1, 0], [0, -1, 0]]]) * 0.95
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij"))
    k = (j + 1) % columns
    a, b, c, d = i * columns + j, (i + 1) * columns + j, (i + 1) * columns + k, i * columns + k
    first, last = np.arange(columns), (rows - 1) * columns + np.arange(columns)
    north, south = np.full(columns, len(ring)), np.full(columns, len(ring) + 1)
    faces = np.concatenate(
        [
            np.stack([a, b, c], 1),
            np.stack([a, c, d], 1),
            np.stack([north, first, np.roll(first, -1)], 1),
            np.stack([south, np.roll(last, -1), last], 1),
        ]
    )
    return vertices.astype(np.float32), faces


def view(label: str, side: int = 64, change: float = 0.1, wide: float = 1.0) -> View:
    """A disc (or an ellipse) lit from above, with a soft edge; the refinement darkens its left half by ``change``."""
    y, x = np.mgrid[0:side, 0:side] / (side - 1) * 2 - 1
    mask = np.clip((0.8 - np.hypot(x / min(wide, 1), y * max(wide, 1))) * side / 2, 0, 1).astype(np.float32)
    before = (0.6 - 0.2 * y).astype(np.float32) * mask
    after = before - np.where(x < 0, change, 0).astype(np.float32) * mask
    colour = np.stack([before, before * 0.5, before * 0.2], axis=2)
    relief = np.where(mask > 0, np.where(x < 0, -0.5, 0.5), np.nan).astype(np.float32)
    return View(label, mask, colour, before, before, before, after, relief)


@pytest.fixture
def report() -> Report:
    vertices, faces = sphere()
    relief = np.where(vertices[:, 0] > 0.3, 0.8, -0.2)
    refined = vertices * (1 + relief[:, None] / 50 / 0.95)
    history = [
        {
            "iteration": i,
            "stage": 1 if i < 25 else 2,
            "loss": 2.0 - 0.04 * i,
            "lpips": 1.0 - 0.02 * i,
            "seconds": 0.3 * i,
        }
        for i in range(40)
    ]
    return Report(
        title="ladybird",
        views=[view("azimuth 0°, elevation 20°"), view("azimuth 60°, elevation 20°", change=0.3)],
        history=history,
        metrics=METRICS,
        config={"size_mm": 100.0, "nozzle_mm": 0.4, "loss": {"weight": 0.5}},
        vertices=refined.astype(np.float32),
        original=vertices,
        faces=faces,
        colours=np.clip(np.abs(vertices), 0, 1).astype(np.float32),
        relief_mm=relief,
        cap_mm=1.0,
        size_mm=100.0,
        material=MATERIAL,
        steps={"log": ["welded 12 vertices", "closed 1 hole"], "faces": len(faces)},
    )


# Pictures


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


# The page


class Balanced(HTMLParser):
    """Fails on a tag that closes what was not opened last."""

    VOID = ("meta", "link", "img", "input", "br")

    def __init__(self):
        super().__init__()
        self.open = []

    def handle_starttag(self, tag, attrs):
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, f"</{tag}> at line {self.getpos()[0]}"


def test_page_is_self_contained_and_well_formed(tmp_path, report):
    write_report(tmp_path / "report.html", report)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    parser = Balanced()
    parser.feed(text)
    assert parser.open == []
    page = html.document_fromstring(text)
    for element in page.iter():
        for name in ("src", "href", "srcset", "data", "action", "poster"):
            if (reference := element.get(name)) is not None:
                assert reference.startswith("data:"), reference
    assert not re.search(r"https?:|@import|url\(", text)
    assert "default-src 'none'" in page.xpath("//meta[@http-equiv]/@content")[0]


def test_pictures_of_the_page_are_images_with_alternative_text(report):
    page = html.document_fromstring(render(report))
    images = page.xpath("//img")
    assert len(images) == 3 + 2 * 6
    for image in images:
        picture = Image.open(io.BytesIO(base64.b64decode(image.get("src").split(",", 1)[1])))
        assert picture.size == (int(image.get("width")), int(image.get("height")))
        assert image.get("alt")
    without = [dataclasses.replace(shown, displacement=None) for shown in report.views]
    assert len(html.document_fromstring(render(dataclasses.replace(report, views=without))).xpath("//img")) == 3 + 2 * 5


def test_tables_have_captions_and_headers(report):
    page = html.document_fromstring(render(report))
    found = page.xpath("//table")
    assert len(found) == 6
    for table in found:
        assert table.xpath("./caption") and table.xpath("./thead/tr/th[@scope='col']")
        columns = len(table.xpath("./thead/tr/th"))
        for row in table.xpath("./tbody/tr"):
            assert row.xpath("./th[@scope='row']") and len(row) == columns
    identifiers = page.xpath("//@id")
    assert len(identifiers) == len(set(identifiers))
    assert set(page.xpath("//@aria-labelledby") + page.xpath("//@aria-describedby")) <= set(identifiers)


def test_text_of_the_user_is_escaped(report):
    evil = "</script><script>alert(1)</script>\"'&<img src=x onerror=alert(1)>"
    hostile = dataclasses.replace(
        report,
        title=evil,
        views=[dataclasses.replace(report.views[0], label=evil)],
        history=[{"iteration": 0, "stage": evil, "loss": 1.0}, {"iteration": 1, "stage": 2, "loss": 0.5, evil: 1.0}],
        metrics={**METRICS, evil: evil, "before": {evil: 1.0}},
        config={evil: evil},
        steps={evil: evil, "log": [evil]},
    )
    plain, page = html.document_fromstring(render(report)), html.document_fromstring(render(hostile))
    assert len(page.xpath("//script")) == len(plain.xpath("//script")) == 3
    assert not page.xpath("//*[@onerror]")
    assert page.xpath("//h1")[0].text == evil


def test_missing_and_not_finite_values_are_dashes(report):
    broken = dataclasses.replace(
        report,
        metrics={
            "before": {"ssim": None, "lpips_alex": float("nan")},
            "displacement": None,
            "after": {"ssim": 0.5, "lpips_alex": float("inf")},
            "solid": {"watertight": None},
        },
        history=[
            {"iteration": 0, "stage": 1, "loss": float("nan")},
            {"iteration": 1, "stage": 1, "loss": 1.0, "geo": None},
        ],
        relief_mm=np.full(len(report.vertices), np.nan),
        original=None,
        cap_mm=0.0,
        config={},
        steps={},
    )
    page = html.document_fromstring(render(broken))
    for script in page.xpath("//script | //style"):
        script.drop_tree()
    assert not re.search(r"\b(nan|inf|None)\b", page.text_content(), re.IGNORECASE)
    cells = page.xpath("//table[1]//tr[th='SSIM']/td/text()")
    assert cells == [tables.DASH, "0.5000", tables.DASH]
    assert [tile.value for tile in tiles(broken)] == ["– → 0.5000" if k == 1 else "– → –" for k in range(3)] + ["–"] * 3
    json.loads(json.dumps(packing.pack(broken).meta, allow_nan=False))
    assert render(dataclasses.replace(broken, history=[], metrics={}))


def test_same_run_same_bytes(tmp_path, report):
    for name in ("a", "b"):
        write_report(tmp_path / f"{name}.html", report)
        write_before_after(tmp_path / f"{name}.png", report.views, report.title)
    for suffix in ("html", "png"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_key_numbers_judge_by_direction(report):
    lpips, ssim, unseen, relief, solid, time = tiles(report)
    assert (lpips.value, lpips.good, lpips.details[0]) == ("0.2257 → 0.1418", True, "−0.0839 (−37 %), better")
    assert (ssim.value, ssim.good) == ("0.7988 → 0.8253", True)
    assert (unseen.value, unseen.details[1]) == ("0.2010 → 0.1344", "luminance displacement: –")
    assert (relief.value, relief.good) == ("0.93\N{NO-BREAK SPACE}mm", True)
    assert (solid.value, time.value) == ("watertight", "2 min 23 s")
    deep = {**METRICS, "relief_mm": {"max": 1.2}, "solid": {"watertight": False, "self_intersections": 7}}
    worse = dataclasses.replace(report, metrics=deep)
    assert [tile.good for tile in tiles(worse)[3:5]] == [False, False]
    assert len(notes(worse)) == len(notes(report)) + 2


# Tables


def test_metrics_are_put_side_by_side_wherever_the_state_stands():
    inside = {"before": {"inside": {"ssim": 0.5}}, "after": {"inside": {"ssim": 0.4}}}
    found, rest = tables.compare({**inside, "unseen.before": {"ssim": 0.6}, "seconds": {"displacement": 2.0}})
    assert [(table.group, table.states) for table in found] == [
        (("inside",), ["before", "after"]),
        (("unseen",), ["before"]),
    ]
    assert found[0].rows == [("SSIM", ["0.5000", "0.4000"], "−0.1000 (−20 %), worse")]
    assert rest == [("seconds · displacement", "2\N{NO-BREAK SPACE}s")]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (None, "–"),
        (True, "yes"),
        (np.bool_(False), "no"),
        (160000, "160000"),
        (0.2257, "0.2257"),
        (100.0, "100"),
        (812345.6, "812346"),
        (1e-7, "1e-07"),
        (np.float32("nan"), "–"),
        ([1, 0.5], "1, 0.5"),
        (np.arange(2), "0, 1"),
    ],
)
def test_values_as_text(value, expected):
    assert tables.text(value) == expected


def summary(p99_9: float, mean: float, band: float) -> dict:
    return {
        "von_mises_mpa": {"p99_9": p99_9, "mean": mean, "max": 9.0},
        "surface_band": {"mean": band, "p99_9": 2 * band},
    }


def verified() -> dict:
    """Metrics of a run with its three shapes simulated, and the ratios that the solver would tell."""
    shapes = {"before": (1.0, 0.4, 0.5), "unconstrained": (2.0, 0.44, 0.6), "after": (1.5, 0.42, 0.55)}
    keys = [key for key, *_ in tables.STRESSES]
    return {
        **METRICS,
        "unconstrained": {"ssim": 0.83, "lpips_alex": 0.1257, "g_ssim": 0.78},
        "stress": {
            "shapes": {name: summary(*values) for name, values in shapes.items()},
            "ratio": {
                "unconstrained": dict(zip(keys, (2.0, 1.1, 1.2, 1.2))),
                "after": dict(zip(keys, (1.5, 1.05, 1.1, 1.1))),
                "constrained": dict(zip(keys, (0.75, 0.9545, 0.9167, 0.9167))),
            },
            "remains": dict(zip(keys, (0.5, 0.5, None, 0.5))),
        },
    }


def test_stress_is_told_next_to_lpips(report):
    """In its own table, and nowhere else."""
    table = tables.stress(verified())
    assert table.columns[1:4] == ["Before", "Without stress stage", "Refined"]
    assert table.rows[0][1:] == ["1.000", "2.000 ×2.00", "1.500 ×1.50", "×0.75", "50 %"]
    assert table.rows[2][-1] == tables.DASH
    assert table.rows[-1] == ["LPIPS (AlexNet)", "0.2257", "0.1257", "0.1418", "×1.13", "84 % kept"]
    text = render(dataclasses.replace(report, metrics=verified()))
    page = html.document_fromstring(text)
    (section,) = page.xpath("//section[@aria-labelledby='h-stress']")
    assert len(section.xpath(".//tbody/tr")) == 5 and "2.000 ×2.00" in section.text_content()
    assert page.xpath("//table[caption='Standard views, full frame']//th/text()")[:5] == [
        "Metric", "Before", "Displacement", "Without stress stage", "Refined"]  # fmt: skip
    assert "von mises" not in text
    assert not html.document_fromstring(render(report)).xpath("//*[@id='h-stress']")


def test_stress_without_a_stress_stage():
    metrics = verified()
    for place in (metrics, metrics["stress"]["shapes"], metrics["stress"]["ratio"]):
        del place["unconstrained"]
    del metrics["stress"]["ratio"]["constrained"], metrics["stress"]["remains"]
    table = tables.stress(metrics)
    assert table.columns == ["", "Before", "Refined"]
    assert table.rows[0][1:] == ["1.000", "1.500 ×1.50"] and table.rows[-1][1:] == ["0.2257", "0.1418"]
    assert tables.stress(METRICS) is None
    assert tables.stress({"stress": {"shapes": {"after": {}}}}) is None


# Loss curves


def points(path: str) -> list[list[tuple[float, float]]]:
    strokes = [re.split("L", stroke) for stroke in path.split("M")[1:]]
    return [[tuple(map(float, point.split())) for point in stroke] for stroke in strokes]


def test_curve_passes_through_the_values(report):
    loss, lpips = curves.curves(report.history)
    assert (loss.name, lpips.name) == ("loss", "lpips")
    (stroke,) = points(lpips.raw)
    ticks = {label: y for y, label in lpips.ticks}
    assert ticks["0"] == curves.HEIGHT
    for i, (x, y) in enumerate(stroke):
        assert x == pytest.approx(curves.WIDTH * i / 39, abs=0.06)
        assert (curves.HEIGHT - y) / (curves.HEIGHT - ticks["0.5"]) == pytest.approx((1 - 0.02 * i) / 0.5, abs=0.03)
    assert lpips.stages == [(pytest.approx(curves.WIDTH * 25 / 39), "2")]


def test_terms_of_the_second_stage_are_drawn(report):
    history = [{**row, "stress_band": 1.1 - 0.001 * i} if row["stage"] == 2 else row
               for i, row in enumerate(report.history)]  # fmt: skip
    (curve,) = [c for c in curves.curves(history) if c.name == "stress_band"]
    (stroke,) = points(curve.raw)
    assert len(stroke) == 15 and stroke[0][0] == pytest.approx(curve.stages[0][0], abs=0.06)
    assert "predicted stress, surface band" in render(dataclasses.replace(report, history=history))


def test_curve_keeps_gaps_and_stays_in_the_frame():
    values = [1.0, 2.0, None, float("nan"), 2.0, 1.5, 900.0, 0.001]
    (curve,) = curves.curves([{"iteration": i, "loss": value} for i, value in enumerate(values)])
    strokes = points(curve.raw)
    assert [len(stroke) for stroke in strokes] == [2, 4]
    assert curve.logarithmic and all(0 <= y <= curves.HEIGHT for stroke in strokes for _, y in stroke)


def test_long_history_is_thinned():
    (curve,) = curves.curves([{"iteration": i, "loss": 1.0} for i in range(5000)])
    assert sum(map(len, points(curve.raw))) <= 300 and curve.iterations == (0, 4999)


# The 3D view


def unpack(packed: packing.Packed) -> dict[str, np.ndarray]:
    """The slow, obvious inverse of the packing, as viewer.js does it."""
    stream, at, columns = zlib.decompress(base64.b64decode(packed.data)), 0, []
    meta = packed.meta
    n = meta["vertices"]
    for index, width in enumerate(meta["widths"]):
        count = 3 * meta["faces"] if index == len(meta["widths"]) - 1 else n
        total, column = 0, []
        for i in range(count):
            folded = sum(stream[at + plane * count + i] << (8 * plane) for plane in range(width))
            total += -(folded + 1) // 2 if folded % 2 else folded // 2
            column.append(total)
        at += width * count
        columns.append(np.array(column))
    assert at == len(stream)
    refined = np.stack(columns[:3], 1)
    rest = columns[3:]
    residual = 0
    if meta["hasOriginal"]:
        residual, rest = np.stack(rest[:3], 1), rest[3:]
    return {
        "refined": np.array(meta["low"]) + meta["step"] * refined,
        "original": np.array(meta["low"]) + meta["step"] * (refined + residual),
        "colours": np.stack(rest[:3], 1),
        "relief": rest[3] * meta["reliefStep"],
        "faces": rest[4].reshape(-1, 3),
    }


@pytest.mark.parametrize("with_original", [True, False])
def test_embedded_mesh_is_the_mesh(report, with_original):
    if not with_original:
        report = dataclasses.replace(report, original=None)
    page = html.document_fromstring(render(report))
    meta = json.loads(page.get_element_by_id("mesh-meta").text)
    mesh = unpack(packing.Packed(meta, page.get_element_by_id("mesh-data").text))
    half = meta["step"] / 2 * 1.001 + 1e-9
    distance, match = cKDTree(report.vertices).query(mesh["refined"])
    assert sorted(match) == list(range(len(report.vertices))) and distance.max() <= np.sqrt(3) * half
    if with_original:
        assert np.abs(mesh["original"] - report.original[match]).max() <= half
    assert np.abs(mesh["relief"] - report.relief_mm[match]).max() <= meta["reliefStep"] / 2 + 1e-9
    assert np.abs(mesh["colours"] / 255 - to_srgb(report.colours[match])).max() <= 0.5 / 255 + 1e-6

    def turned(faces):
        return sorted(tuple(np.roll(face, -face.argmin())) for face in faces)

    assert turned(match[mesh["faces"]]) == turned(report.faces)
    assert bool(page.xpath("//input[@name='shape']")) == with_original


def test_view_is_lit_as_the_renders_are(report):
    """The page hands the material over, and the script uses all of it and knows no other."""
    page = html.document_fromstring(render(report))
    assert json.loads(page.get_element_by_id("mesh-meta").text)["material"] == MATERIAL
    script = page.xpath("//script")[-1].text
    shader = script[script.index("FRAGMENT_SHADER") : script.index("linkProgram")]
    for name in MATERIAL:
        assert re.search(rf'material\.{name}\b|"{name}"', script), name
        assert name == "lights" or re.search(rf"uniform [^;]*\b{name}\b[^;]*;", shader), name
    shading = shader[shader.index("float softplus") : shader.index("if (surface == 2)")]
    assert set(re.findall(r"\d+(?:\.\d+)?", shading)) <= {"0.0", "1.0", "1", "3"}


def test_view_opens_where_the_relief_is(report):
    # The fixture raises x > 0.3 most
    assert packing.pack(report).meta["azimuth"] == 90


def test_large_mesh_is_simplified_and_the_page_says_so(report, monkeypatch):
    monkeypatch.setattr(packing, "MAX_FACES", 1500)
    mesh = unpack(packed := packing.pack(report))
    assert 500 < packed.meta["faces"] <= 1500
    assert mesh["faces"].max() == packed.meta["vertices"] - 1
    a, b, c = (mesh["refined"][mesh["faces"][:, k]] for k in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert volume == pytest.approx(4 / 3 * np.pi * 0.95**3, rel=0.06)
    assert f"simplified mesh of {packed.meta['faces']} of {len(report.faces)} faces" in render(report)


def test_embedded_mesh_of_realistic_size_stays_small():
    vertices, faces = sphere(250, 320)
    grey = (np.sin(20 * vertices[:, :1]) > 0).repeat(3, axis=1).astype(np.float32)
    report = Report("x", [], [], {}, {}, vertices * 1.01, faces, grey, grey[:, 0] * 0.5, 1.0, 100.0, MATERIAL,
                    original=vertices)  # fmt: skip
    assert len(faces) == 160_000
    assert len(packing.pack(report).data) < 3e6
