"""``genmf-mi refine``, and its arguments, which ``batch`` and ``sweep`` pass on."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from shlex import split
from typing import TYPE_CHECKING, Any, Literal

import tyro

from genmf_mi.cli.arguments import Switch
from genmf_mi.core.config import PRESETS, RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.progress import Progress
from genmf_mi.core.regions import Regions

if TYPE_CHECKING:
    from genmf_mi.pipeline.results import Result

SHOWN = ("loss", "grey_lpips", "ssim", "teacher_depth", "stress_band")
"""Loss terms beside the bar."""


@dataclass(frozen=True)
class RefineArguments:
    """Turn a textured asset into a one-colour part whose relief shows the texture."""

    asset: tyro.conf.Positional[str]
    """A GLB, GLTF, OBJ, PLY, 3MF or STL file, or the name of a bundled sample; or Φ on a grid: the NPZ, safetensors or
    PT file of a generator (docs/generators.md), or the name of a sample with _sdf behind it."""
    textured: Path | None = None
    """The mesh that has the colours of a generator's file."""
    up: Literal["auto", "x", "-x", "y", "-y", "z", "-z"] = "auto"
    """The axis of the file that points upwards (--up=-z with the sign); auto: z for 3MF and STL, y otherwise."""
    files_anywhere: Switch = False
    """Let the asset name textures, materials and buffers outside of its own folder."""
    out: Path | None = None
    """Folder for the results; runs/NAME if not given."""
    preset: Literal["draft", "default", "paper"] = "default"
    """Where the settings start from: draft (half a minute), default, or paper (512 pixels, long)."""
    scene: Path | None = None
    """A scene file (see `genmf-mi scene`)."""
    reference: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """image.png@azimuth,elevation to match instead of the texture; may be given several times."""
    verify: Switch = False
    """Simulate the thermal stress before, without the stress stage and after; takes minutes."""
    print_check: Switch = False
    """Slice the part before and after, look at every bead, and score that; needs --printer fdm-*, takes minutes."""
    slicer: str = "auto"
    """For --print-check: auto for the one that is installed, own for ours, or a program."""
    force: Switch = False
    """Replace the run in the folder, once the new one is complete."""
    resume: Switch = False
    """Continue an interrupted run."""
    save_exr: Switch = False
    """Also write grey, depth, normal and coverage of every shape and view as OpenEXR."""
    json_progress: Switch = False
    """Progress as lines of JSON on standard output, and no table: for programs (docs/http_api.md)."""
    quiet: Switch = False
    """No progress, only warnings and the table."""
    config: RefineConfig = field(default_factory=RefineConfig)

    def options(self) -> dict[str, Any]:
        """What :func:`genmf_mi.pipeline.refinement.refine` takes as keywords besides folder and progress."""
        return {
            "textured": self.textured,
            "up": None if self.up == "auto" else self.up,
            "files_anywhere": self.files_anywhere,
            "scene": self.scene,
            "references": tuple(self.reference),
            "save_exr": self.save_exr,
        }


REGISTRY = tyro.constructors.ConstructorRegistry()
"""How settings are read that are more than words."""


@REGISTRY.primitive_rule
def _files(info: tyro.constructors.PrimitiveTypeInfo) -> tyro.constructors.PrimitiveConstructorSpec[Any] | None:
    """On the command line a file is named, whatever else Python takes in its place."""
    metavar = {str | Path | Regions | None: "FILE.json", str | Path | None: "FILE"}.get(info.type)  # type: ignore[call-overload]
    if metavar is None:
        return None
    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: words[0],
        is_instance=lambda value: value is None or isinstance(value, str | Path | Regions),
        str_from_instance=lambda value: [str(value)],
    )


def parse(arguments: list[str]) -> RefineArguments:
    """The arguments of ``genmf-mi refine``; the preset that they name sets the defaults of all other settings.

    Raises:
        SystemExit: after ``--help``, and for arguments that do not fit, which are explained on standard error.
        ConfigError: a setting out of range.
    """
    words = [word for argument in arguments for word in argument.split("=", 1)]
    named = [after for word, after in pairwise(words) if word == "--preset"]
    preset = PRESETS.get(named[-1] if named else "default", PRESETS["default"])
    return tyro.cli(
        RefineArguments,
        prog="genmf-mi refine",
        args=arguments,
        default=RefineArguments(asset=tyro.MISSING, config=preset),
        config=(tyro.conf.OmitArgPrefixes,),
        registry=REGISTRY,
    )


def parse_text(asset: str, arguments: str, command: str) -> RefineArguments:
    """The arguments that ``command`` passes on to each of its refinements, given as one text. Raises as
    :func:`parse`."""
    try:
        words = split(arguments)
    except ValueError as error:
        raise ConfigError(f"--arguments cannot be split into words: {error}. Close the quotes.") from error
    chosen = parse([asset, *words])
    if chosen.out or chosen.force or chosen.resume:
        raise ConfigError(
            f"--arguments cannot hold --out, --force or --resume: give the first two to the {command} itself, which "
            "resumes interrupted runs anyway."
        )
    return chosen


def main(arguments: list[str]) -> int:
    """Refine, and print the scores and where the files are."""
    chosen = parse(arguments)
    from genmf_mi.cli.progress import JsonProgress, TerminalProgress

    out = chosen.out or Path("runs") / Path(chosen.asset).stem
    try:
        if chosen.json_progress:
            _refine(chosen, out, JsonProgress())
            return 0
        with TerminalProgress(quiet=chosen.quiet, shown=SHOWN) as progress:
            result = _refine(chosen, out, progress)
    except (KeyboardInterrupt, SystemExit):
        from genmf_mi.pipeline.run_folder import RunFolder

        kept = RunFolder(out).interrupted
        print("continue with --resume" if kept else "stopped before anything was kept: start again", file=sys.stderr)
        raise
    print_result(result.metrics, result.out or out)
    if result.out != out:
        print(f"the run in {out} stays as it is until the new one is complete")
    return 0


def _refine(chosen: RefineArguments, out: Path, progress: Progress) -> Result:
    from genmf_mi.pipeline.refinement import refine

    return refine(
        chosen.asset,
        chosen.config,
        out=out,
        verify=chosen.verify,
        print_check=chosen.slicer if chosen.print_check else False,
        force=chosen.force,
        resume=chosen.resume,
        progress=progress,
        **chosen.options(),
    )


def print_result(metrics: dict, out: Path) -> None:
    """The contents of ``metrics.json`` as a person reads them, and the files to open first."""
    from genmf_mi.cli.tables import print_scores, print_table
    from genmf_mi.report import tables
    from genmf_mi.report.remarks import remarks

    print_scores(metrics)
    if stands := tables.stands(metrics):
        print_table("ways to stand on the print bed, the best one first", stands)
    if stress := tables.stress(metrics):
        print_table("thermal stress by finite elements, MPa", stress)
    if printed := metrics.get("as_printed"):
        from genmf_mi.cli.print_check import print_metrics

        print_metrics(printed)
    relief, solid = metrics["relief_mm"], metrics["solid"]
    print(
        f"relief: at most {relief['max']:.2f} mm, mean {relief['mean']:.2f} mm; "
        f"{'watertight' if solid['watertight'] else 'NOT watertight'}, {solid['bodies']} "
        f"{'component' if solid['bodies'] == 1 else 'components'}, "
        f"{solid['self_intersections']} self-intersections; {metrics['seconds']['total']:.0f} s"
    )
    for remark in remarks(metrics):
        print(f"note: {remark}")
    if metrics["interrupted"]:
        print(f"interrupted after {metrics['iterations']} iterations: the part so far. Continue with --resume.")
    print(f"print {out / 'refined.3mf'}, look at {out / 'report.html'}")
