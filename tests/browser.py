"""A real browser for the tests of pages: Chromium, which draws WebGL on the CPU."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]


def chromium() -> str:
    """The path of the browser; skips the test where there is none."""
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("there is no Chromium")
    return found


@contextmanager
def opened(**options) -> Iterator:
    """A fresh context of a browser, with ``errors``: what went wrong on its pages."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        context = browser.new_context(viewport={"width": 1280, "height": 860}, locale="en-GB", **options)
        context.errors = []
        context.on("weberror", lambda error: context.errors.append(str(error.error)))
        context.on("console", lambda said: context.errors.append(said.text) if said.type == "error" else None)
        try:
            yield context
        finally:
            browser.close()


def until(page, expression: str, seconds: float = 60) -> None:
    """Wait until JavaScript is true; the page itself, whose policy forbids ``eval``, could not be asked to wait."""
    end = time.monotonic() + seconds
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"waited in vain for {expression}"
        page.wait_for_timeout(50)


def pixels(page, selector: str = "canvas"):
    """What is seen of an element: ``[H,W,3]``."""
    import io

    import numpy as np
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(page.locator(selector).screenshot())).convert("RGB"), dtype=float)


def axe_violations(page) -> list[str]:
    """What axe-core finds against accessibility on a page."""
    import axe_playwright_python

    script = Path(axe_playwright_python.__file__).with_name("axe.min.js").read_text(encoding="utf-8")
    page.evaluate(script + "\n;0")
    # Half faded in, a text has less contrast; endless animations are left alone
    page.evaluate(
        "Promise.all(document.getAnimations().filter(a => a.effect.getComputedTiming().endTime < 1e4)"
        ".map(a => a.finished.catch(() => 0))).then(() => 0)"
    )
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    return [
        f"{each['id']}: {node['html'][:120]} ({node['failureSummary'][:200]})"
        for each in found
        for node in each["nodes"]
    ]
