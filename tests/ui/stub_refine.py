"""Stands in for ``genmf-mi refine --json-progress``: the same lines and files, without the work.

The name of the asset says what it does: ``slow`` waits until it is stopped, ``fails`` ends with an error, ``dies`` is
killed.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

PROGRAM = (sys.executable, str(Path(__file__)))
STEPS = 6


def say(**event) -> None:
    print(json.dumps({"at": time.time(), **event}), flush=True)


def main() -> None:
    asset, words = Path(sys.argv[2]).stem, sys.argv
    run = Path(words[words.index("--out") + 1])
    run.mkdir(exist_ok=True)
    (run / "words.json").write_text(json.dumps(words))
    (run / "config.yaml").write_text("asset: stub\n")
    say(stage="refining")
    checkpoint = run / "checkpoint.pt"
    first = int(checkpoint.read_text()) if "--resume" in words else 0
    interrupted = False
    for step in range(first, 10_000 if asset == "slow" else STEPS):
        whole = checkpoint.with_suffix(".new")
        whole.write_text(str(step + 1))
        os.replace(whole, checkpoint)
        (run / "preview.png").write_bytes(b"\x89PNG")
        say(done=step + 1, total=STEPS, values={"loss": 1 / (step + 1)})
        time.sleep(0.05)
        if (run / "stop").exists():
            interrupted = True
            break
        if asset == "fails":
            print("error: this one is broken. Export it again.", file=sys.stderr)
            sys.exit(2)
        if asset == "dies" and "--resume" not in words:
            os.kill(os.getpid(), signal.SIGKILL)
    for name in ("refined.3mf", "refined.stl", "report.html"):
        (run / name).write_text(f"{name} of {asset}")
    (run / "preview.png").unlink()
    if not interrupted:
        checkpoint.unlink()
    (run / "metrics.json").write_text(json.dumps({"interrupted": interrupted}))


if __name__ == "__main__":
    main()
