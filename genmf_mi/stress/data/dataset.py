"""Training samples in a folder: many single-thread processes, one file per sample, an index that survives a kill.

``settings.json``  what the samples have in common; a folder holds samples of one kind only.
``index.jsonl``    one line per sample that is finished or has failed, in the order of finishing.
``samples/``       one npz per sample, written before its line.
"""

from __future__ import annotations

import fcntl
import gc
import hashlib
import json
import multiprocessing
import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import cast

import numpy as np

from genmf_mi.core import memory
from genmf_mi.core.errors import ConfigError, GenmfError, OutputError
from genmf_mi.core.files import atomic, write_text
from genmf_mi.core.progress import Progress
from genmf_mi.core.timer import Timer
from genmf_mi.stress.fem.simulation import Settings

MESHES = (".ply", ".glb", ".gltf", ".obj", ".stl", ".off", ".3mf")
FORMAT = 2
"""Version of the samples: one more when those of an older program would not fit those of a newer one."""
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@dataclass(frozen=True)
class DatasetSettings:
    """What all samples of a folder have in common.

    sources: mesh files by name. same: names of files that show another file's shape, to the name of that one, so that
    both stay on one side of the split.
    """

    simulation: Settings = field(default_factory=Settings)
    seed: int = 0
    sources: dict[str, Path] = field(default_factory=dict)
    same: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (self.simulation.grid - 1) % 4:
            raise ConfigError(f"grid must be a multiple of four, plus one (65, 129), not {self.simulation.grid}.")
        if self.seed < 0:
            raise ConfigError(f"seed must not be negative: {self.seed}.")

    def record(self) -> dict:
        """What is compared before samples are added to a folder. Files count by content, not by their path."""
        digests = {n: hashlib.sha256(Path(p).read_bytes()).hexdigest()[:16] for n, p in sorted(self.sources.items())}
        return {
            "format": FORMAT,
            "simulation": asdict(self.simulation),
            "seed": self.seed,
            "sources": digests,
            "same": self.same,
        }


@dataclass(frozen=True)
class Tally:
    """finished and failed: samples in the folder. added: of these, how many are new."""

    finished: int
    failed: int
    added: int


def meshes_in(folders: list[Path]) -> dict[str, Path]:
    """Mesh files of ``folders`` by name. Raises :class:`ConfigError` for a missing folder or two files of one name."""
    meshes: dict[str, Path] = {}
    for folder in folders:
        if not folder.is_dir():
            raise ConfigError(f"{folder} is not a folder; give folders that hold mesh files.")
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() not in MESHES:
                continue
            if path.stem in meshes:
                raise ConfigError(f"{path} and {meshes[path.stem]} have the same name; rename one of them.")
            meshes[path.stem] = path.resolve()
    return meshes


def read_index(folder: Path) -> list[dict]:
    """The lines of the index. A last line cut short by a crash is left out."""
    path = folder / "index.jsonl"
    if not path.exists():
        return []
    records = []
    for line in path.read_text(encoding="utf-8").splitlines(keepends=True):
        try:
            records.append(json.loads(line))
        except json.JSONDecodeError:
            if line.endswith("\n"):
                raise OutputError(f"{path} is damaged at record {len(records)}; restore it from a copy.") from None
    return records


def chosen(count: int, settings: DatasetSettings, splits: Collection[str] = ()) -> list[int]:
    """Those of the samples 0 … count-1 that belong to ``splits``; all of them if none are named."""
    from genmf_mi.stress.data.recipe import recipe_of

    common = (settings.seed, settings.sources, settings.same)
    return [index for index in range(count) if not splits or recipe_of(index, *common).split in splits]


def build(
    out: Path,
    count: int,
    settings: DatasetSettings,
    workers: int = 1,
    retry_failed: bool = False,
    progress: Progress | None = None,
    splits: Collection[str] = (),
) -> Tally:
    """Make those of the samples 0 … count-1 that ``out`` does not hold yet and that are :func:`chosen`.

    Args:
        workers: processes, of one thread each.
        retry_failed: try failed samples again.
        progress: samples of those chosen that are finished or have failed; a warning for each that fails.

    Raises:
        ConfigError: the folder holds samples of other settings, or another process is adding to it.
        OutputError: a file cannot be written. What was finished stays, and the next run goes on from there.
    """
    if count < 1 or workers < 1:
        raise ConfigError(f"count and workers must be at least 1, not {count} and {workers}.")
    progress = progress or Progress()
    with _locked(out):
        _check_settings(out, settings)
        records = [r for r in read_index(out) if not (retry_failed and "error" in r)]
        write_text(out / "index.jsonl", "".join(json.dumps(r) + "\n" for r in records))
        existing = {r["index"] for r in records}
        wanted = chosen(count, settings, splits)
        missing = [index for index in wanted if index not in existing]
        progress.stage("simulating samples")
        progress.advance(len(wanted) - len(missing), len(wanted))
        with (out / "index.jsonl").open("a", encoding="utf-8") as index:
            for added, record in enumerate(_run(iter(missing), out, settings, workers), start=1):
                index.write(json.dumps(record) + "\n")
                index.flush()
                os.fsync(index.fileno())
                records.append(record)
                if "error" in record:
                    progress.warn(f"sample {record['index']} failed: {record['error']}")
                progress.advance(len(wanted) - len(missing) + added, len(wanted))
    failed = sum("error" in r for r in records)
    return Tally(len(records) - failed, failed, len(missing))


def make_sample(index: int, settings: DatasetSettings) -> tuple[dict[str, np.ndarray], dict]:
    """The arrays and the record of one sample. Raises what a simulation raises."""
    from genmf_mi.sdf import distance
    from genmf_mi.stress.data import codec, recipe
    from genmf_mi.stress.fem import simulation as fem
    from genmf_mi.stress.fem import statistics

    simulation = settings.simulation
    what = recipe.recipe_of(index, settings.seed, settings.sources, settings.same)
    timer = Timer()
    vertices, faces = recipe.surface_of(what, settings.seed, simulation.size_mm, simulation.grid)
    timer.lap("shape")
    layers, phi = codec.pack_distance(distance.signed_distance(vertices, faces, simulation.grid))
    thin = distance.thin_fraction(vertices, faces, phi.astype(np.float32))
    timer.lap("distance")
    recipe.check_thin(what, thin)
    frame = fem.frame_of(vertices, simulation.size_mm)
    result = fem.simulate_distance(phi.astype(np.float32), frame, simulation, thin_fraction=thin, timer=timer)
    recipe.check_whole(what, result.dropped, float(result.field.elements.volumes.sum()))
    field_on_grid, filled = result.on_grid()
    layers |= codec.pack_stress(field_on_grid, phi)
    timer.lap("grid")
    numbers = statistics.summary(result)
    del numbers["settings"]
    numbers["seconds"] = {name: round(seconds, 3) for name, seconds in timer.seconds.items()}
    record = {
        "index": index,
        "file": f"samples/{index:06d}.npz",
        "shape": what.shape,
        "family": what.family,
        "split": what.split,
        "relief_mm": what.relief,
        "inside": int((phi <= 0).sum()),
        "filled": filled,
        **numbers,
    }
    return layers, record


def _work(pipe: Connection, out: Path, settings: DatasetSettings) -> None:
    """A worker: takes an index, answers with a record, until it is given None."""
    while (index := pipe.recv()) is not None:
        try:
            layers, record = make_sample(index, settings)
            with atomic(out / "samples" / f"{index:06d}.npz") as temporary:
                arrays = {"meta": np.array(json.dumps(record)), **layers}
                np.savez_compressed(temporary, **arrays)  # pyright: ignore[reportArgumentType]  (allow_pickle is no array)
            pipe.send(record)
        except OutputError as error:
            pipe.send(error)
        except Exception as error:
            kind = "" if isinstance(error, GenmfError) else f"{type(error).__name__}: "
            pipe.send({"index": index, "error": f"{kind}{error}"})
        gc.collect()  # systems and meshes hold one another; after a hundred samples, a worker had 4 GB
        memory.trim_malloc()


def _run(wanted: Iterator[int], out: Path, settings: DatasetSettings, workers: int) -> Iterator[dict]:
    """Records of the ``wanted`` samples as they are finished. A worker that dies costs its sample, not the run."""
    for name in _THREADS:
        os.environ[name] = "1"
    context = multiprocessing.get_context("spawn")
    busy: dict[Connection, tuple[SpawnProcess, int]] = {}

    def start() -> None:
        index = next(wanted, None)
        if index is None:
            return
        near, far = context.Pipe()
        process = context.Process(target=_work, args=(far, out, settings), daemon=True)
        process.start()
        far.close()
        near.send(index)
        busy[near] = (process, index)

    try:
        for _ in range(workers):
            start()
        while busy:
            for pipe in cast(list[Connection], wait(list(busy))):
                process, index = busy.pop(pipe)
                try:
                    answer = pipe.recv()
                except (EOFError, ConnectionError):
                    process.join()
                    yield {"index": index, "error": f"the worker died with exit code {process.exitcode}"}
                    start()
                    continue
                if isinstance(answer, Exception):
                    raise answer
                following = next(wanted, None)
                pipe.send(following)
                if following is not None:
                    busy[pipe] = (process, following)
                yield answer
    finally:
        for process, _ in busy.values():
            process.terminate()


def _check_settings(out: Path, settings: DatasetSettings) -> None:
    """Write the settings into an empty folder, or compare them with those of its samples."""
    from genmf_mi.stress.model.weights import with_current_names  # not at the top: no worker needs torch

    path = out / "settings.json"
    record = json.loads(json.dumps(settings.record()))
    if not path.exists():
        if (out / "index.jsonl").exists():
            raise ConfigError(f"{out} holds an index without settings. Choose another --out.")
        write_text(path, json.dumps(record, indent=2) + "\n")
        return
    existing = json.loads(path.read_text(encoding="utf-8"))
    existing["simulation"] = with_current_names(existing.get("simulation", {}))
    different = [key for key in record if record[key] != existing.get(key)]
    if different:
        raise ConfigError(
            f"{out} holds samples of other settings ({', '.join(different)} differ). "
            "Use those of its settings.json, or choose another --out."
        )


@contextmanager
def _locked(out: Path) -> Iterator[None]:
    """Hold ``out`` for this process alone.

    Several processes may add to one folder in turn, so it is not claimed as a folder of new results is
    (:func:`genmf_mi.core.files.claim_folder`).
    """
    try:
        (out / "samples").mkdir(parents=True, exist_ok=True)
        lock = (out / ".lock").open("w")
    except OSError as error:
        raise OutputError(f"cannot write to {out}: {error.strerror}. Choose another --out.") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ConfigError(f"another process is adding to {out}. Wait for it, or choose another --out.") from None
        yield
