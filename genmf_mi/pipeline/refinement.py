"""The refinement, from top to bottom: prepare, start, optimise in two stages, back off, score, write.

import genmf_mi

result = genmf_mi.refine("bus.glb", genmf_mi.RefineConfig(size_mm=80))
result.vertices_mm, result.faces, result.metrics["after"]["lpips_alex"]
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from genmf_mi.assets import sources
from genmf_mi.assets.asset import Asset
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core import memory
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import AssetError, ConfigError, OutputError, SetupError
from genmf_mi.core.files import locked
from genmf_mi.core.printer import PRINTERS
from genmf_mi.core.progress import Progress
from genmf_mi.core.timer import Timer
from genmf_mi.losses import lpips_conversion
from genmf_mi.mesh.self_intersections import self_intersections
from genmf_mi.pipeline import build_direction, regions, stress_stage
from genmf_mi.pipeline.build_direction import Candidate
from genmf_mi.pipeline.displacement import Displacement, best_displacement, initial_heights
from genmf_mi.pipeline.evaluator import Evaluator, build_evaluator
from genmf_mi.pipeline.optimisation import ExtraTerms, Optimisation, iterations, optimise
from genmf_mi.pipeline.preview import Preview
from genmf_mi.pipeline.print_check import check_shapes, printer_named
from genmf_mi.pipeline.problem import ONE_BRIGHTNESS, RefinementProblem, build_problem, parameterize, standing
from genmf_mi.pipeline.regions import AssetRegions
from genmf_mi.pipeline.results import Outcome, Result, conclude, shapes_of
from genmf_mi.pipeline.run_folder import PREVIEW, RunFolder, fingerprint
from genmf_mi.printing.printed import require_bed
from genmf_mi.render import scene_file, variant
from genmf_mi.stress.report import verification

SHAPES = ("before", "unconstrained", "after")
"""What can be verified by finite elements."""


def refine(
    asset: str | Path | Asset | SdfAsset,
    config: RefineConfig | None = None,
    *,
    textured: str | Path | Asset | None = None,
    up: str | None = None,
    files_anywhere: bool = False,
    out: str | Path | None = None,
    scene: str | Path | None = None,
    references: tuple[str, ...] = (),
    verify: bool | Collection[str] = False,
    print_check: bool | str = False,
    force: bool = False,
    resume: bool = False,
    save_exr: bool = False,
    extra_terms: ExtraTerms | None = None,
    progress: Progress | None = None,
) -> Result:
    """Turn a textured asset into a one-colour part whose relief shows the texture.

    A KeyboardInterrupt ends the optimisation early: the part so far is finished and written, and
    ``metrics["interrupted"]`` is set.

    Args:
        asset: a file, the name of a bundled sample, a loaded :class:`genmf_mi.Asset`, or a shape as a generator holds
            it, :class:`genmf_mi.SdfAsset`, whose signed distance is refined in place of the vertices of a mesh.
        textured: the mesh that has the colours of a generator's file. up: the axis of the file that points upwards;
            files_anywhere: whether it may name files outside of its own folder, see :func:`genmf_mi.load`.
        out: folder for all files; None writes nothing. scene: the sample's own or ``default.xml`` if None.
        references: images to match instead of the texture, each ``image.png@azimuth,elevation``.
        verify: simulate the stress of the part ``before``, as it would be without the stress stage
            (``unconstrained``), and ``after``, or of some of these by name.
        print_check: slice the shapes, look at and score every bead; a string names the slicer. Both take minutes.
        force, resume: replace a run in ``out``, or continue an interrupted one. save_exr: write the image buffers too.
        extra_terms: of the loss, see :data:`genmf_mi.pipeline.optimisation.ExtraTerms`. progress: of the run.

    Raises:
        GenmfError: what the command line prints; see :mod:`genmf_mi.core.errors`.
    """
    memory.tune_malloc()
    config, progress, timer = config or RefineConfig(), progress or Progress(), Timer()
    _require(config, out, (asset, textured, scene, *references), resume=resume, print_check=bool(print_check))
    with locked(out), tempfile.TemporaryDirectory(prefix="genmf-") as folder, ExitStack() as stack:
        progress.stage("loading")
        asset = sources.load(asset, textured, up, files_anywhere=files_anywhere)
        device = variant.use(config.device)
        lpips_conversion.ensure(*config.networks, progress=progress)
        xml = Path(scene) if scene else scene_file.find(asset.name)
        config, shape, painted = asked(asset, config, up, out if resume else None)
        run = stack.enter_context(opened(out, asset, config, xml, references, force=force, resume=resume))
        timer.lap("load")

        problem = build_problem(
            shape, config, xml, Path(folder), references=references, regions=painted, progress=progress, timer=timer
        )
        problem, evaluator, displacement, stands = displaced(problem, config, progress)
        parameterization = parameterize(problem, config, device)
        timer.lap("displacement")

        stress, left_out = stress_stage.plan(problem, parameterization, config, device, progress)
        alignment = replace(evaluator.alignment, kind=config.alignment)
        optimisation = Optimisation(problem, config, parameterization, alignment, stress, extra_terms)
        interrupted, state = refined(optimisation, displacement, evaluator, run, progress, resume=resume)
        timer.lap("optimise")
        simulated, unconstrained = verified(optimisation, state, () if interrupted else verify, progress, timer)

        progress.stage("checking for self-intersections")
        surface = parameterization.finish(state, self_intersections)
        timer.lap("untangle")
        outcome = Outcome(
            problem, config, evaluator, displacement, surface, optimisation.history, interrupted, left_out, simulated,
            unconstrained, stands,
        )  # fmt: skip
        if print_check and not interrupted:
            outcome = as_printed(outcome, print_check, xml, Path(folder), progress)
            timer.lap("print")
        return conclude(outcome, run, timer, progress, save_exr=save_exr)


def asked(
    asset: Asset | SdfAsset, config: RefineConfig, up: str | None, resumed: str | Path | None
) -> tuple[RefineConfig, Asset | SdfAsset, AssetRegions | None]:
    """The settings, with the regions of the run in the folder ``resumed`` if they have none of their own, and
    :func:`genmf_mi.pipeline.regions.of_asset` for them."""
    config = regions.resumed(config, RunFolder(Path(resumed))) if resumed else config
    return config, *regions.of_asset(asset, config, up)


def displaced(
    problem: RefinementProblem, config: RefineConfig, progress: Progress
) -> tuple[RefinementProblem, Evaluator, Displacement, list[Candidate]]:
    """What scores parts, the best displacement, and :func:`stood` for them. Raises :class:`AssetError` for a texture of
    one brightness."""
    _require_detail(problem)
    progress.stage("rendering the references")
    pair = problem.evaluation
    evaluator = build_evaluator(pair.reference, pair.part, config.networks, regions=problem.region_images)
    return stood(problem, evaluator, best_displacement(problem, evaluator, progress), config, progress)


def stood(
    problem: RefinementProblem,
    evaluator: Evaluator,
    displacement: Displacement,
    config: RefineConfig,
    progress: Progress,
) -> tuple[RefinementProblem, Evaluator, Displacement, list[Candidate]]:
    """The same for the best way to stand on the print bed, if that is asked for, and all that were looked at, the best
    one first. Raises :class:`ConfigError` if the part does not fit the printer."""
    printer = PRINTERS[config.printer]
    if config.stand != "best":
        require_bed(problem.frame.to_print(problem.surface.vertices), printer)
        return problem, evaluator, displacement, []
    progress.stage("looking for the best way to stand")
    stands = build_direction.choose(problem, evaluator, displacement.heights, printer)
    best = stands[0]
    require_bed(problem.frame.standing(best.up).to_print(problem.surface.vertices), printer)
    if best.up == problem.frame.up:
        return problem, evaluator, displacement, stands
    problem = standing(problem, best.up, config)
    pair, vertices = problem.evaluation, torch.as_tensor(problem.surface.vertices, dtype=torch.float32)
    vertices = vertices.to(evaluator.device)
    evaluator = build_evaluator(pair.reference, pair.part, config.networks, vertices, problem.region_images)
    return problem, evaluator, best_displacement(problem, evaluator, progress), stands


@contextmanager
def opened(
    out: str | Path | None,
    asset: Asset | SdfAsset,
    config: RefineConfig,
    xml: Path,
    references: tuple[str, ...],
    *,
    force: bool,
    resume: bool,
) -> Generator[RunFolder | None]:
    """The folder of the run, None without ``out``; errors inside say whether the run can be continued.

    Raises as :meth:`RunFolder.open`; files that are missing are missed later.
    """
    if out is None:
        yield None
        return
    pictures = [Path(text.rpartition("@")[0]) for text in references]
    turns = [text.rpartition("@")[2] for text in references]
    inputs = {"asset": fingerprint(asset), "scene": fingerprint(xml), "references": fingerprint(pictures, turns)}
    copies = regions.copies(config)
    inputs |= regions.fingerprints(copies)
    run = RunFolder.open(out, asset.name, config, inputs, copies=copies, force=force, resume=resume)
    with run.resumable():
        yield run


def _require(
    config: RefineConfig, out: str | Path | None, inputs: tuple[Any, ...], *, resume: bool, print_check: bool
) -> None:
    """Raise :class:`ConfigError` for what cannot be done, before anything is computed."""
    for given in inputs if out else ():
        named = (str(given), str(given).rpartition("@")[0]) if isinstance(given, str | Path) else ()
        for file in map(Path, named):
            if file.is_file() and file.resolve().is_relative_to(Path(str(out)).resolve()):
                raise ConfigError(f"{file} lies in {out}, where the results go. Choose another --out.")
    if print_check:
        printer_named(config.printer)
    if resume and out is None:
        raise ConfigError("there is nothing to resume without an output folder: give --out.")


def _require_detail(problem: RefinementProblem) -> None:
    """Raise :class:`AssetError` for a texture of one brightness where relief is allowed: none would come of it."""
    signals = problem.surface.signals
    if problem.training.reference.pictures or np.ptp(signals[problem.relief], axis=0).max() >= ONE_BRIGHTNESS:
        return
    name = problem.asset.name
    if np.ptp(signals, axis=0).max() >= ONE_BRIGHTNESS:
        raise AssetError(
            f"{name} has one brightness wherever relief is allowed, so there is nothing to show there. Keep less of it "
            "flat: see --regions, --mask, --flat-material and --flat-faces."
        )
    raise AssetError(
        f"the texture of {name} has one brightness all over, so there is nothing for the relief to show. Give pictures "
        "of it with --reference image.png@azimuth,elevation."
    )


def refined(
    optimisation: Optimisation,
    displacement: Displacement,
    evaluator: Evaluator,
    run: RunFolder | None,
    progress: Progress,
    *,
    resume: bool,
) -> tuple[bool, Any]:
    """Start from the displacement and make all iterations, or only displace. Returns whether that was interrupted, and
    the state of the parameterization."""
    problem, config, parameterization = optimisation.problem, optimisation.config, optimisation.parameterization
    if config.method == "displacement":
        return False, parameterization.displaced(displacement.heights)
    parameterization.set_heights(initial_heights(problem, displacement, config))
    show = Preview(run.path / PREVIEW, evaluator, problem.surface).update if run else None
    interrupted = optimise(optimisation, run, progress, resume=resume, show=show)
    return interrupted, parameterization.state()


def as_printed(outcome: Outcome, slicer: str | bool, xml: Path, folder: Path, progress: Progress) -> Outcome:
    """With what comes off the printer. A slicer that fails is warned of: the part is there all the same."""
    slicer = slicer if isinstance(slicer, str) else "auto"
    shapes = {name: (v.cpu().numpy(), f.cpu().numpy()) for name, (v, f) in shapes_of(outcome).items()}
    try:
        check = check_shapes(outcome.problem, shapes, outcome.config.printer, slicer, xml, folder, progress)
    except (OutputError, SetupError) as error:
        progress.warn(f"the part was not looked at as printed: {error}")
        return outcome
    return replace(outcome, printed=check)


def verified(
    optimisation: Optimisation, state: Any, verify: bool | Collection[str], progress: Progress, timer: Timer
) -> tuple[dict[str, Any], tuple[np.ndarray, np.ndarray] | None]:
    """Simulate the part before, without the stress stage and after, as far as these are named.

    Returns:
        See :func:`genmf_mi.stress.report.verification.verify`; and vertices ``[V,3]`` and faces ``[F,3]`` of the part
        without the stress stage, None if it was not asked for or is the same as with it.
    """
    problem, config = optimisation.problem, optimisation.config
    names = SHAPES if verify is True else tuple(verify or ())
    shapes = {"before": (problem.surface.vertices, problem.surface.faces)}
    unconstrained = None
    if optimisation.stage_one is not None and "unconstrained" in names:
        unconstrained = shapes["unconstrained"] = _without_stress(optimisation, progress)
    shapes["after"] = optimisation.parameterization.surface(state)
    shapes = {name: shape for name, shape in shapes.items() if name in names}
    if not shapes:
        return {}, unconstrained
    numbers = verification.verify(shapes, problem.frame, material=config.material, progress=progress)
    timer.lap("verify")
    return numbers, unconstrained


def _without_stress(optimisation: Optimisation, progress: Progress) -> tuple[np.ndarray, np.ndarray]:
    """The surface that stage one would have ended with, had it gone on to the last iteration."""
    assert optimisation.stage_one is not None
    other = Optimisation(
        optimisation.problem,
        optimisation.config,
        optimisation.parameterization,
        optimisation.alignment,
        extra_terms=optimisation.extra_terms,
    )
    other.restore(optimisation.stage_one)
    progress.stage("refining without the stress stage")
    for record in iterations(other):
        progress.advance(other.iteration, other.config.iterations, record)
    return other.parameterization.surface(other.parameterization.state())
