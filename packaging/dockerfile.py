"""Runs the steps of a Dockerfile in a clean Debian, where there is no Docker daemon.

    python packaging/dockerfile.py docker/Dockerfile [--build-arg NAME=VALUE] [--root DIR] [-- COMMAND]

Needs debootstrap and root. Knows FROM debian:SUITE-slim, ARG, ENV, RUN, COPY, USER, WORKDIR, ENTRYPOINT and CMD, which
is what our files use, and stops at anything else. Then COMMAND runs as `docker run` would run it, as the file's user,
with the current folder in /work. The network, the certificates and a folder of wheels (PIP_FIND_LINKS) are this
machine's.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from glob import glob
from pathlib import Path

PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
PASSED_ON = ("PIP_FIND_LINKS", "PIP_DEFAULT_TIMEOUT")
CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"


@dataclass
class Image:
    """What the steps so far have made."""

    root: Path
    environment: dict[str, str] = field(default_factory=lambda: {"PATH": PATH})
    arguments: dict[str, str] = field(default_factory=dict)
    user: str = "root"
    folder: str = "/"
    entrypoint: list[str] = field(default_factory=list)
    command: list[str] = field(default_factory=list)


def instructions(text: str) -> list[tuple[str, str]]:
    """``[(keyword, rest)]`` of a Dockerfile, continued lines joined, comments left out."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    joined = re.sub(r"\\\n", " ", "\n".join(lines))
    split = (line.strip().partition(" ") for line in joined.splitlines() if line.strip())
    return [(keyword.upper(), rest.strip()) for keyword, _, rest in split]


def expanded(text: str, image: Image) -> str:
    """With the variables of ENV and ARG put in."""
    known = image.arguments | image.environment
    return re.sub(r"\$\{?(\w+)\}?", lambda match: known.get(match[1], ""), text)


def step(image: Image, keyword: str, rest: str, context: Path, given: dict[str, str]) -> None:
    """Carry out one instruction.

    Raises:
        NotImplementedError: an instruction, or a form of one, that our files do not use.
    """
    if keyword == "FROM":
        base = re.fullmatch(r"debian:(\w+)-slim", rest)
        if base is None:
            raise NotImplementedError(f"FROM {rest}")
        if not (image.root / "etc/debian_version").exists():
            subprocess.run(["debootstrap", "--variant=minbase", base[1], str(image.root)], check=True)
    elif keyword == "ARG":
        name, _, default = rest.partition("=")
        image.arguments[name] = given.get(name, default)
    elif keyword == "ENV":
        for word in shlex.split(rest):
            name, _, value = word.partition("=")
            image.environment[name] = expanded(value, image)
    elif keyword == "RUN":
        run(image, ["/bin/sh", "-c", rest], image.arguments)
    elif keyword == "COPY":
        *sources, target = shlex.split(rest)
        for source in sources:
            for file in glob(str(context / source)):
                shutil.copy(file, image.root / target.lstrip("/"))
    elif keyword == "USER":
        image.user = rest
    elif keyword == "WORKDIR":
        image.folder = rest
        (image.root / rest.lstrip("/")).mkdir(parents=True, exist_ok=True)
    elif keyword in ("ENTRYPOINT", "CMD"):
        setattr(image, "entrypoint" if keyword == "ENTRYPOINT" else "command", json.loads(rest))
    else:
        raise NotImplementedError(f"{keyword} {rest}")


def run(image: Image, command: list[str], more: dict[str, str] | None = None, volume: Path | None = None) -> None:
    """Run a command in the image, with what Docker provides: /proc, /dev, the network, and ``volume`` in /work."""
    root, links = image.root, os.environ.get("PIP_FIND_LINKS", "")
    mounts = f"mount -t proc proc {root}/proc; mount --rbind /dev {root}/dev"
    for source, target in ((links, links), (volume, "/work")):
        if source and Path(source).is_dir():
            (root / target.lstrip("/")).mkdir(parents=True, exist_ok=True)
            mounts += f"; mount --bind {shlex.quote(str(source))} {shlex.quote(str(root) + target)}"
    shutil.copy("/etc/resolv.conf", root / "etc/resolv.conf")
    if Path(CERTIFICATES).exists() and (root / CERTIFICATES.lstrip("/")).exists():
        shutil.copy(CERTIFICATES, root / CERTIFICATES.lstrip("/"))
    environment = {name: os.environ[name] for name in PASSED_ON if name in os.environ}
    environment |= image.environment | (more or {}) | {"DEBIAN_FRONTEND": "noninteractive"}
    inside = f"cd {shlex.quote(image.folder)} && exec {shlex.join(command)}"
    user = [] if image.user == "root" else [f"--userspec={image.user}"]
    chroot = shlex.join(["chroot", *user, str(root), "/bin/sh", "-c", inside])
    subprocess.run(["unshare", "--mount", "sh", "-ec", f"{mounts}; exec {chroot}"], env=environment, check=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--build-arg", action="append", default=[])
    parser.add_argument("--root", type=Path, help="keep the image there")
    ours, _, command = " ".join(sys.argv[1:]).partition(" -- ")
    chosen = parser.parse_args(shlex.split(ours))
    root = chosen.root or Path(tempfile.mkdtemp(prefix="genmf-image-"))
    image = Image(root)
    given = dict(argument.split("=", 1) for argument in chosen.build_arg)
    try:
        for keyword, rest in instructions(chosen.file.read_text(encoding="utf-8")):
            print(f"=> {keyword} {rest}", flush=True)
            step(image, keyword, rest, Path.cwd(), given)
        words = [*image.entrypoint, *(shlex.split(command) or image.command)]
        print(f"=> docker run -v $PWD:/work: {shlex.join(words)}", flush=True)
        run(image, words, volume=Path.cwd())
    finally:
        if chosen.root is None:
            shutil.rmtree(root, ignore_errors=True)


if __name__ == "__main__":
    main()
