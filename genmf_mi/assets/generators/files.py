"""Reading and writing the files of docs/generators.md: NPZ, safetensors and PT, without running code in them."""

from __future__ import annotations

import math
import pickle
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from genmf_mi.assets import asset as meshes
from genmf_mi.assets.asset import Asset
from genmf_mi.assets.generators import instantmesh, trellis
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.assets.suffixes import FIELDS
from genmf_mi.core import colour
from genmf_mi.core.errors import AssetError
from genmf_mi.core.files import atomic
from genmf_mi.core.text import printable
from genmf_mi.mesh.nearest import distance_to_surface

if TYPE_CHECKING:
    from torch import Tensor

LARGEST = 1024**3
"""Bytes of all arrays in a file."""
MOST_PACKED, UNSUSPICIOUS = 200, 128 * 1024**2
"""How much an archive may be packed, and bytes up to which that does not matter."""
_PICKLED = "holds pickled objects, which could run code when read. Save plain arrays only, see docs/generators.md."
_MAX_DISTANCE = 0.05
"""Mean distance, as a share of the longest side, up to which a textured mesh is taken for the same object."""


def load(path: str | Path, textured: str | Path | Asset | None = None) -> SdfAsset:
    """Read a file that a generator's user, or :func:`save`, wrote; its keys determine the schema.

    Args:
        textured: the same object as a mesh with colours, y up or in the generator's own frame; it replaces colours in
            the file.

    Raises:
        AssetError: the file is missing, damaged, of an unknown kind or schema, or holds pickled objects; its arrays do
            not describe a shape; or ``textured`` is another object.
    """
    path = Path(path)
    arrays = read(path)
    try:
        return _built(path, arrays, textured)
    except (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise AssetError(
            f"the arrays in {path} do not describe a shape ({type(error).__name__}: {error}). See docs/generators.md."
        ) from error


def _built(path: Path, arrays: dict[str, np.ndarray], textured: str | Path | Asset | None) -> SdfAsset:
    if "coords" in arrays and "feats" in arrays:
        rotation = trellis.TO_Y_UP
        resolution = int(_scalar(path, arrays, "resolution", trellis.RESOLUTION))
        shape = trellis.build(
            printable(path.stem), arrays["coords"], arrays["feats"], resolution=resolution, source=path
        )
    elif "sdf" in arrays:
        rotation = instantmesh.TO_Y_UP
        shape = instantmesh.build(
            printable(path.stem),
            arrays["sdf"],
            arrays.get("deformation"),
            arrays.get("weights"),
            scale=_scalar(path, arrays, "scale", instantmesh.SCALE),
            source=path,
        )
    elif "phi" in arrays:
        rotation = np.eye(3)
        centre = arrays.get("centre", np.zeros(3)).reshape(-1)
        if len(centre) != 3:
            raise AssetError(f"{path}: centre must be three numbers.")
        x, y, z = map(float, centre)
        shape = SdfAsset(
            printable(path.stem),
            arrays["phi"].astype(np.float32),
            _float32(arrays.get("deformation")),
            _float32(arrays.get("weights")),
            arrays.get("rows"),
            spread=_scalar(path, arrays, "spread", SdfAsset.spread),
            centre=(x, y, z),
            half=_scalar(path, arrays, "half", SdfAsset.half),
            source=path,
        )
    else:
        raise AssetError(
            f"{path} holds {', '.join(sorted(arrays)) or 'nothing'}. It needs sdf (InstantMesh) or coords and feats "
            "(TRELLIS), see docs/generators.md."
        )
    if textured is not None:
        mesh = textured if isinstance(textured, Asset) else meshes.load(textured)
        return replace(shape, coloured=_aligned(shape, mesh, rotation))
    if "colours" in arrays:
        return replace(shape, coloured=_coloured(path, arrays, rotation))
    return shape


def read(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays of a file by name; half and bfloat16 become float32.

    Raises:
        AssetError: as :func:`load`.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.is_file():
        raise AssetError(f"{path} does not exist. Check the spelling, or give the full path.")
    if suffix not in FIELDS:
        raise AssetError(f"{path} is of an unknown kind ({suffix or 'no suffix'}). Use one of {', '.join(FIELDS)}.")
    try:
        arrays = {".npz": _read_npz, ".safetensors": _read_safetensors, ".pt": _read_pt}[suffix](path)
    except AssetError:
        raise
    except Exception as error:  # damaged files make the readers raise anything at all
        raise AssetError(
            f"{path} cannot be read as {suffix[1:].upper()} ({type(error).__name__}: {error}). Write it again."
        ) from error
    if odd := [key for key, array in arrays.items() if array.dtype.kind not in "fiub"]:
        raise AssetError(f"{path}: {odd[0]} holds no real numbers but {arrays[odd[0]].dtype}. See docs/generators.md.")
    return {key: array.astype(np.float32) if array.dtype == np.float16 else array for key, array in arrays.items()}


def save(shape: SdfAsset, path: str | Path) -> Path:
    """Write ``shape`` as NPZ or safetensors, with its colours per vertex of its surface. Returns the path.

    Raises:
        AssetError: another suffix.
        OutputError: the file cannot be written.
    """
    path = Path(path)
    arrays = {key: getattr(shape, key) for key in ("phi", "deformation", "weights", "rows")}
    arrays = {key: array for key, array in arrays.items() if array is not None}
    arrays |= {"centre": np.array(shape.centre), "half": np.array([shape.half]), "spread": np.array([shape.spread])}
    if shape.coloured is not None:
        mesh = shape.as_mesh()
        encoded = np.rint(255 * colour.to_srgb(mesh.albedo.colours)).astype(np.uint8)
        arrays |= {"vertices": mesh.vertices.astype(np.float32), "faces": mesh.faces, "colours": encoded}
    if path.suffix.lower() not in FIELDS[:2]:
        raise AssetError(f"{path} cannot be written; its suffix must be one of {', '.join(FIELDS[:2])}.")
    with atomic(path) as temporary:
        if path.suffix.lower() == ".npz":
            np.savez_compressed(temporary, **arrays)
        else:
            from safetensors.numpy import save as serialize

            # Its own writer raises an error of its own kind when the disk is full
            temporary.write_bytes(serialize({key: np.ascontiguousarray(array) for key, array in arrays.items()}))
    return path


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    if not zipfile.is_zipfile(path):
        raise AssetError(f"{path} is not an NPZ file. Write it with numpy.savez_compressed.")
    _require_size(path)
    arrays: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if not member.filename.endswith(".npy"):
                raise AssetError(f"{path} holds {member.filename}, which is no array. Save plain arrays only.")
            with archive.open(member) as stream:
                _require_header(path, member, stream)
            with archive.open(member) as stream:
                arrays[member.filename.removesuffix(".npy")] = np.lib.format.read_array(stream, allow_pickle=False)
    return arrays


def _require_size(path: Path) -> None:
    """Raise :class:`AssetError` for an archive that would not fit, or that packs what no shape could be packed to."""
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > LARGEST or size > max(UNSUSPICIOUS, MOST_PACKED * path.stat().st_size):
        raise AssetError(
            f"{path}, of {path.stat().st_size / 1e6:.1f} MB, unpacks to {size / 1e6:.0f} MB. "
            "Save the arrays of one shape only."
        )


def _require_header(path: Path, member: zipfile.ZipInfo, stream: IO[bytes]) -> None:
    """Raise :class:`AssetError` for an array of objects, or one that tells another size than the archive has of it."""
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    if dtype.hasobject:
        raise AssetError(f"{path} {_PICKLED}")
    if math.prod(shape) * dtype.itemsize > member.file_size:
        raise AssetError(f"{path} is damaged: {member.filename} is shorter than it tells. Write it again.")


def _read_safetensors(path: Path) -> dict[str, np.ndarray]:
    from safetensors.torch import load_file

    return {key: _array(path, tensor) for key, tensor in load_file(path).items()}


def _read_pt(path: Path) -> dict[str, np.ndarray]:
    import torch

    if zipfile.is_zipfile(path):
        _require_size(path)
    try:
        with warnings.catch_warnings():  # about pickles of another kind than torch's own, which are refused below
            warnings.simplefilter("ignore")
            content = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise AssetError(f"{path} {_PICKLED}") from error
    if not isinstance(content, dict):
        raise AssetError(f"{path} holds a {type(content).__name__}; it must be a dictionary of tensors.")
    return {
        str(key): _array(path, value) if torch.is_tensor(value) else np.asarray(value)
        for key, value in content.items()
        if torch.is_tensor(value) or isinstance(value, int | float)
    }


def _array(path: Path, tensor: Tensor) -> np.ndarray:
    import torch

    if tensor.numel() * tensor.element_size() > LARGEST:  # a few numbers can stand for all of a large tensor
        raise AssetError(f"{path} holds a tensor of {tensor.numel()} numbers. Save the arrays of one shape only.")
    return (tensor.float() if tensor.dtype == torch.bfloat16 else tensor).detach().contiguous().numpy()


def _float32(array: np.ndarray | None) -> np.ndarray | None:
    return None if array is None else array.astype(np.float32)


def _scalar(path: Path, arrays: dict[str, np.ndarray], key: str, default: float) -> float:
    value = np.asarray(arrays.get(key, default))
    if value.size != 1 or not np.issubdtype(value.dtype, np.number) or not np.isfinite(value).all():
        raise AssetError(f"{path}: {key} must be one number.")
    return float(value.reshape(()))


def _coloured(path: Path, arrays: dict[str, np.ndarray], rotation: np.ndarray) -> Asset:
    """The mesh with sRGB-encoded colours per vertex that a file can have beside the grid."""
    missing = {"vertices", "faces"} - set(arrays)
    if missing:
        raise AssetError(f"{path} has colours but no {' and no '.join(sorted(missing))} that they belong to.")
    colours = arrays["colours"]
    encoded = colours / 255 if colours.dtype == np.uint8 else colours
    if not np.isfinite(encoded).all() or encoded.min(initial=0) < -0.01 or encoded.max(initial=0) > 1.01:
        raise AssetError(f"{path}: colours must be bytes, or numbers from 0 to 1.")
    vertices = arrays["vertices"].reshape(-1, 3) @ rotation.T
    linear = colour.to_linear(np.clip(encoded, 0, 1)).reshape(len(encoded), -1)[:, :3]
    return Asset.from_arrays(path.stem, vertices, arrays["faces"], colours=linear)


def _aligned(shape: SdfAsset, mesh: Asset, rotation: np.ndarray) -> Asset:
    """``mesh``, rotated from the generator's own frame to y up if it fits ``shape`` better that way."""
    vertices, faces = shape.surface()
    longest = np.ptp(vertices, axis=0).max()
    rotated = replace(mesh, vertices=mesh.vertices @ rotation.T)
    distance, best = min(
        (
            (distance_to_surface(one.vertices[np.unique(one.faces)], vertices, faces).mean(), one)
            for one in (mesh, rotated)
        ),
        key=lambda pair: pair[0],
    )
    if distance > _MAX_DISTANCE * longest:
        raise AssetError(
            f"{mesh.name} is not at the position of {shape.name}: its vertices are {distance / longest:.0%} of the "
            "longest side away from the surface. Give the mesh that the generator wrote, neither moved nor scaled."
        )
    return best
