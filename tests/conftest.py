"""What all tests share: a fixed number of threads, and the folder of real assets where there is one."""

from __future__ import annotations

import os
import resource
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

# Before NumPy and torch are imported: many threads on small arrays only cost time, and sums depend on their number.
os.environ.setdefault("OMP_NUM_THREADS", "2")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest
from jaxtyping import install_import_hook

# Before genmf_mi is imported: shapes and types in the signatures of these packages are checked at every call
install_import_hook(["genmf_mi.losses", "genmf_mi.render", "genmf_mi.stress.model"], "typechecker.check")


@pytest.fixture(scope="session")
def assets() -> Path:
    """The folder of textured meshes that ``GENMF_TEST_ASSETS`` names; skips the test if it is not set."""
    folder = os.environ.get("GENMF_TEST_ASSETS")
    if not folder:
        pytest.skip("GENMF_TEST_ASSETS is not set; it names a folder of textured meshes")
    return Path(folder)


@pytest.fixture
def workplace(tmp_path, monkeypatch) -> Path:
    """An empty working folder of the test's own, with an empty folder for temporary files beside it."""
    for name in ("work", "scratch"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))
    return tmp_path / "work"


@pytest.fixture(scope="session")
def full_disk() -> Callable[[], AbstractContextManager]:
    """A context in which no file can grow beyond 1 kB, which fails like a full disk in any library."""

    @contextmanager
    def limited() -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limited


@pytest.fixture(scope="module")
def lpips_weights():
    """LPIPS networks for whole runs: the installed weights, or random ones where there are none."""
    import torch

    from genmf_mi.losses import lpips_weights as weights
    from genmf_mi.losses import perceptual

    if not weights.missing():
        yield
        return

    def random(network: str) -> dict[str, torch.Tensor]:
        generator, inputs, made = torch.Generator().manual_seed(0), 3, {}
        kernels = (11, 5, 3, 3, 3) if network == "alex" else (3,) * 13
        for i, (outputs, kernel) in enumerate(zip(weights.CHANNELS[network], kernels, strict=True)):
            scale = (2 / (inputs * kernel**2)) ** 0.5
            made[f"conv{i}.weight"] = scale * torch.randn(outputs, inputs, kernel, kernel, generator=generator)
            made[f"conv{i}.bias"], inputs = torch.zeros(outputs), outputs
        for i, tap in enumerate(weights.TAPS[network]):
            made[f"linear{i}"] = torch.rand(weights.CHANNELS[network][tap], generator=generator)
        return made

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(weights, "load", random)
        patch.setattr(weights, "missing", list)
        perceptual._network.cache_clear()
        yield
    perceptual._network.cache_clear()


@pytest.fixture(scope="module")
def two_views(tmp_path_factory) -> Path:
    """A scene file with two standard views instead of six."""
    from genmf_mi.render import scene_file

    text = scene_file.standalone_xml("default", "mesh.ply")
    six = scene_file.read_defaults(scene_file.find("default"))["views"]
    path = tmp_path_factory.mktemp("scene") / "two_views.xml"
    path.write_text(text.replace(six, "0:20 180:-10"))
    return path


@pytest.fixture(scope="module")
def small_refinements(lpips_weights) -> Iterator[None]:
    """Small pictures and meshes, and two of the displacements."""
    from genmf_mi.pipeline import displacement, evaluator, optimisation, problem
    from genmf_mi.render import target

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluator, "RESOLUTION", 64)
        patch.setattr(evaluator, "SAMPLES", 4)
        patch.setattr(target, "FINEST", 24_000)
        patch.setattr(displacement, "AMPLITUDES", (-0.5, 0.5))
        patch.setattr(optimisation, "CHECKPOINT_EVERY", 2)
        patch.setattr(problem, "DETAIL_MM", 60.0)  # edges of 3 mm hold no detail of a real part
        yield


@pytest.fixture
def coarse_warpage(monkeypatch) -> None:
    """Warpage by meshes of some hundred nodes; it is a dozen solves, on a mesh of its own."""
    monkeypatch.setattr("genmf_mi.stress.fem.warpage.FINEST", 0.2)
