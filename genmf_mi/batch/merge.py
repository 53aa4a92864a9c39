"""What all shards of a batch came to: a table, a gallery, totals, and what to look at first."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import quote

from genmf_mi.batch import storage
from genmf_mi.batch.journal import BatchOutcome, latest, read
from genmf_mi.core.errors import OutputError
from genmf_mi.report.gallery import Part, gallery

TABLE, GALLERY = "outcomes.csv", "gallery.html"
WORST = 20
SHOWN = {
    "gain": "LPIPS gained, %",
    "lpips": "LPIPS",
    "lpips_before": "LPIPS before",
    "ssim": "SSIM",
    "relief_mean_mm": "relief, mm",
    "self_intersections": "self-intersections",
    "seconds": "seconds",
    "peak_memory_gb": "GB",
}
"""What the gallery shows and sorts by."""
_COLUMNS = ("name", "state", "cause", "error", "asset", "folder", "of", "seconds", "cpu_seconds", "peak_memory_gb",
            "attempts", "worker", "ended", "key")  # fmt: skip


@dataclass(frozen=True)
class Merged:
    """A batch as a whole.

    outcomes: the last of each item, by name. expected: how many items the batch has, as far as its shards have said.
    """

    out: str
    outcomes: list[BatchOutcome]
    expected: int

    @property
    def states(self) -> dict[str, int]:
        """How many items there are of each state."""
        return _counts([one.state for one in self.outcomes])

    @property
    def missing(self) -> int:
        """Items without an outcome."""
        return max(0, self.expected - len(self.outcomes))

    @property
    def causes(self) -> dict[str, int]:
        """How many failures there are of each cause, the most frequent one first."""
        return _counts([one.cause for one in self.outcomes if not one.good])

    @property
    def worst(self) -> list[BatchOutcome]:
        """The parts that gained least in LPIPS, the worst one first."""
        parts = [one for one in self.outcomes if gain(one) is not None]
        return sorted(parts, key=lambda one: (gain(one), one.name))[:WORST]

    def example(self, cause: str) -> BatchOutcome:
        """The first failure of this cause."""
        return next(one for one in self.outcomes if not one.good and one.cause == cause)

    def totals(self) -> list[tuple[str, str]]:
        """Names and values for a person."""
        made = [one for one in self.outcomes if one.state == "refined"]
        rows = [("items", f"{len(self.outcomes):,}" + (f" of {self.expected:,}" if self.missing else ""))]
        rows += [(state, f"{count:,}") for state, count in self.states.items()]
        if made:
            hours = sum(one.cpu_seconds for one in made) / 3600
            seconds = sorted(one.seconds for one in made)
            rows.append(("CPU hours", f"{hours:.2f}"))
            rows.append(("seconds, median and most", f"{seconds[len(seconds) // 2]:.0f} and {seconds[-1]:.0f}"))
            rows.append(("GB at most", f"{max(one.peak_memory_gb for one in made):.2f}"))
        gains = sorted(value for one in self.outcomes if (value := gain(one)) is not None)
        if gains:
            rows.append(("LPIPS gained, mean and worst", f"{sum(gains) / len(gains):.1f} % and {gains[0]:.1f} %"))
        return rows


def merge(out: str) -> Merged:
    """Read the journals of all shards in ``out``, a path or a URL, and write ``outcomes.csv`` and ``gallery.html``
    there.

    Raises:
        OutputError: there is no journal, or a file cannot be written.
    """
    records = read(out)
    outcomes = sorted(latest(records).values(), key=lambda one: one.name)
    if not records:
        raise OutputError(f"{out} holds no outcomes of a batch. Give the --out of `genmf-mi batch`.")
    # The last word of each shard of the last division into shards
    division, expected = "", dict[str, int]()
    for record in sorted((one for one in records if "batch" in one), key=lambda one: str(one.get("time"))):
        if str(record["batch"]).partition("/")[2] != division:
            division, expected = str(record["batch"]).partition("/")[2], {}
        expected[str(record["batch"])] = int(record.get("items") or 0)
    merged = Merged(out, outcomes, sum(expected.values()))
    storage.write_text(storage.join(out, TABLE), table(outcomes))
    title = storage.split(out)[1] or "batch"
    page = gallery(title, [_part(one) for one in outcomes], SHOWN, merged.totals())
    storage.write_text(storage.join(out, GALLERY), page)
    return merged


def gain(outcome: BatchOutcome) -> float | None:
    """By how many percent LPIPS is lower than before, None if that is not known."""
    before, after = outcome.scores.get("lpips_before"), outcome.scores.get("lpips")
    return 100 * (1 - after / before) if before and after is not None else None


def table(outcomes: Sequence[BatchOutcome]) -> str:
    """One line per item, as CSV."""
    scores = sorted({name for one in outcomes for name in one.scores})
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*_COLUMNS, "warnings", *scores])
    for one in outcomes:
        cells = [getattr(one, name) for name in _COLUMNS]
        writer.writerow([*cells, "; ".join(one.warnings), *(one.scores.get(name, "") for name in scores)])
    return text.getvalue()


def _part(outcome: BatchOutcome) -> Part:
    """How the gallery shows an outcome; a duplicate has the picture of what it repeats."""
    folder = quote(outcome.of or outcome.name)
    percent = gain(outcome)
    figures = {name: value for name in ("seconds", "peak_memory_gb") if (value := getattr(outcome, name))}
    scores = {**outcome.scores, **figures, **({} if percent is None else {"gain": round(percent, 2)})}
    text = f"the same work as {outcome.of}" if outcome.of else outcome.error.partition("\n")[0][:300]
    return Part(
        outcome.name,
        "refined" if outcome.state == "skipped" else outcome.state,
        f"{folder}/thumbnail.jpg" if outcome.good else "",
        f"{folder}/report.html" if outcome.good else "",
        text or "; ".join(outcome.warnings),
        {name: value for name, value in scores.items() if name in SHOWN},
    )


def _counts(words: Sequence[str]) -> dict[str, int]:
    counts = {word: words.count(word) for word in dict.fromkeys(words)}
    return dict(sorted(counts.items(), key=lambda pair: -pair[1]))
