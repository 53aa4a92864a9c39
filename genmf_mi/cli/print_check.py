"""``genmf-mi print-check``."""

from __future__ import annotations

from pathlib import Path

from genmf_mi.cli.arguments import call


def print_check(
    part: Path,
    textured: Path | None = None,
    printer: str | None = None,
    slicer: str = "auto",
    size_mm: float | None = None,
    scene: Path | None = None,
    out: Path | None = None,
    json: bool = False,
    quiet: bool = False,
) -> int:
    """Slice a part as a print shop would, look at every bead that can be seen, and say how much is left of the look,
    and whether the part can be printed.

    Args:
        part: The one-colour part, e.g. refined.3mf, or the folder of a run, whose part is printed the way up that the
            run chose.
        textured: The textured asset that it should look like; without it nothing is scored.
        printer: fdm-0.2, fdm-0.12 or fdm-0.08: filament in layers of so many mm; that of the run, or fdm-0.2, if not
            given.
        slicer: auto for the one that is installed, own for a simpler one of ours, or a program (PrusaSlicer).
        size_mm: Longest side of the part; that of the run, or 100, if not given.
        scene: A scene file; the sample's own or the default one if not given.
        out: Where the picture goes; as_printed.png beside the part if not given.
        json: Print JSON instead of tables.
        quiet: No progress, only warnings and the table.
    """
    from genmf_mi.cli.progress import TerminalProgress
    from genmf_mi.pipeline import print_check as checks
    from genmf_mi.pipeline.run_folder import AS_PRINTED

    with TerminalProgress(quiet=quiet or json) as progress:
        check = checks.print_check(
            part, textured, printer=printer, slicer=slicer, size_mm=size_mm, scene=scene, progress=progress
        )
        picture = out or (part if part.is_dir() else part.parent) / AS_PRINTED
        check.write(picture)
    if json:
        from json import dumps

        print(dumps(check.metrics, indent=2))
    else:
        print_metrics(check.metrics)
        print(f"look at {picture}")
    return 0


def print_metrics(metrics: dict) -> None:
    """What the slicer says, and the scores."""
    from genmf_mi.cli.tables import print_scores

    for light, title in (("two_lights", "in even light"), ("lamps", "under lamps")):
        if light in metrics:
            print_scores({"asset": f"as printed, {title}", **metrics[light]})
    for name, report in metrics["parts"].items():
        print(f"{name}: {', '.join(_words(report))} ({metrics['printer']}, {metrics['slicer']})")
        print(f"  {report['printability']['verdict']}")
        for reason in report["printability"]["reasons"]:
            print(f"  - {reason}")
        for warning in report.get("warnings", ()):
            print(f"  {metrics['slicer']} warns: {warning}")


def _words(report: dict) -> list[str]:
    words = [f"{report['layers']} layers"]
    if seconds := report.get("print_seconds"):
        words.append(f"{seconds // 3600:.0f} h {seconds % 3600 // 60:.0f} min")
    if grams := report.get("grams"):
        words.append(f"{grams:.0f} g")
    if supports := report.get("supports_share"):
        words.append(f"{supports:.0%} of it supports")
    words.append(f"{report['printability']['too_thin_mm2']:.0f} mm² of the outlines too thin for the nozzle")
    return words


def main(arguments: list[str]) -> int:
    """Read the arguments, slice and look."""
    return call(print_check, "print-check", arguments)
