"""The 3D view of the report in a real browser, as a file without a network."""

from __future__ import annotations

import numpy as np
import pytest
from browser import axe_violations, opened, pixels

from genmf_mi.report import write_report


@pytest.fixture(scope="module")
def page(tmp_path_factory, request):
    from toy_report import toy_report

    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, toy_report())
    with opened(offline=True) as context:
        page = context.new_page()
        page.goto(path.as_uri())
        page.wait_for_selector(".controls:visible")
        yield page
        assert context.errors == []


@pytest.fixture(autouse=True)
def as_at_first(page):
    yield
    page.check("[name=surface][value='0']")
    page.check("[name=shape][value='1']")
    page.fill("[name=lamp]", "0")
    page.click("[data-action=reset]")
    page.wait_for_timeout(350)


def seen(page):
    page.wait_for_timeout(120)
    return pixels(page)


def changed(page, act) -> float:
    """Mean change of the picture."""
    before = seen(page)
    act()
    page.wait_for_timeout(350)
    return float(np.abs(seen(page) - before).mean())


def test_the_shape_is_drawn_and_every_switch_shows(page):
    picture = seen(page)
    middle, corner = picture[len(picture) // 2, picture.shape[1] // 2], picture[5, 5]
    assert np.abs(middle - corner).max() > 40
    assert changed(page, lambda: page.check("[name=surface][value='1']")) > 5
    assert changed(page, lambda: page.check("[name=surface][value='2']")) > 5
    assert page.locator("#viewer-legend").is_visible()
    assert changed(page, lambda: page.fill("[name=lamp]", "60")) > 1
    assert changed(page, lambda: page.check("[name=shape][value='0']")) > 0.2


def test_mouse_wheel_and_keys(page):
    box = page.locator("canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.check("[name=surface][value='1']")

    def drag(button: str = "left") -> None:
        page.mouse.move(x, y)
        page.mouse.down(button=button)
        page.mouse.move(x + 90, y + 20, steps=4)
        page.mouse.up(button=button)

    assert changed(page, drag) > 1
    assert changed(page, lambda: drag("right")) > 1
    assert changed(page, lambda: page.mouse.wheel(0, -400)) > 1  # it has the focus
    first = seen(page)
    for key, back in (("ArrowLeft", "ArrowRight"), ("ArrowUp", "ArrowDown"), ("+", "-")):
        assert changed(page, lambda key=key: page.press("canvas", key)) > 0.5
        page.press("canvas", back)
    assert np.abs(seen(page) - first).mean() < 1
    page.press("canvas", "0")
    page.click("[data-action=in]")
    page.click("[data-action=out]")


def test_nobody_is_shut_out(page):
    assert axe_violations(page) == []


def test_without_webgl_it_says_so(page, tmp_path):
    from toy_report import toy_report

    write_report(tmp_path / "report.html", toy_report())
    other = page.context.new_page()
    other.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    other.goto((tmp_path / "report.html").as_uri())
    other.wait_for_selector("#viewer.failed")
    assert "needs WebGL 2" in other.inner_text("#viewer-message") and not other.locator(".controls").is_visible()
    other.close()
