"""``genmf-mi stress simulate | compare | dataset | train | predict``; nothing heavy is imported until one runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from genmf_mi.cli import bars
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.training.config import TrainConfig


def simulate(
    asset: Positional[Path],
    /,
    out: Path | None = None,
    size_mm: float = 100.0,
    edge_mm: float = 1.6,
    grid: int = 129,
    material: str = "pla",
    protocol: Protocol = Protocol(),  # noqa: B008  (frozen)
    picture: bool = True,
    force: bool = False,
) -> None:
    """Simulate the thermal stress of a solid; writes stress.vtu, stress.npz, stress.json and stress.png.

    Args:
        asset: A mesh file (made solid first), or a volume mesh such as .vtu or .msh with tetrahedra.
        out: Folder for the results; runs/NAME-stress if not given.
        size_mm: Longest side of the part.
        edge_mm: Side of the lattice that the tetrahedra come from; 1.2 or less to judge relief.
        grid: Samples per axis of the distance field that the shape is read from.
        material: pla, petg, abs or resin.
        protocol: What is simulated.
        picture: Render stress.png.
        force: Replace results that are there.
    """
    from genmf_mi.stress.fem.simulation import Settings
    from genmf_mi.stress.fem.statistics import summary
    from genmf_mi.stress.report import output

    settings = Settings(size_mm, edge_mm, grid, material, protocol)
    out = out or Path("runs") / f"{asset.stem}-stress"
    output.claim(out, output.FILES, force)
    with bars.stages() as bar:
        simulation = _simulated(asset, settings, bar)
        numbers = {"asset": asset.name, **summary(simulation)}
        bar("writing", 0.96)
        output.write_vtu(out / "stress.vtu", simulation.field)
        output.write_grid(out / "stress.npz", simulation)
        if picture:
            from genmf_mi.stress.report.picture import write_picture

            write_picture(out / "stress.png", [(caption(numbers), simulation)], asset.stem)
        output.write_json(out / "stress.json", numbers)
        bar("done", 1.0)
    _warn(asset, numbers)
    print(f"{asset.name}: {caption(numbers)}; results in {out}")


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
    """Simulate two shapes alike and tell how the stress of B relates to that of A; writes compare.json and compare.png.

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
        force: Replace results that are there.
    """
    from genmf_mi.stress.fem.simulation import Settings
    from genmf_mi.stress.fem.statistics import summary
    from genmf_mi.stress.report import output
    from genmf_mi.stress.report.comparison import layer_ratio, ratios, relative_size

    settings = Settings(size_mm, edge_mm, grid, material, protocol)
    out = out or Path("runs") / f"{a.stem}-{b.stem}-stress"
    output.claim(out, ("compare.json", "compare.png"), force)
    with bars.stages() as bar:
        before = _simulated(a, settings, lambda stage, done: bar(f"{a.stem}: {stage}", 0.45 * done))
        size = size_mm * relative_size(before.frame, b)
        after = _simulated(
            b, Settings(size, edge_mm, grid, material, protocol), lambda s, d: bar(f"{b.stem}: {s}", 0.45 + 0.45 * d)
        )
        numbers = {"a": {"asset": a.name, **summary(before)}, "b": {"asset": b.name, **summary(after)}}
        numbers["ratio"] = ratios(numbers["a"], numbers["b"])
        if (layer := layer_ratio(before, after)) is not None:
            numbers["ratio"]["surface_layer_mean"] = layer
        if picture:
            from genmf_mi.stress.report.picture import write_picture

            shapes = [(f"{p.stem}: {caption(numbers[k])}", s) for p, k, s in ((a, "a", before), (b, "b", after))]
            write_picture(out / "compare.png", shapes, f"{a.stem} and {b.stem}")
        output.write_json(out / "compare.json", numbers)
        bar("done", 1.0)
    for path, key in ((a, "a"), (b, "b")):
        _warn(path, numbers[key])
    print(f"{b.name} over {a.name}: " + ", ".join(f"{key} × {value:.3f}" for key, value in numbers["ratio"].items()))
    print(f"results in {out}")


def dataset(
    out: Path,
    count: int = 1000,
    grid: int = 129,
    edge_mm: float = 1.6,
    workers: int = 2,
    seed: int = 0,
    meshes: tuple[Path, ...] = (),
    same: tuple[str, ...] = (),
    split: tuple[Literal["train", "validation", "test"], ...] = (),
    retry_failed: bool = False,
) -> None:
    """Make training samples of Φ and von Mises stress; a run that was interrupted goes on where it stopped.

    Args:
        out: Folder of the samples. Settings of samples that are there already must match.
        count: Samples that the folder shall hold in the end.
        grid: Samples per axis of Φ and of the field.
        edge_mm: Side of the lattice that the tetrahedra come from.
        workers: Processes, one thread each; no more than there are idle cores.
        seed: Same seed, same samples.
        meshes: Folders of closed meshes to use besides the procedural shapes.
        same: Files that show one shape, as NAME=NAME, so that both stay on one side of the split.
        split: Make only the samples of these splits, for example to simulate those of the test more finely.
        retry_failed: Try failed samples again.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from genmf_mi.core import progress
    from genmf_mi.core.errors import ConfigError
    from genmf_mi.stress.data.dataset import DatasetSettings, build, meshes_in
    from genmf_mi.stress.fem.simulation import Settings

    pairs = dict(pair.split("=", 1) for pair in same if "=" in pair)
    if len(pairs) != len(same):
        raise ConfigError("--same takes pairs such as spot=spotcow.")
    settings = DatasetSettings(Settings(edge_mm=edge_mm, grid=grid), seed, meshes_in(list(meshes)), pairs)
    with Progress(TextColumn("samples"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task("", total=None)

        class Bar(progress.Progress):
            def advance(self, done, total, values=None) -> None:
                bar.update(task, completed=done, total=total)

            def warn(self, message: str) -> None:
                bar.console.print(message)

        tally = build(out, count, settings, workers, retry_failed, Bar(), split)
    print(f"{out}: {tally.finished} samples, {tally.failed} failed; {tally.added} new.")


def train(
    data: Path,
    out: Path,
    config: Annotated[TrainConfig, arg(name="")] = TrainConfig(),  # noqa: B008  (frozen)
    cache: Path | None = None,
    threads: int = 0,
    resume: bool = False,
    force: bool = False,
) -> None:
    """Train the stress network on a data set; writes weights.safetensors, metrics.json, log.jsonl and curves.png.

    Args:
        data: Folder of samples, see `genmf-mi stress dataset`.
        out: Folder of the training.
        config: How the network is trained.
        cache: Folder for decoded samples, 9 MB each; DATA-decoded beside DATA if not given.
        threads: Of the CPU; 0 leaves it to torch.
        resume: Go on with the training in the folder.
        force: Replace the training in the folder.
    """
    import torch

    from genmf_mi.stress.training import trainer

    if threads:
        torch.set_num_threads(threads)
    cache = cache or data.with_name(f"{data.name}-decoded")
    with bars.training(config) as progress:
        result = trainer.train(data, out, config, cache=cache, resume=resume, force=force, progress=progress)
    scores = result["validation"]["all"]
    print(
        f"{result['steps_made']} steps; validation: {scores['mae']:.4f} MPa mean error at a mean of "
        f"{scores['mean']:.3f} MPa, top 5 % IoU {scores['iou']:.3f}; weights in {out / trainer.WEIGHTS}"
    )


def predict(
    asset: Positional[Path],
    /,
    out: Path | None = None,
    weights: Path | None = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    picture: bool = True,
    force: bool = False,
) -> None:
    """Tell the thermal stress of a solid by the trained network, in seconds; writes the files that simulate writes.

    Args:
        asset: A mesh file (made solid first).
        out: Folder for the results; runs/NAME-predicted if not given.
        weights: File of a training; that of the package if not given.
        device: Where the network runs.
        picture: Render stress.png.
        force: Replace results that are there.
    """
    from genmf_mi.stress.fem import surface
    from genmf_mi.stress.model.predictor import Predictor, summary
    from genmf_mi.stress.report import output

    out = out or Path("runs") / f"{asset.stem}-predicted"
    output.claim(out, output.FILES, force)
    with bars.stages() as bar:
        bar("reading", 0.0)
        predictor = Predictor(weights, device)
        vertices, faces = surface.load(asset)
        bar("predicting", 0.4)
        prediction = predictor.predict(vertices, faces)
        numbers = {"asset": asset.name, "preset": predictor.about["preset"], **summary(prediction)}
        bar("writing", 0.7)
        output.write_prediction_vtu(out / "stress.vtu", prediction.field)
        output.write_grid(out / "stress.npz", prediction)
        if picture:
            from genmf_mi.stress.report.picture import write_picture

            write_picture(out / "stress.png", [(caption(numbers), prediction)], f"{asset.stem}, predicted")
        output.write_json(out / "stress.json", numbers)
        bar("done", 1.0)
    for sentence in prediction.warnings:
        print(f"warning: {asset.name} is not like what the network was trained on: {sentence}.")
    print(f"{asset.name}: {caption(numbers)}; results in {out}")


COMMANDS = {"simulate": simulate, "compare": compare, "dataset": dataset, "train": train, "predict": predict}


def caption(numbers: dict) -> str:
    """The figures of one shape in a line."""
    stress, band = numbers["von_mises_mpa"], numbers["surface_band"]
    return (
        f"mean {stress['mean']:.3f} MPa, 99.9 % below {stress['p99_9']:.2f} MPa, "
        f"surface band {band['mean']:.3f} MPa"
        + (f", moves {numbers['displacement_max_mm']:.2f} mm" if "displacement_max_mm" in numbers else "")
    )


def _simulated(path: Path, settings, progress):
    from genmf_mi.stress.fem import simulation as fem
    from genmf_mi.stress.fem import surface, tetrahedra

    progress("reading", 0.0)
    if surface.is_volume(path):
        return fem.simulate_tetrahedra(tetrahedra.read(path), settings, progress)
    return fem.simulate(*surface.load(path), settings, progress)


def _warn(path: Path, numbers: dict) -> None:
    mesh = numbers["mesh"]
    if mesh["thin_fraction"] > 0.01:
        print(
            f"warning: {path.name} is thinner than two grid cells under {mesh['thin_fraction']:.0%} of its surface, "
            "which is only partly in the figures; raise --grid and lower --edge-mm."
        )
    if mesh["dropped_bodies"]:
        print(
            f"warning: {mesh['dropped_bodies']} loose parts of {path.name} "
            f"({mesh['dropped_fraction']:.1%} of its volume) were left out."
        )
