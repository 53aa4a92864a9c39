"""Names, sizes and archives of uploads."""

from __future__ import annotations

import asyncio
import stat
import zipfile
from pathlib import Path

import pytest

from genmf_mi.core.errors import AssetError
from genmf_mi.ui import uploads
from genmf_mi.ui.uploads import TooLargeError, find_model, receive, safe_name, unpack


@pytest.mark.parametrize(
    ("name", "safe"),
    [("bus.glb", "bus.glb"), ("../../etc/passwd", "passwd"), ("C:\\temp\\a.obj", "a.obj"), ("..", "model"),
     ("", "model"), (".glb", "model.glb"), ("a\x00b\n.ply", "a_b_.ply"), ("-rf.glb", "rf.glb"),
     ("<img src=x onerror=alert(1)>.glb", "_img src=x onerror=alert(1)_.glb"), ("Käfer ☂ 3.glb", "Käfer ☂ 3.glb"),
     ("evil\u202egnp.glb", "evil_gnp.glb"), ("x" * 300 + ".glb", "x" * 120 + ".glb")],
)  # fmt: skip
def test_names_are_harmless(name, safe):
    assert safe_name(name) == safe


def archive(path: Path, files: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as opened:
        for name, content in files.items():
            opened.writestr(name, content)
    return path


def unpacked(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_archive_keeps_folders_and_leaves_out_litter(tmp_path):
    files = {"car/a.obj": b"o", "car/tex/a.png": b"p", "__MACOSX/car/._a.obj": b"x", "car/.DS_Store": b"x"}
    unpack(archive(tmp_path / "a.zip", files), tmp_path / "out")
    assert unpacked(tmp_path / "out") == {"car/a.obj": b"o", "car/tex/a.png": b"p"}
    assert find_model(tmp_path / "out") == tmp_path / "out" / "car" / "a.obj"


@pytest.mark.parametrize("name", ["../evil.glb", "/etc/evil.glb", "a/../../evil.glb", "..\\evil.glb", "C:\\evil.glb"])
def test_names_that_lead_out_are_refused(tmp_path, name):
    with pytest.raises(AssetError, match="lead out of it"):
        unpack(archive(tmp_path / "a.zip", {"a.glb": b"x", name: b"evil"}), tmp_path / "out")
    assert not list(tmp_path.rglob("evil*"))


def test_links_are_refused(tmp_path):
    link = zipfile.ZipInfo("a.glb")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as opened:
        opened.writestr(link, "/etc/passwd")
    with pytest.raises(AssetError, match="lead out of it"):
        unpack(tmp_path / "a.zip", tmp_path / "out")


def test_bombs_are_refused_before_they_are_unpacked(tmp_path, monkeypatch):
    bomb = archive(tmp_path / "bomb.zip", {"a.obj": bytes(40 << 20)}, zipfile.ZIP_DEFLATED)
    assert bomb.stat().st_size < 100_000
    with pytest.raises(TooLargeError, match="too large when unpacked"):
        unpack(bomb, tmp_path / "out")
    many = archive(tmp_path / "many.zip", {f"{i}.obj": b"" for i in range(uploads.MAX_MEMBERS + 1)})
    with pytest.raises(TooLargeError, match="2001 files"):
        unpack(many, tmp_path / "out")
    monkeypatch.setattr(uploads, "MAX_UNPACKED", 10)
    with pytest.raises(TooLargeError, match="too large when unpacked"):
        unpack(archive(tmp_path / "large.zip", {"a.obj": b"more than ten"}), tmp_path / "out")
    assert unpacked(tmp_path / "out") == {}


def test_an_archive_that_lies_about_its_size_is_refused(tmp_path):
    path = archive(tmp_path / "a.zip", {"a.obj": b"y" * 5000}, zipfile.ZIP_DEFLATED)
    data = path.read_bytes()
    path.write_bytes(data.replace((5000).to_bytes(4, "little"), (50).to_bytes(4, "little")))
    with pytest.raises(AssetError):
        unpack(path, tmp_path / "out")
    assert all(len(content) <= 50 for content in unpacked(tmp_path / "out").values())


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 nonsense", b"not a zip at all"])
def test_damaged_archives_are_refused(tmp_path, content):
    (tmp_path / "a.zip").write_bytes(content)
    with pytest.raises(AssetError, match="cannot be read"):
        unpack(tmp_path / "a.zip", tmp_path / "out")


def test_the_model_is_found(tmp_path):
    with pytest.raises(AssetError, match="no model"):
        find_model(tmp_path)
    for name in ("a.obj", "a.png", "b.stl"):
        (tmp_path / name).write_bytes(b"")
    assert find_model(tmp_path).name == "a.obj"
    (tmp_path / "c.obj").write_bytes(b"")
    with pytest.raises(AssetError, match=r"several models: a\.obj, c\.obj"):
        find_model(tmp_path)


def test_uploads_stop_at_the_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(uploads, "MAX_BYTES", 1000)

    async def chunks(count):
        for _ in range(count):
            yield bytes(100)

    asyncio.run(receive(chunks(10), tmp_path / "a"))
    assert (tmp_path / "a").stat().st_size == 1000
    with pytest.raises(TooLargeError, match="larger than"):
        asyncio.run(receive(chunks(1000), tmp_path / "b"))
    assert (tmp_path / "b").stat().st_size <= 1000
    with pytest.raises(AssetError, match="empty"):
        asyncio.run(receive(chunks(0), tmp_path / "c"))
