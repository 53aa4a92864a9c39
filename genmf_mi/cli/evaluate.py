"""``genmf-mi evaluate``."""

from __future__ import annotations

from pathlib import Path

from genmf_mi.cli.arguments import call
from genmf_mi.core.config import RefineConfig


def evaluate(
    original: Path,
    refined: Path,
    size_mm: float = 100.0,
    scene: Path | None = None,
    score_vgg: bool = False,
    files_anywhere: bool = False,
    normal_map: bool = RefineConfig.normal_map,
    occlusion_map: bool = RefineConfig.occlusion_map,
    emissive_map: bool = RefineConfig.emissive_map,
    json: bool = False,
) -> int:
    """Score a one-colour shape against the textured asset that it should look like.

    Args:
        original: The textured asset.
        refined: The one-colour shape, in the same pose (any scale and position).
        size_mm: Longest side of the part.
        scene: A scene file; the sample's own or the default one if not given.
        score_vgg: Score with VGG16 LPIPS too, which takes half a minute on a small machine.
        files_anywhere: Let the files name textures, materials and buffers outside of their own folders.
        normal_map: Shade the object as its normal map says.
        occlusion_map: Take from the ambient light what its occlusion map says.
        emissive_map: Add the light that its emissive map gives off.
        json: Print JSON instead of a table.
    """
    from genmf_mi.pipeline import evaluation

    networks = ("alex", "vgg") if score_vgg else ("alex",)
    metrics = evaluation.evaluate(
        original,
        refined,
        size_mm=size_mm,
        scene=scene,
        networks=networks,
        files_anywhere=files_anywhere,
        normal_map=normal_map,
        occlusion_map=occlusion_map,
        emissive_map=emissive_map,
    )
    if json:
        from json import dumps

        print(dumps(metrics, indent=2))
    else:
        from genmf_mi.cli.tables import print_scores

        print_scores(metrics)
    return 0


def main(arguments: list[str]) -> int:
    """Read the arguments and score."""
    return call(evaluate, "evaluate", arguments)
