"""Writes docs/gallery.md, and its pictures from a folder of runs of the bundled samples.

    for name in doll vase beanie ...; do genmf-mi refine $name --printer fdm-0.2; done
    genmf-mi print-check runs/vase --textured vase     # adds the picture as printed; takes minutes
    python docs/update_gallery.py runs

Samples without a finished run keep what the page has of them. Pictures are JPEG of at most 1000 pixels width.
"""

from __future__ import annotations

import json
import platform
import re
import sys
from importlib import import_module
from pathlib import Path

from PIL import Image

from genmf_mi.assets.samples import NAMES

PAGE = Path(__file__).with_name("gallery.md")
PICTURES = Path(__file__).with_name("gallery")
WIDTH = 1000
HEAD = """# Gallery

Ten samples of our own are in the package, and each can be refined by its name. `genmf-mi samples` writes them as GLB.

![The ten samples](gallery/samples.jpg)

Where a run is shown, the textured object is on the left, what prints in one colour today in the middle, the refined
part on the right; all 100 mm, the cap of the relief 1 mm. Numbers are from its `metrics.json`; LPIPS is better when
lower, SSIM when higher. `docs/update_gallery.py` makes the page.
"""


def jpeg(source: Path, target: Path) -> None:
    """A smaller copy of a picture."""
    target.parent.mkdir(exist_ok=True)
    with Image.open(source) as image:
        picture = image.convert("RGB")
    height = round(picture.height * WIDTH / picture.width)
    picture.resize((WIDTH, height), Image.Resampling.LANCZOS).save(target, quality=85, optimize=True)


def described(name: str) -> str:
    """What the sample's module says it is, as one sentence without what follows a colon."""
    text = " ".join((import_module(f"genmf_mi.assets.samples.{name}").__doc__ or "").split("\n\n")[0].split())
    return text.rstrip(".") + "."


def introduced(name: str) -> list[str]:
    """Heading, description and command of a sample."""
    command = f"genmf-mi refine {name} --printer fdm-0.2"
    return [f"## {name}", "", described(name), "", "```sh", command, "```", ""]


def section(name: str, run: Path) -> str:
    """What is known of a sample: the picture and the numbers of its run, if that is finished."""
    lines = introduced(name)
    if not (run / "metrics.json").is_file():
        return "\n".join(lines).rstrip() + "\n"
    metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    jpeg(run / "before_after.png", PICTURES / f"{name}.jpg")
    before, best, after = metrics["before"], metrics["displacement"], metrics["after"]
    lines += [f"![{name}: textured, as it prints today, refined](gallery/{name}.jpg)", ""]
    rows = ["| | as it is | best displacement | refined |", "|---|---|---|---|"]
    for key, label in (("lpips_alex", "LPIPS"), ("ssim", "SSIM"), ("g_ssim", "g-SSIM")):
        rows.append(f"| {label} | {before[key]:.3f} | {best[key]:.3f} | **{after[key]:.3f}** |")
    relief = metrics["relief_mm"]
    lines += [*rows, "", f"Relief: mean {relief['mean']:.2f} mm, at most {relief['max']:.2f} mm."]
    printed = run / "as_printed.png"
    if printed.is_file():
        jpeg(printed, PICTURES / f"{name}_printed.jpg")
        lines += ["", f"![{name}, bead by bead, in filament of 0.2 mm](gallery/{name}_printed.jpg)"]
    return "\n".join(lines) + "\n"


def main(runs: Path) -> None:
    """Replace the sections of the samples that have a finished run."""
    page = PAGE.read_text(encoding="utf-8") if PAGE.is_file() else ""
    kept = {part.split("\n", 1)[0]: f"## {part}" for part in re.split(r"^## ", page, flags=re.M)[1:]}
    for name in NAMES:
        if name not in kept or (runs / name / "metrics.json").is_file():
            kept[name] = section(name, runs / name)
    text = "\n".join([HEAD, *(kept[name].rstrip() + "\n" for name in NAMES if name in kept)])
    PAGE.write_text(text, encoding="utf-8")
    print(f"{PAGE.name}: {', '.join(name for name in NAMES if name in kept)} ({platform.machine()})")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "runs"))
