"""The variant of Mitsuba that the tests of the plugins run in."""

from __future__ import annotations

import mitsuba as mi
import pytest

from genmf_mi.render import variant


@pytest.fixture(autouse=True)
def _mono():
    variant.use("cpu")


@pytest.fixture
def switch():
    """Any variant for one test; the usual one afterwards."""

    def to(name: str) -> None:
        if name not in mi.variants():
            pytest.skip(f"this Mitsuba has no variant {name}")
        if name.startswith("cuda") and not variant.cuda_available():
            pytest.skip("no CUDA device is visible to both torch and Dr.Jit")
        mi.set_variant(name)

    yield to
    variant.use("cpu")
