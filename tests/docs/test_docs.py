"""The documentation against the code: settings, modules that it names, links, and the snippets of docs/api.md."""

from __future__ import annotations

import importlib.util
import inspect
import re
from dataclasses import fields, replace
from pathlib import Path

import pytest
from toys import painted

import genmf_mi
from genmf_mi.core import errors
from genmf_mi.core.config import RefineConfig, Weights
from genmf_mi.pipeline.print_check import PrintCheck

ROOT = Path(__file__).parents[2]
PAGES = sorted([*(ROOT / "docs").glob("*.md"), ROOT / "benchmarks" / "results" / "README.md"])
API = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", API, flags=re.S)


def test_settings_are_those_of_the_code():
    spec = importlib.util.spec_from_file_location("update_api", ROOT / "docs" / "update_api.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    source = module.CONFIG.read_text(encoding="utf-8")
    assert module.updated(API, source) == API, "run: python docs/update_api.py"
    for kind in (RefineConfig, Weights):
        assert all(f"| `{field.name}` |" in API for field in fields(kind))


def test_everything_public_is_described():
    names = [name for name, kind in vars(errors).items() if inspect.isclass(kind)]
    for name in [*genmf_mi.__all__, *names]:
        assert f"`{name}`" in API
    for name in [*inspect.signature(genmf_mi.refine).parameters, *inspect.signature(genmf_mi.run_batch).parameters]:
        assert f"`{name}`" in API


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_modules_and_links_exist(page):
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"`(genmf_mi/[\w/.]+|benchmarks/[\w/.]+|examples/[\w/.]+)`", text):
        assert (ROOT / name).exists(), name
    for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text):
        assert link.startswith("http") or (page.parent / link).exists(), link
    for statement in re.findall(r"^(?:from (genmf_mi[\w.]*) import|import (genmf_mi[\w.]*))", text, flags=re.M):
        assert importlib.util.find_spec(next(filter(None, statement))) is not None, statement


@pytest.mark.usefixtures("small_refinements")
def test_snippets_run(workplace, two_views, monkeypatch):
    """In this order, in one namespace; refinements are small ones of a painted egg, evaluations and print checks are
    not made."""
    painted("bus.ply")
    real_refine, real_evaluate, real_check = genmf_mi.refine, genmf_mi.evaluate, genmf_mi.print_check
    real_batch = genmf_mi.run_batch

    def refine(asset, config=None, **options):
        small = {"iterations": 2, "resolution": 96, "score_vgg": False, "stress": False, "device": "cpu"}
        return real_refine(asset, replace(config or RefineConfig(), **small), scene=two_views, **options)

    def evaluate(original, refined, **options):
        inspect.signature(real_evaluate).bind(original, refined, **options)
        assert Path(refined).is_file()
        return {"before": {"ssim": 0.8}, "after": {"ssim": 0.9}}

    def print_check(part, textured=None, **options):
        inspect.signature(real_check).bind(part, textured, **options)
        assert Path(part).is_file()
        return PrintCheck({"lamps": {"after": {"lpips_alex": 0.2}}}, {}, [])

    def run_batch(items, config=None, **options):
        inspect.signature(real_batch).bind(items, config, **options)
        return iter([genmf_mi.BatchOutcome(genmf_mi.BatchItem(items[0]).folder_name, "refined")])

    monkeypatch.setattr(genmf_mi, "run_batch", run_batch)
    monkeypatch.setattr(genmf_mi, "print_check", print_check)
    monkeypatch.setattr(genmf_mi, "refine", refine)
    monkeypatch.setattr(genmf_mi, "evaluate", evaluate)
    namespace: dict[str, object] = {}
    for snippet in SNIPPETS:
        exec(compile(snippet.replace("bus.glb", "bus.ply"), "docs/api.md", "exec"), namespace)
    assert {"result", "scores", "pyramid", "field", "part"} <= set(namespace)
