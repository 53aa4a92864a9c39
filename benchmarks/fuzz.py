"""Thousands of damaged and hostile inputs of every kind that is read: what becomes of each, by kind and outcome.

Inputs and their process are those of the tests in ``tests/fuzz``; an input is known by its kind, its chunk and its
number in it, and made again from these. What was tried already, with the same seed, is not tried again.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks import record
from benchmarks.inputs import Inputs

TESTS = Path(__file__).parents[1] / "tests"
CHUNK = 50
"""Inputs that are made together."""


def main(inputs: Inputs, *, count: int = 5000, seed: int = 0, only: str = "", again: str = "") -> None:
    """Try damaged inputs, each in a process that may take 60 s and 2 GB.

    Args:
        inputs: What all benchmarks have in common; log and failing inputs go to its folder ``out``.
        count: Inputs in all, the same number of every kind.
        seed: Of the inputs.
        only: This kind alone.
        again: Try one input again, as a finding names it (KIND/CHUNK/NUMBER), and nothing else.
    """
    sys.path[:0] = [str(TESTS), str(TESTS / "fuzz")]
    import fuzz_seeds

    kinds = [only] if only else list(fuzz_seeds.KINDS)
    folder = inputs.out / f"fuzz_{seed}"
    if again:
        kind, chunk, number = again.split("/")
        print(json.dumps(attempt(folder, seed, kind, int(chunk), int(number)), indent=1))
        return
    log = folder / "log.jsonl"
    folder.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()] if log.exists() else []
    known = {line["input"]: line for line in lines}
    each = -(-count // len(kinds))
    wanted = [(chunk, kind) for chunk in range(-(-each // CHUNK)) for kind in kinds]
    with log.open("a", encoding="utf-8") as file:
        for chunk, kind in wanted:
            for number in range(min(CHUNK, each - chunk * CHUNK)):
                name = f"{kind}/{chunk}/{number}"
                if name in known:
                    continue
                line = known[name] = {"input": name, **attempt(folder, seed, kind, chunk, number)}
                print(json.dumps(line), file=file, flush=True)
                if line["outcome"] == "foreign":
                    tell(line, folder, seed)
    if not only:
        record.write("fuzz", summary(list(known.values()), seed))


def attempt(folder: Path, seed: int, kind: str, chunk: int, number: int) -> dict[str, Any]:
    """What becomes of one input; its files stay in ``folder`` if it is a finding."""
    import shutil

    import fuzz_mutators

    made = fuzz_mutators.inputs(kind, seed * 1_000_000 + chunk, CHUNK)
    if number >= len(made):
        return {"outcome": "none", "error": "", "where": "", "seconds": 0.0, "megabytes": 0}
    place = folder / f"{kind}-{chunk}-{number}"
    place.mkdir(parents=True, exist_ok=True)
    answer = worker().run(kind, made[number].write(place.resolve()))
    if answer["outcome"] != "foreign":
        shutil.rmtree(place, ignore_errors=True)
    else:
        made[number].write(place)
    return answer


def worker() -> Any:
    """The process of all inputs."""
    from fuzz_worker import Worker

    if not hasattr(worker, "one"):
        worker.one = Worker()
    return worker.one


def tell(line: dict[str, Any], folder: Path, seed: int) -> None:
    """Print a finding."""
    place = folder / line["input"].replace("/", "-")
    print(f"FOUND {line['input']}: {line['error']}\n{line['where'][-800:]}")
    print(f"  files in {place}; again: python -m benchmarks fuzz --seed {seed} --again {line['input']}", flush=True)


def summary(lines: list[dict[str, Any]], seed: int) -> dict[str, Any]:
    """Counts by kind and outcome, and the largest of times and sizes."""
    lines = [line for line in lines if line["outcome"] != "none"]
    kinds = sorted({line["input"].partition("/")[0] for line in lines})
    counts = {
        kind: Counter(line["outcome"] for line in lines if line["input"].startswith(f"{kind}/")) for kind in kinds
    }
    return {
        "seed": seed,
        "inputs": len(lines),
        "outcomes": dict(Counter(line["outcome"] for line in lines)),
        "by_kind": {kind: dict(count) for kind, count in counts.items()},
        "seconds_largest": max(line["seconds"] for line in lines),
        "megabytes_largest": max(line["megabytes"] for line in lines),
    }
