"""The gallery of ten thousand parts in a real browser: it sorts, searches, and loads few pictures."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from PIL import Image

from genmf_mi.report.gallery import Part, gallery

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
COLUMNS = {"gain": "LPIPS gained, %", "ssim": "SSIM"}


def page(folder: Path, script: str = "") -> str:
    parts = [Part(f"item{i}", "refined", f"item{i}/thumbnail.jpg", f"item{i}/report.html",
                  scores={"gain": float((i * 7919) % 10_007), "ssim": 0.9}) for i in range(10_000)]  # fmt: skip
    parts += [Part("wrong <b>", "failed", text="it is open & thin"), Part("twin", "duplicate", text="as item1")]
    text = gallery("prints & more", parts, COLUMNS, [("items", "10,002")])
    (folder / "gallery.html").write_text(text.replace("</body>", f"<script>{script}</script></body>"), "utf-8")
    return text


def test_page_is_one_file_of_its_own(tmp_path):
    text = page(tmp_path)
    assert not re.findall(r'(?:src|href)="(?:https?:|//)', text) and "prints &amp; more" in text
    assert len(text) < 2_500_000 and text.count("<article") == 0


@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")
@pytest.mark.parametrize(
    ("script", "first", "count"),
    [("", "item0", "10,002 of 10,002"), ("set('sort', 'gain'); check('descending')", "item1040", "10,002 of 10,002"),
     ("set('search', 'open thin')", "wrong &lt;b&gt;", "1 of 10,002"),
     ("set('state', 'duplicate')", "twin", "1 of 10,002"),
     ("set('search', 'item99')", "item99", "111 of 10,002")],
)  # fmt: skip
def test_in_a_browser(tmp_path, script, first, count):
    for i in range(200):
        (tmp_path / f"item{i}").mkdir()
    Image.new("RGB", (64, 28), "red").save(tmp_path / "item0/thumbnail.jpg")
    helpers = """
        const set = (id, value) => { field(id).value = value; field(id).dispatchEvent(new Event("input")); };
        const check = (id) => { field(id).checked = true; field(id).dispatchEvent(new Event("input")); };
    """
    page(tmp_path, helpers + script)
    done = subprocess.run(
        [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1200,900", "--dump-dom",
         f"--user-data-dir={tmp_path / 'profile'}", f"file://{tmp_path / 'gallery.html'}"],
        capture_output=True, encoding="utf-8", check=True, timeout=120,
    )  # fmt: skip
    names = re.findall(r"<h2>(.*?) <small>", done.stdout)
    assert names[0] == first and f'id="count">{count}<' in done.stdout
    assert len(names) <= 240  # the cards in view, and some below
    assert all('loading="lazy"' in image for image in re.findall(r"<img[^>]*>", done.stdout))
