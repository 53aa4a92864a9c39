"""``make bench``: every benchmark that needs no real assets, and with ``GENMF_TEST_ASSETS`` the assets too.

``python -m benchmarks rendering memory assets`` runs some of them. Each writes ``benchmarks/results/NAME.json``.
"""

from __future__ import annotations

import os
import sys

from benchmarks import assets, flexicubes, memory, rendering

BENCHMARKS = {"rendering": rendering.main, "memory": memory.main, "flexicubes": flexicubes.main, "assets": assets.main}


def main(names: list[str]) -> int:
    unknown = set(names) - set(BENCHMARKS)
    if unknown:
        print(
            f"error: there is no benchmark {', '.join(sorted(unknown))}; choose of {', '.join(BENCHMARKS)}",
            file=sys.stderr,
        )
        return 2
    for name in names or BENCHMARKS:
        if name == "assets" and not os.environ.get("GENMF_TEST_ASSETS"):
            print("assets: skipped, GENMF_TEST_ASSETS names no folder of textured meshes")
            continue
        BENCHMARKS[name]()
    return 0


sys.exit(main(sys.argv[1:]))
