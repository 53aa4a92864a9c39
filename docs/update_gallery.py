"""Writes docs/gallery.md, and its pictures from a folder of runs of the bundled samples.

    for name in doll vase beanie ...; do
        genmf-mi refine $name
        genmf-mi print-check runs/$name --textured $name --json > runs/$name/as_printed.json
    done
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
LIGHTS = {"two_lights": "printed, even light", "lamps": "printed, under lamps"}
"""As print-check looks at a part, and what the page calls it."""
HEAD = """# Gallery

Ten samples of our own are in the package, and each can be refined by its name. `genmf-mi samples` writes them as GLB.

![The ten samples](gallery/samples.jpg)

All are 100 mm, with the settings that a command without any has: relief of at most 1 mm, for a printer that
leaves no layers to be seen. The first picture of each is of the smooth surface, from two sides: the textured
object, what prints in one colour today, the refined part. The second is of the same part bead by bead in
filament of 0.2 mm, as PrusaSlicer lays it (`genmf-mi print-check`), in even light and under two lamps with
shadows; what fine layers or resin keep is partly lost there, and `--printer fdm-0.2` makes the relief for it
([printing](printing.md)). LPIPS is better when lower, SSIM when higher; *displacement* is the best of six that
follow the brightness. `docs/update_gallery.py` makes the page.
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
    return [f"## {name}", "", described(name), "", "```sh", f"genmf-mi refine {name}", "```", ""]


def section(name: str, run: Path) -> str:
    """What is known of a sample: the pictures and the numbers of its run, if that is finished."""
    lines = introduced(name)
    if not (run / "metrics.json").is_file():
        return "\n".join(lines).rstrip() + "\n"
    metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    jpeg(run / "before_after.png", PICTURES / f"{name}.jpg")
    lines += [f"![{name}: textured, as it prints today, refined](gallery/{name}.jpg)", ""]
    scored = {"smooth": metrics}
    if (printed := run / "as_printed.json").is_file():
        as_printed = json.loads(printed.read_text(encoding="utf-8"))
        scored |= {label: as_printed[light] for light, label in LIGHTS.items()}
        jpeg(run / "as_printed.png", PICTURES / f"{name}_printed.jpg")
        lines += [f"![{name}, bead by bead, in filament of 0.2 mm](gallery/{name}_printed.jpg)", ""]
    relief = metrics["relief_mm"]
    said = f"Relief: mean {relief['mean']:.2f} mm, at most {relief['max']:.2f} mm."
    return "\n".join([*lines, *table(scored), "", said]) + "\n"


def table(scored: dict[str, dict]) -> list[str]:
    """LPIPS and SSIM of the shapes, by how they are looked at."""
    rows = ["| | | as it is | displacement | refined |", "|---|---|---|---|---|"]
    for label, scores in scored.items():
        for key, metric, best in (("lpips_alex", "LPIPS", min), ("ssim", "SSIM", max)):
            values = [scores.get(shape, {}).get(key) for shape in ("before", "displacement", "after")]
            leader = best(value for value in values if value is not None)
            words = ["" if v is None else f"**{v:.3f}**" if v == leader else f"{v:.3f}" for v in values]
            rows.append(f"| {label} | {metric} | {' | '.join(words)} |")
    return rows


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
