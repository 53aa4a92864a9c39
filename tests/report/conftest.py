"""What the tests of the report share."""

from __future__ import annotations

import pytest
from toy_report import toy_report

from genmf_mi.report import Report


@pytest.fixture
def report() -> Report:
    return toy_report()
