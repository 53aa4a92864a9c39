"""The one place that picks the Mitsuba variant and names the scene parameters.

Dr.Jit needs LLVM as a shared library. With LLVM 14 to 16 it aborts the process at the first real kernel and raises
nothing, so the version is checked before anything is rendered.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from genmf_mi.core import llvm
from genmf_mi.core.errors import ConfigError, SetupError

CPU, CUDA = "llvm_ad_mono", "cuda_ad_mono"


# Keys under which `mi.traverse` exposes what a refinement changes; Mitsuba 3.10 renames the mesh parameters.
def vertex_positions_key(shape_id: str) -> str:
    return f"{shape_id}.vertex_positions"


def geometry_key(holds: str, shape_id: str) -> str:
    """The parameter that gives the shape its form, for a ``mesh`` or a ``grid``."""
    return vertex_positions_key(shape_id) if holds == "mesh" else f"{shape_id}.grid"


def faces_key(shape_id: str) -> str:
    return f"{shape_id}.faces"


def light_direction_keys(shape_id: str) -> tuple[str, str]:
    return f"{shape_id}.bsdf.key", f"{shape_id}.bsdf.fill"


def camera_pose_key(sensor_id: str) -> str:
    return f"{sensor_id}.to_world"


def fov_key(sensor_id: str) -> str:
    return f"{sensor_id}.x_fov"


def principal_point_keys(sensor_id: str) -> tuple[str, str]:
    return f"{sensor_id}.principal_point_offset_x", f"{sensor_id}.principal_point_offset_y"


def film_size_keys(sensor_id: str) -> tuple[str, str]:
    return f"{sensor_id}.film.size", f"{sensor_id}.film.crop_size"


def llvm_version() -> tuple[int, int, int] | None:
    """Version of the LLVM library that Dr.Jit found, or None. Safe to call with any LLVM."""
    import drjit

    detail: Any = drjit.detail  # its annotations are incomplete
    try:
        major, minor, patch = detail.llvm_version()
    except Exception:  # Dr.Jit raises a plain RuntimeError without LLVM
        return None
    return (
        (major, minor, patch) if min(major, minor, patch) >= 0 else None
    )  # (-1, -1, -1) without a library that it can use


def cuda_available() -> bool:
    """Whether Dr.Jit and torch both see a CUDA device."""
    import drjit
    import torch

    return torch.cuda.is_available() and bool(drjit.has_backend(drjit.JitBackend.CUDA))


def limit_threads(count: int) -> None:
    """Have Dr.Jit compute with ``count`` threads in place of one per core."""
    import drjit

    drjit.set_thread_count(count)


def use(device: str = "auto") -> str:
    """Activate the variant for ``device`` (``auto``, ``cpu`` or ``cuda``), register the plugins, return torch's
    device name.

    Raises:
        ConfigError: an unknown device.
        SetupError: no usable LLVM, or no CUDA device.
    """
    if device not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"device must be auto, cpu or cuda, not {device!r}.")
    if device == "cuda" and not cuda_available():
        raise SetupError(
            "no CUDA device is visible to both torch and Dr.Jit. Use --device cpu, or see `genmf-mi doctor`."
        )
    import drjit

    if drjit.log_level() == drjit.LogLevel.Warn:
        # The default prints a line for each kernel that cannot be kept in the cache on a full disk
        drjit.set_log_level(drjit.LogLevel.Error)
    if device == "auto":
        device = "cuda" if cuda_available() else "cpu"
    if device == "cpu":
        version = llvm_version()
        if version is None or version < llvm.OLDEST:
            found = "no LLVM" if version is None else f"LLVM {'.'.join(map(str, version))}, which is too old for Dr.Jit"
            raise SetupError(f"rendering needs LLVM 17 or newer, but there is {found}. {llvm.advice()}")

    if device == "cuda":
        import torch

        torch.backends.cudnn.allow_tf32 = False  # LPIPS would lose three digits

    import mitsuba as mi

    variant = CUDA if device == "cuda" else CPU
    if mi.variant() != variant:
        mi.set_variant(variant)
    import_module("genmf_mi.plugins")  # registers them
    return device
