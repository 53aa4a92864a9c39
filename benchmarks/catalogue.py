"""Every benchmark: which file it writes, what it needs, and where its figures are quoted.

The menu of ``python -m benchmarks`` and the table in ``results/README.md`` are made from this list, and the tests
compare it with what lies in the folders.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

from benchmarks.inputs import Inputs, Needed


class Main(Protocol):
    """The entry function of a benchmark; its further parameters, if any, have defaults and become options."""

    def __call__(self, inputs: Inputs) -> None: ...


@dataclass(frozen=True)
class Benchmark:
    """One module with a function ``main(inputs, ...)``.

    name: the module, below ``benchmarks``. result: the file that it writes to ``results/``.
    measures: one line for the menu. needs: inputs without which it cannot run; optional: those that it can use.
    minutes: on two CPU cores, about. quoted: where the figures appear.
    """

    name: str
    result: str
    measures: str
    minutes: int
    quoted: str
    needs: tuple[Needed, ...] = ()
    optional: tuple[Needed, ...] = ()

    @property
    def command(self) -> str:
        """What makes the result file."""
        options = [f"--{name} {name.upper()}" for name in self.needs]
        options += [f"[--{name} {name.upper()}]" for name in self.optional]
        return " ".join(["python -m benchmarks", self.name, *options])

    def main(self) -> Main:
        """The entry function; its module is imported now."""
        return import_module(f"benchmarks.{self.name}").main


VERIFICATION, BATCH = "stress_verification.json", "batch.json"
CATALOGUE = (
    Benchmark("rendering", "rendering.json", "milliseconds per view beside stock Mitsuba", 5, "not quoted"),
    Benchmark("memory", "memory.json", "whether a long refinement keeps its memory flat", 6, "not quoted"),
    Benchmark("flexicubes", "flexicubes.json", "seconds of FlexiCubes at 129³, forward and backward", 2, "not quoted"),
    Benchmark("alignment_ladder", "alignment_ladder.json", "which alignment ranks parts as a person does", 2,
              "docs/appearance.md"),
    Benchmark("legibility", "legibility.json", "how well letters, eyes and lines of the plaque can be read", 5,
              "docs/appearance.md"),
    Benchmark("iteration_cost", "iteration_cost.json", "where the time of a run and of an iteration goes", 1,
              "docs/appearance.md", ("assets",)),
    Benchmark("assets", "assets.json", "scores, seconds and memory of eight assets", 10, "README, What it gives",
              ("assets",)),
    Benchmark("comparison", "comparison.json", "ours beside what slicers and relief tools do", 14,
              "README, What it gives", ("assets",)),
    Benchmark("as_printed", "as_printed.json", "what is left of the look in filament, by the gate", 40,
              "docs/printing.md; README", ("assets",)),
    Benchmark("print_bound", "print_bound.json", "how much of the look filament can hold at all", 20,
              "docs/printing.md", ("assets",)),
    Benchmark("batch_throughput", BATCH, "parts per hour of warm workers, and of a process per asset", 25,
              "docs/batch.md, Throughput"),
    Benchmark("batch_faults", BATCH, "whether batches are complete however they are killed", 30,
              "docs/batch.md, Killed"),
    Benchmark("batch_large", BATCH, "first start, second call and gallery of ten thousand items", 3,
              "docs/batch.md, Table and gallery"),
    Benchmark("batch_simulation", BATCH, "100,000 assets on 1000 workers, simulated", 1,
              "docs/batch.md, A hundred thousand"),
    Benchmark("sdf_route", "sdf_route.json", "the same from the field instead of the mesh", 70,
              "README, Mesh or field?; docs/generators.md", ("assets",)),
    Benchmark("stress_stage", "stress_stage.json", "five assets with and without the stress stage", 40,
              "docs/stress.md, What relief does to the stress", ("assets",)),
    Benchmark("stress_regime", "stress_regime.json", "what relief adds to the stress: caps, routes, weights", 120,
              "docs/stress.md, What relief does to the stress", ("assets",)),
    Benchmark("stress_limit", "stress_limit.json", "how far relief can lower the stress at all", 12,
              "docs/stress.md, What relief does to the stress", ("assets",)),
    Benchmark("stress_table", "stress_table.json", "stress, nodes and seconds of 42 shapes", 60,
              "docs/stress.md, Costs", ("meshes", "assets")),
    Benchmark("stress_gradient", "stress_gradient.json", "one step along the network's gradient", 15,
              "docs/stress.md, In a refinement; docs/model_card.md", ("data",), ("weights",)),
    Benchmark("stress_network_cost", "stress_network_cost_1.json", "seconds of one pass of the stress network", 10,
              "not quoted"),
    Benchmark("stress_network_scores", "stress_network_scores.json", "test scores of the network and of baselines", 20,
              "docs/model_card.md, How good it is", ("data",), ("finer", "weights")),
    Benchmark("page", "page.json", "how quickly the page answers: a dropped file, and requests beside a job", 3,
              "docs/ui.md, Speed"),
    Benchmark("fuzz", "fuzz.json", "what becomes of 5000 damaged inputs of every kind that is read", 15,
              "CONTRIBUTING.md, Damaged inputs"),
    Benchmark("verification.hollow_sphere", VERIFICATION, "order of convergence on a hollow sphere", 3,
              "docs/stress.md, Verification"),
    Benchmark("verification.assembly", VERIFICATION, "P1 matrices: our kernels beside scikit-fem", 1,
              "docs/stress.md, Costs"),
    Benchmark("verification.nafems_le11", VERIFICATION, "NAFEMS LE11 with linear and quadratic elements", 2,
              "docs/stress.md, Verification"),
    Benchmark("verification.calculix", VERIFICATION, "CalculiX on the same meshes; needs the program ccx", 15,
              "docs/stress.md, Verification", ("meshes",)),
    Benchmark("verification.convergence", VERIFICATION, "mesh convergence on seven shapes", 5,
              "docs/stress.md, Verification", ("meshes",)),
    Benchmark("verification.relief", VERIFICATION, "what relief on a ball does to the stress", 10,
              "docs/stress.md, Verification"),
    Benchmark("verification.relief_flat_cap", VERIFICATION, "the same on a flat cap that is all base", 2,
              "docs/stress.md, Verification"),
    Benchmark("verification.bunny_simulate", VERIFICATION, "CPU seconds of `stress simulate` by stage", 1,
              "docs/stress.md, Costs", ("meshes",)),
)  # fmt: skip
BY_NAME = {benchmark.name: benchmark for benchmark in CATALOGUE}


def menu() -> str:
    """The catalogue as a person reads it on a terminal."""
    rows = [("benchmark", "results/", "needs", "minutes", "measures")]
    for one in CATALOGUE:
        needs = " ".join([*(f"--{name}" for name in one.needs), *(f"[--{name}]" for name in one.optional)])
        rows.append((one.name, one.result, needs or "nothing", str(one.minutes), one.measures))
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    return "\n".join("  ".join([*(cell.ljust(width) for cell, width in zip(row, widths)), row[4]]) for row in rows)


def markdown() -> str:
    """The table of ``results/README.md``."""
    lines = ["| file | command | minutes | quoted in |", "|---|---|---|---|"]
    for one in CATALOGUE:
        lines.append(f"| [{one.result}]({one.result}) | `{one.command}` | {one.minutes} | {one.quoted} |")
    return "\n".join(lines)
