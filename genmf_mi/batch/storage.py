"""Files on disk and behind URLs alike: ``s3://``, ``gs://``, ``file://`` and whatever else fsspec opens.

Places are texts; those without a scheme, and ``file://``, are paths. fsspec is imported at the first URL.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from genmf_mi.core.errors import GenmfError, OutputError, SetupError
from genmf_mi.core.files import write_text as write_file

EXTRAS = {"s3": "s3", "s3a": "s3", "gs": "gs", "gcs": "gs"}
"""The extra of this package that installs what fsspec needs for a scheme."""
WHOLE = ("s3", "s3a", "gs", "gcs", "az", "abfs", "memory")
"""Stores that show a file only once all of it has arrived; elsewhere a file is renamed when it is whole."""


class UrlError(GenmfError):
    """What a URL names cannot be reached."""


def is_url(place: str) -> bool:
    """Whether a place is not simply a path."""
    return "://" in place and not place.startswith("file://")


def path_of(place: str) -> Path:
    """The path of a place that is no URL."""
    return Path(place.removeprefix("file://"))


def join(folder: str, *names: str) -> str:
    """The place of a file in a folder."""
    return "/".join([folder.rstrip("/"), *names]) if is_url(folder) else str(path_of(folder).joinpath(*names))


def split(place: str) -> tuple[str, str]:
    """Folder and name."""
    if is_url(place):
        folder, _, name = place.rstrip("/").rpartition("/")
        return folder, name
    path = path_of(place)
    return str(path.parent), path.name


def file_system(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL, and the path in it.

    Raises:
        SetupError: a package is missing. UrlError: an unknown scheme, or nothing answers.
    """
    from fsspec.core import url_to_fs

    scheme = url.partition("://")[0]
    try:
        return url_to_fs(url)
    except ImportError as error:
        extra = f"pip install 'genmf-mi[{EXTRAS[scheme]}]'" if scheme in EXTRAS else f"install it ({error})"
        raise SetupError(f"{scheme}:// URLs need another package: {extra}.") from error
    except Exception as error:  # each file system raises its own
        raise _unreachable(url, error) from error


def _unreachable(url: str, error: Exception) -> UrlError:
    text = " ".join(str(error).split()) or type(error).__name__
    return UrlError(f"{url} cannot be reached: {text[:200]}. Check the URL, the network and the credentials.")


def exists(place: str) -> bool:
    """Whether there is a file. Raises :class:`UrlError`."""
    if not is_url(place):
        return path_of(place).is_file()
    system, path = file_system(place)
    try:
        return bool(system.exists(path))
    except Exception as error:
        raise _unreachable(place, error) from error


def version(place: str) -> str | None:
    """What changes with the content of a file, at the cost of asking for it: size and time, or the tag of the store.
    None if there is no file. Raises :class:`UrlError`."""
    if not is_url(place):
        try:
            status = path_of(place).stat()
        except OSError:
            return None
        return f"{status.st_size} {status.st_mtime_ns}"
    system, path = file_system(place)
    try:
        info = dict(system.info(path))
    except FileNotFoundError:
        return None
    except Exception as error:
        raise _unreachable(place, error) from error
    tags = [str(info[key]) for key in ("ETag", "etag", "md5Hash", "crc32c", "created", "mtime") if info.get(key)]
    return " ".join([str(info.get("size")), *tags])


def read_text(place: str) -> str | None:
    """The content of a file, None if there is none. Raises :class:`UrlError`, :class:`OutputError`."""
    try:
        if not is_url(place):
            return path_of(place).read_text(encoding="utf-8", errors="replace")
        system, path = file_system(place)
        return system.cat_file(path).decode("utf-8", errors="replace")
    except FileNotFoundError:
        return None
    except GenmfError:
        raise
    except OSError as error:
        if is_url(place):
            raise _unreachable(place, error) from error
        raise OutputError(f"cannot read {place}: {error.strerror}. Check its permissions.") from error
    except Exception as error:
        raise _unreachable(place, error) from error


def write_text(place: str, text: str) -> None:
    """Write a file, whole or not at all. Raises :class:`OutputError`, :class:`UrlError`."""
    if not is_url(place):
        write_file(path_of(place), text)
        return
    with TemporaryDirectory(prefix="genmf-") as folder:
        (path := Path(folder) / "text").write_text(text, encoding="utf-8")
        upload(path, place)


def upload(path: Path, url: str) -> None:
    """Copy a file to a URL, whole or not at all. Raises :class:`UrlError`."""
    system, target = file_system(url)
    try:
        system.makedirs(target.rpartition("/")[0], exist_ok=True)
        if url.partition("://")[0] in WHOLE:
            system.put_file(str(path), target)
        else:
            system.put_file(str(path), f"{target}.part")
            system.mv(f"{target}.part", target)
    except Exception as error:
        raise _unreachable(url, error) from error


def download(url: str, path: Path) -> bool:
    """Copy a file from a URL; False if there is none. Raises :class:`UrlError`."""
    system, source = file_system(url)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        system.get_file(source, str(path))
    except FileNotFoundError:
        path.unlink(missing_ok=True)
        return False
    except Exception as error:
        raise _unreachable(url, error) from error
    return True


def remove(place: str) -> None:
    """Remove a file if it is there."""
    if not is_url(place):
        path_of(place).unlink(missing_ok=True)
    elif exists(place):
        system, path = file_system(place)
        system.rm_file(path)


def find(folder: str, pattern: str, *, deep: bool = False) -> list[str]:
    """The files in a folder whose names fit, in order; with ``deep`` those of all folders below too. Raises
    :class:`UrlError`."""
    if not is_url(folder):
        root = path_of(folder)
        return sorted(str(path) for path in (root.rglob(pattern) if deep else root.glob(pattern)) if path.is_file())
    system, root = file_system(folder)
    try:
        files = system.find(root, maxdepth=None if deep else 1)
    except FileNotFoundError:
        return []
    except Exception as error:
        raise _unreachable(folder, error) from error
    inside = [file.removeprefix(root).lstrip("/") for file in files]
    return sorted(join(folder, file) for file in inside if fnmatch.fnmatch(file.rpartition("/")[2], pattern))


def matching(pattern: str) -> list[str]:
    """The files that a pattern with ``*``, ``?`` and ``**`` means, in order. Raises :class:`UrlError`."""
    if not is_url(pattern):
        import glob

        text = str(path_of(pattern))
        return sorted(path for path in glob.glob(text, recursive=True) if Path(path).is_file())
    system, path = file_system(pattern)
    try:
        return sorted(f"{pattern.partition('://')[0]}://{file.lstrip('/')}" for file in system.glob(path))
    except Exception as error:
        raise _unreachable(pattern, error) from error


@contextmanager
def workspace(folder: str, wanted: tuple[str, ...]) -> Iterator[Path]:
    """A folder on disk to work in: ``folder`` itself if it is a path; else a temporary one with the files ``wanted``
    of it, as far as they exist."""
    if not is_url(folder):
        yield path_of(folder)
        return
    with TemporaryDirectory(prefix="genmf-") as temporary:
        path = Path(temporary) / split(folder)[1]
        path.mkdir()
        for name in wanted:
            download(join(folder, name), path / name)
        yield path
