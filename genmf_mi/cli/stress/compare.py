"""``genmf-mi stress compare``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tyro.conf import Positional

from genmf_mi.cli.progress import TerminalProgress
from genmf_mi.core.files import claim_folder
from genmf_mi.core.progress import PrefixedProgress
from genmf_mi.stress.fem.protocol import Protocol

FILES = ("compare.json", "compare.png")


def compare(
    a: Positional[Path],
    b: Positional[Path],
    /,
    out: Path | None = None,
    size_mm: float = 100.0,
    edge_mm: float = 1.2,
    grid: int = 129,
    material: str = "pla",
    protocol: Protocol = Protocol(),  # noqa: B008  (frozen)
    picture: bool = True,
    force: bool = False,
) -> None:
    """Simulate two shapes alike and compare the stress of B with that of A; writes compare.json and compare.png.

    Args:
        a: The shape before, a mesh file.
        b: The shape after. In the units of A it keeps its size relative to A; else its longest side is size_mm too.
        out: Folder for the results; runs/A-B-stress if not given.
        size_mm: Longest side of A.
        edge_mm: Side of the lattice that the tetrahedra come from.
        grid: Samples per axis of the distance field that the shapes are read from.
        material: pla, petg, abs or resin.
        protocol: What is simulated.
        picture: Render compare.png.
        force: Replace existing results.
    """
    from genmf_mi.cli.stress.shared import caption, simulate_file, warn_of_losses
    from genmf_mi.stress.fem.settings import Settings
    from genmf_mi.stress.fem.statistics import summary_with_warpage
    from genmf_mi.stress.report import output
    from genmf_mi.stress.report.comparison import layer_ratio, ratios, relative_size

    settings = Settings(size_mm, edge_mm, grid, material, protocol)
    out = out or Path("runs") / f"{a.stem}-{b.stem}-stress"
    claim_folder(out, "comparison", finished=FILES, force=force)
    with TerminalProgress() as progress:
        before = simulate_file(a, settings, PrefixedProgress(progress, f"{a.stem}: "))
        settings = replace(settings, size_mm=size_mm * relative_size(before.frame, b))
        after = simulate_file(b, settings, PrefixedProgress(progress, f"{b.stem}: "))
        shapes = {
            key: {"asset": path.name, **summary_with_warpage(one, PrefixedProgress(progress, f"{path.stem}: "))}
            for key, path, one in (("a", a, before), ("b", b, after))
        }
        progress.stage("writing")
        ratio = ratios(shapes["a"], shapes["b"])
        if (layer := layer_ratio(before, after)) is not None:
            ratio["surface_layer_mean"] = layer
        if picture:
            from genmf_mi.stress.report.picture import write_picture

            write_picture(
                out / "compare.png",
                [(f"{a.stem}: {caption(shapes['a'])}", before), (f"{b.stem}: {caption(shapes['b'])}", after)],
                f"{a.stem} and {b.stem}",
            )
        output.write_json(out / "compare.json", {**shapes, "ratio": ratio})
        for path, key in ((a, "a"), (b, "b")):
            warn_of_losses(path, shapes[key], progress)
    print(f"{b.name} over {a.name}: " + ", ".join(f"{key} × {value:.3f}" for key, value in ratio.items()))
    print(f"results in {out}")
