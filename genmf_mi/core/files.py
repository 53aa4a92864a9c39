"""Output folders and files: claimed before work begins, and written so that no half of a file is ever left."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, Any

from genmf_mi.core.errors import OutputError

LOCK = ".lock"


def claim_folder(
    folder: str | Path,
    what: str,
    *,
    finished: Sequence[str],
    interrupted: Sequence[str] = (),
    force: bool = False,
    resume: bool = False,
    foreign: Sequence[str] = (),
) -> None:
    """Make sure that new results may be written into ``folder``, or that it holds something to resume.

    Args:
        what: the name of the work in messages, such as ``run`` or ``training``.
        finished: file names any of which marks a finished result; interrupted: likewise for an unfinished one.
        force: replace what is there.
        resume: continue what is unfinished.
        foreign: names of files that would be replaced and that no earlier work of ours has left; one that is there is
            never replaced.

    Raises:
        OutputError: the folder cannot be read or made; it holds a result and ``force`` is not given; or there is
            nothing to resume.
    """
    folder = Path(folder)
    try:
        unfinished, complete = (any((folder / name).exists() for name in names) for names in (interrupted, finished))
        if resume:
            if not unfinished:
                raise OutputError(f"{folder} holds no interrupted {what}. Start one without --resume.")
            return
        if theirs := [name for name in foreign if os.path.lexists(folder / name)]:
            raise OutputError(
                f"{folder} holds {theirs[0]}, which no {what} has left there and which would be replaced. "
                "Choose another --out."
            )
        if (unfinished or complete) and not force:
            state, hint = ("an interrupted", " --resume to continue it,") if unfinished else ("a finished", "")
            raise OutputError(f"{folder} holds {state} {what}. Use{hint} --force to replace it, or another --out.")
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror}. Choose another --out.") from error


@contextmanager
def locked(folder: str | Path | None, what: str = "run") -> Iterator[None]:
    """Have ``folder`` to oneself; it is made, and removed again with the parents that it
    lacked, if nothing was put into it. None locks nothing.

    Raises:
        OutputError: another process has it, or it cannot be written to.
    """
    if folder is None:
        yield
        return
    folder = Path(folder)
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = (folder / LOCK).open("a")
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror}. Choose another --out.") from error
    with handle:
        if not lock(handle):
            raise OutputError(f"another {what} is writing into {folder}. Wait for it, or choose another --out.")
        try:
            yield
        finally:
            (folder / LOCK).unlink(missing_ok=True)
            with suppress(OSError):  # there is something in it
                for place in made:
                    place.rmdir()


def lock(handle: IO[Any]) -> bool:
    """Whether the file is ours alone until it is closed, be it by the end of the process."""
    try:
        import fcntl
    except ImportError:  # Windows
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def sweep(folder: str | Path, names: Sequence[str]) -> None:
    """Remove what :func:`atomic` has left of the files ``names`` where the process was killed."""
    for name in map(Path, names):
        for left in Path(folder).glob(f".{name.stem}-????????{name.suffix}"):
            left.unlink(missing_ok=True)


@contextmanager
def written(path: str | Path) -> Iterator[None]:
    """Have faults of the system while something is done to ``path`` raised as :class:`OutputError`."""
    try:
        yield
    except OSError as error:
        reason = str(error.strerror or error).rstrip(".")
        raise OutputError(f"cannot write {path}: {reason}. Free some space or choose another --out.") from error


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` with the same suffix; it replaces ``path`` when the block ends well.

    On any exception the temporary file is removed and ``path`` stays as it was.

    Raises:
        OutputError: the folder cannot be written to, or the disk is full.
    """
    path = Path(path)
    temporary = None
    try:
        with written(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            with NamedTemporaryFile(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix, delete=False) as file:
                temporary = Path(file.name)
            yield temporary
            temporary.chmod(0o644)
            os.replace(temporary, path)
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write ``content``, whole or not at all. Raises :class:`OutputError`."""
    with atomic(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` as UTF-8, whole or not at all; what is no Unicode, in the names of files, becomes a question mark.
    Raises :class:`OutputError`."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")
