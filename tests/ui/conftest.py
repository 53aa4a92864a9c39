"""A server of the page, and a stand-in for ``genmf-mi refine``."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from page_server import Client, Served
from stub_refine import PROGRAM

from genmf_mi.ui import processes


@pytest.fixture
def stub(monkeypatch) -> None:
    """Jobs run a stand-in for the refinement, which takes a second and obeys the same files."""
    monkeypatch.setattr(processes, "PROGRAM", PROGRAM)


@pytest.fixture(autouse=True)
def no_niceness(monkeypatch) -> None:
    """Beside other work on the machine of the tests nothing would come of low priority."""
    monkeypatch.setattr(processes, "NICE", 0)


@pytest.fixture
def served(tmp_path) -> Iterator[Served]:
    server = Served(tmp_path / "workspace")
    yield server
    server.stop()


@pytest.fixture
def client(served) -> Client:
    return served.client
