"""``genmf-mi merge``: what a batch came to, from the journals of all its shards."""

from __future__ import annotations

from typing import TYPE_CHECKING

from genmf_mi.cli.arguments import call

if TYPE_CHECKING:
    from genmf_mi.batch.merge import Merged


def merge(out: str) -> int:
    """Write a table (outcomes.csv) and a gallery (gallery.html) of a batch into its folder, and print totals, failures
    by cause, and the parts that gained least.

    It only reads what shards have written so far, so it can be run at any time. Exit code 1 if an item failed or has no
    outcome yet.

    Args:
        out: The --out of the batch, a folder or a URL.
    """
    from genmf_mi.batch.merge import GALLERY, TABLE
    from genmf_mi.batch.merge import merge as merged_outcomes
    from genmf_mi.batch.storage import join

    merged = merged_outcomes(out)
    print_merged(merged)
    print(f"table in {join(out, TABLE)}, pictures in {join(out, GALLERY)}")
    return int(bool(merged.causes or merged.missing))


def print_merged(merged: Merged) -> None:
    """Totals, failures, the worst."""
    from genmf_mi.batch.merge import gain
    from genmf_mi.cli.tables import print_table
    from genmf_mi.report.tables import TextTable

    print("\n".join(f"{name}: {value}" for name, value in merged.totals()))
    if merged.missing:
        print(f"{merged.missing:,} items have no outcome yet: start the batch again, it goes on.")
    for cause, count in merged.causes.items():
        first = merged.example(cause)
        print(f"failed by {cause}: {count:,}, such as {first.name}: {first.error.partition(chr(10))[0]}")
    if merged.worst:
        rows = [
            [one.name, f"{gain(one):.1f}", f"{one.scores['lpips_before']:.4f}", f"{one.scores['lpips']:.4f}"]
            for one in merged.worst
        ]
        print_table("gained least", TextTable(["item", "LPIPS gained, %", "before", "after"], rows))


def main(arguments: list[str]) -> int:
    """Read the arguments and merge."""
    return call(merge, "merge", arguments)
