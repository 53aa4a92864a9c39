"""``genmf-mi stress predict``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from genmf_mi.cli.progress import TerminalProgress
from genmf_mi.core.files import claim_folder
from genmf_mi.stress.fem.protocol import Protocol

if TYPE_CHECKING:
    from genmf_mi.stress.model.predictor import Predictor


def predict(
    asset: Positional[Path],
    /,
    out: Path | None = None,
    size_mm: float | None = None,
    material: str | None = None,
    protocol: Protocol = Protocol(),  # noqa: B008  (frozen)
    weights: str = "compact",
    device: Literal["auto", "cpu", "cuda"] = "auto",
    picture: bool = True,
    force: bool = False,
) -> None:
    """Predict the thermal stress of a solid by the trained network, in seconds; writes the files that simulate writes.

    Args:
        asset: A mesh file (made solid first).
        out: Folder for the results; runs/NAME-predicted if not given.
        size_mm: Longest side of the part; that of the network's training if not given.
        material: pla, petg, abs or resin; that of the training if not given.
        protocol: What is predicted; the protocol of the training if all of it is left at its defaults.
        weights: Network of the package, or the file of a training.
        device: Where the network runs.
        picture: Render stress.png.
        force: Replace existing results.
    """
    from genmf_mi.cli.stress.shared import caption
    from genmf_mi.stress.fem import surface
    from genmf_mi.stress.model.predictor import summary
    from genmf_mi.stress.report import output

    changes: dict[str, Any] = {"size_mm": size_mm, "material": material}
    changes = {name: value for name, value in changes.items() if value is not None}
    if protocol != Protocol():
        changes["protocol"] = protocol
    out = out or Path("runs") / f"{asset.stem}-predicted"
    claim_folder(out, "prediction", finished=output.FILES, force=force)
    with TerminalProgress() as progress:
        progress.stage("reading")
        predictor = _predictor(weights, device, changes)
        vertices, faces = surface.load(asset)
        progress.stage("predicting")
        prediction = predictor.predict(vertices, faces)
        numbers = {"asset": asset.name, "preset": predictor.about["preset"], **summary(prediction)}
        progress.stage("writing")
        output.write_prediction_vtu(out / "stress.vtu", prediction.field)
        output.write_grid(out / "stress.npz", prediction)
        if picture:
            from genmf_mi.stress.report.picture import write_picture

            write_picture(out / "stress.png", [(caption(numbers), prediction)], f"{asset.stem}, predicted")
        output.write_json(out / "stress.json", numbers)
        for sentence in prediction.warnings:
            progress.warn(f"{asset.name}: {sentence}.")
    print(f"{asset.name}: {caption(numbers)}; results in {out}")


def _predictor(weights: str, device: str, changes: dict[str, Any]) -> Predictor:
    """The predictor for the settings of its training with ``changes``; it warns if the network does not know those.

    Raises:
        ConfigError: a setting out of range, or no such device. WeightsError: see :class:`Predictor`.
    """
    from genmf_mi.stress.model.predictor import Predictor

    trained = Predictor(weights, device)
    return Predictor(weights, device, settings=replace(trained.settings, **changes)) if changes else trained
