"""The command ``genmf-mi``.

Only the standard library and tyro are imported until a command runs, so that ``--help`` answers at once.
"""

from __future__ import annotations

import gc
import io
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import tyro

from genmf_mi.core.config import PRESETS, RefineConfig
from genmf_mi.core.errors import ConfigError, GenmfError

INTERRUPTED = 130

Switch = tyro.conf.FlagCreatePairsOff[bool]
"""Only ``--name``. A setting has ``--no-name`` too, since presets differ in what is on."""

USAGE = """genmf-mi: turn a textured 3D asset into a one-colour part whose relief shows the texture

  genmf-mi refine ASSET       refine a file or a bundled sample; writes to runs/NAME
  genmf-mi evaluate A B       score a one-colour shape B against the textured asset A
  genmf-mi batch FILES ...    refine many assets, one after the other
  genmf-mi sweep ASSET        what a lower thermal stress costs in appearance
  genmf-mi convert ASSET      from a mesh to an SDF file, or from an SDF file to a coloured mesh
  genmf-mi scene ASSET        print a scene file to edit and use with --scene
  genmf-mi samples            write the bundled samples as GLB files
  genmf-mi stress ...         thermal stress by finite elements
  genmf-mi weights            install the LPIPS weights
  genmf-mi doctor             what is there, what is missing, how to mend it

Each answers to --help.
"""


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code. Errors that are not ours end in one line and exit code 2."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal that lacks a character shows "?"
    if not arguments or arguments[0] in ("-h", "--help"):
        print(USAGE)
        return 0 if arguments else 2
    if arguments[0] == "--version":
        from genmf_mi import __version__

        print(__version__)
        return 0
    command, *rest = arguments
    commands = {
        "refine": _refine,
        "evaluate": _evaluate,
        "batch": _batch,
        "sweep": _sweep,
        "convert": _convert,
        "scene": _scene,
        "samples": _samples,
        "stress": _stress,
        "weights": _weights,
        "doctor": _doctor,
    }
    if command not in commands:
        print(f"error: there is no command {command!r}.\n\n{USAGE}", file=sys.stderr)
        return 2
    try:
        return commands[command](rest) or 0
    except GenmfError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except OSError as error:  # the machine's fault, wherever it turns up
        print(f"error: {error}. Check the path, its permissions and the space on the disk.", file=sys.stderr)
        return GenmfError.exit_code
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    finally:
        gc.collect()  # else nanobind complains at exit of solvers that wait in cycles


def _parse(function: Callable, name: str, arguments: list[str]) -> int | None:
    style = (tyro.conf.FlagCreatePairsOff, tyro.conf.PositionalRequiredArgs)
    return tyro.cli(function, prog=f"genmf-mi {name}", args=arguments, config=style)


@dataclass(frozen=True)
class Refine:
    """Turn a textured asset into a one-colour part whose relief shows the texture."""

    asset: tyro.conf.Positional[str]
    """A GLB, GLTF, OBJ, PLY, 3MF or STL file, or the name of a bundled sample; or Φ on a grid: the NPZ, safetensors or
    PT file of a generator (docs/generators.md), or the name of a sample with _sdf behind it."""
    textured: Path | None = None
    """The mesh that has the colours of a generator's file."""
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
    force: Switch = False
    """Replace the run in the folder."""
    resume: Switch = False
    """Continue an interrupted run."""
    save_exr: Switch = False
    """Also write grey, depth, normal and coverage of every shape and view as OpenEXR."""
    quiet: Switch = False
    """No progress, only the table."""
    config: RefineConfig = field(default_factory=RefineConfig)


def _chosen(arguments: list[str]) -> Refine:
    default = Refine(asset=tyro.MISSING, config=_preset(arguments))
    return tyro.cli(
        Refine, prog="genmf-mi refine", args=arguments, default=default, config=(tyro.conf.OmitArgPrefixes,)
    )


def _refine(arguments: list[str]) -> int:
    chosen = _chosen(arguments)
    from genmf_mi.cli.progress import run_refine

    return run_refine(
        chosen.asset,
        chosen.config,
        out=chosen.out,
        quiet=chosen.quiet,
        textured=chosen.textured,
        scene=chosen.scene,
        references=tuple(chosen.reference),
        verify=chosen.verify,
        force=chosen.force,
        resume=chosen.resume,
        save_exr=chosen.save_exr,
    )


def _preset(arguments: list[str]) -> RefineConfig:
    """The preset named in the arguments: it sets the defaults of all other settings."""
    words = [word for argument in arguments for word in argument.split("=", 1)]
    named = [after for word, after in pairwise(words) if word == "--preset"]
    return PRESETS.get(named[-1] if named else "default", PRESETS["default"])


def _evaluate(arguments: list[str]) -> int:
    from genmf_mi.cli.progress import run_evaluate

    return _parse(run_evaluate, "evaluate", arguments)


def _batch(arguments: list[str]) -> int:
    from genmf_mi.cli.batch import batch

    return _parse(batch, "batch", arguments)


def _sweep(arguments: list[str]) -> int:
    return _parse(sweep, "sweep", arguments)


def sweep(
    asset: tyro.conf.Positional[str],
    stress_weight: str = "0,0.3,1,3,10",
    out: Path | None = None,
    arguments: str = "",
    force: bool = False,
) -> int:
    """Refine an asset with several weights of the stress, and simulate each result by finite elements.

    Run it again to go on after an interruption: finished runs are skipped, interrupted ones resumed. Writes sweep.json
    and sweep.png, the trade-off between appearance and stress, and a folder for each run.

    Args:
        asset: A file, or the name of a bundled sample.
        stress_weight: Weights to try, with commas between. 0 stands for no stress stage and is always among them.
        out: Folder for the results; runs/NAME-sweep if not given.
        arguments: More arguments for `genmf-mi refine`, as in --arguments="--size-mm 80 --preset draft".
        force: Replace the runs in the folder.
    """
    from shlex import split

    from genmf_mi.cli.progress import run_sweep

    try:
        weights = tuple(map(float, stress_weight.split(",")))
    except ValueError:
        raise ConfigError(f"--stress-weight takes numbers such as 0,1,3, not {stress_weight!r}.") from None
    chosen = _chosen([asset, *split(arguments)])
    if chosen.out or chosen.force or chosen.resume:
        raise ConfigError("--arguments cannot hold --out, --force or --resume: give them to the sweep itself.")
    return run_sweep(
        chosen.asset,
        weights,
        chosen.config,
        out=out,
        quiet=chosen.quiet,
        textured=chosen.textured,
        scene=chosen.scene,
        references=tuple(chosen.reference),
        save_exr=chosen.save_exr,
        force=force,
    )


def _convert(arguments: list[str]) -> int | None:
    from genmf_mi.cli.convert import convert

    return _parse(convert, "convert", arguments)


def _scene(arguments: list[str]) -> int:
    def author(asset: str, mesh: Path | None = None) -> int:
        """Print a scene file for an asset, to edit and hand back with ``--scene``.

        Args:
            asset: A file or the name of a bundled sample.
            mesh: What to name as the mesh in it; NAME.ply if not given. A refinement puts its own mesh there.
        """
        from genmf_mi.assets import samples
        from genmf_mi.render.scene import standalone_xml

        name = samples.resolve(asset).stem
        print(standalone_xml(name, mesh or f"{name}.ply"), end="")
        return 0

    return _parse(author, "scene", arguments)


def _samples(arguments: list[str]) -> int:
    from genmf_mi.assets.samples import samples

    return _parse(samples, "samples", arguments)


def _stress(arguments: list[str]) -> int:
    from genmf_mi.cli import stress as commands

    return tyro.extras.subcommand_cli_from_dict(commands.COMMANDS, prog="genmf-mi stress", args=arguments)


def _weights(arguments: list[str]) -> int:
    def weights(source: Annotated[Path | None, tyro.conf.arg(name="from")] = None, force: bool = False) -> int:
        """Install the LPIPS weights.

        Args:
            source: Archive, .ckpt file or folder; fetched if not given.
            force: Convert again even if they are installed.
        """
        from genmf_mi.losses.lpips_conversion import install

        print(f"LPIPS weights in {install(source, force=force)}")
        return 0

    return _parse(weights, "weights", arguments)


def _doctor(arguments: list[str]) -> int:
    from genmf_mi.cli.doctor import doctor

    return _parse(doctor, "doctor", arguments)
