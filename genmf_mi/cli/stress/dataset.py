"""``genmf-mi stress dataset``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from genmf_mi.cli.progress import TerminalProgress
from genmf_mi.core.errors import ConfigError


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
    """Make training samples of Φ and von Mises stress; an interrupted run continues where it stopped.

    Args:
        out: Folder of the samples. Settings of existing samples must match.
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
    from genmf_mi.stress.data.dataset import DatasetSettings, build, meshes_in
    from genmf_mi.stress.fem.settings import Settings

    pairs = dict(pair.split("=", 1) for pair in same if "=" in pair)
    if len(pairs) != len(same):
        raise ConfigError("--same takes pairs such as spot=spotcow.")
    settings = DatasetSettings(Settings(edge_mm=edge_mm, grid=grid), seed, meshes_in(list(meshes)), pairs)
    with TerminalProgress() as progress:
        tally = build(out, count, settings, workers=workers, retry_failed=retry_failed, splits=split, progress=progress)
    print(f"{out}: {tally.finished} samples, {tally.failed} failed; {tally.added} new.")
