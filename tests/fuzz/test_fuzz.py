"""Two hundred damaged inputs end in a part to refine or in an error of ours; ``make fuzz`` tries thousands."""

from __future__ import annotations

import json
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import pytest
from fuzz_mutators import inputs
from fuzz_seeds import KINDS, Case, seeds
from fuzz_worker import FOREIGN, READ, REFUSED, Worker

COUNT, WORKERS = 200, 2


@pytest.fixture(scope="module")
def workers():
    made = [Worker() for _ in range(WORKERS)]
    yield made
    for worker in made:
        worker.close()


def outcomes(workers: list[Worker], cases: list[Case], folder) -> list[dict]:
    """What became of each, half of them by either worker."""

    def share(first: int) -> dict[int, dict]:
        found = {}
        for number in range(first, len(cases), WORKERS):
            place = folder / str(number)
            place.mkdir()
            found[number] = workers[first].run(cases[number].kind, cases[number].write(place))
        return found

    with ThreadPoolExecutor(WORKERS) as pool:
        found = {number: answer for part in pool.map(share, range(WORKERS)) for number, answer in part.items()}
    return [found[number] for number in range(len(cases))]


def test_seeds_are_read(workers, tmp_path):
    """Or else the mutators start from what is refused anyway."""
    cases = [case for kind in KINDS for case in seeds(kind)]
    found = outcomes(workers, cases, tmp_path)
    refused = [(case.kind, answer) for case, answer in zip(cases, found, strict=True) if answer["outcome"] != READ]
    # A ramp of 16 bits that has the colour of its own background in the corners
    assert [kind for kind, _ in refused] == ["image"] and "empty" in refused[0][1]["error"]


def test_damaged_inputs(workers, tmp_path):
    each = -(-COUNT // len(KINDS))
    cases = [case for kind in KINDS for case in inputs(kind, 0, each)]
    assert len(cases) >= COUNT
    found = outcomes(workers, cases, tmp_path)
    faults = [
        (number, cases[number].kind, answer) for number, answer in enumerate(found) if answer["outcome"] == FOREIGN
    ]
    assert not faults, json.dumps(faults, indent=1)
    counts = Counter(answer["outcome"] for answer in found)
    assert counts[READ] > COUNT / 10 and counts[REFUSED] > COUNT / 10
    for answer in found:
        if answer["outcome"] == REFUSED:
            assert len(answer["error"]) > 20 and answer["error"].rstrip().endswith("."), answer["error"]
