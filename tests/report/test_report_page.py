"""The page: self-contained, safe to open, and the same for the same run."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import re
from html.parser import HTMLParser

import numpy as np
from lxml import html
from PIL import Image
from toy_report import METRICS

from genmf_mi.report import packing, tables, write_before_after, write_report
from genmf_mi.report.page import render
from genmf_mi.report.summary import tiles


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


def test_page_without_javascript_hides_what_needs_it(report):
    """No empty 3D view that says it is being unpacked; what is left is there without a script."""
    page = html.document_fromstring(render(report))
    (style,) = page.xpath("//head/noscript/style/text()")
    for selector in ("#viewer canvas", "#viewer-message", "#viewer-hint"):
        assert selector in style.split("{")[0]
    assert page.xpath("//body//noscript/p[contains(., 'needs JavaScript')]")
    hidden = page.xpath("//*[@hidden]")
    assert hidden and all(element.xpath("ancestor::*[@id='viewer']") for element in hidden)


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
