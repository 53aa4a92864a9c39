"""``genmf-mi stress train``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from genmf_mi.cli.progress import TerminalProgress
from genmf_mi.stress.training.config import TrainConfig


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
        threads: Threads of the CPU; 0 leaves the number to torch.
        resume: Continue the training in the folder.
        force: Replace the training in the folder.
    """
    import torch

    from genmf_mi.stress.training import trainer

    if threads:
        torch.set_num_threads(threads)
    cache = cache or data.with_name(f"{data.name}-decoded")
    with TerminalProgress() as progress:
        result = trainer.train(data, out, config, cache=cache, resume=resume, force=force, progress=progress)
    scores = result["validation"]["all"]
    print(
        f"{result['steps_made']} steps; validation: {scores['mae']:.4f} MPa mean error at a mean of "
        f"{scores['mean']:.3f} MPa, top 5 % IoU {scores['iou']:.3f}; weights in {out / trainer.WEIGHTS}"
    )
