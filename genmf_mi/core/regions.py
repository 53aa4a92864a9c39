"""What a person has painted on an object: strokes of a round brush that say where there shall be more or less relief.

Read from and written to files of the format ``genmf-regions``, which ``docs/regions.md`` describes.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

from genmf_mi.core.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np

FORMAT, VERSION = "genmf-regions", 1
StrokeKind = Literal["flat", "stronger", "matters", "erase"]
KINDS: tuple[StrokeKind, ...] = get_args(StrokeKind)
WITH_FACTOR: tuple[StrokeKind, ...] = ("stronger", "matters")
"""Kinds whose strokes have a factor."""
VERTEX_COLOURS = "vertex-colours"
"""In place of the file of a mask: the asset's own vertex colours are the mask, and not its colour."""
MASK_IMAGES, MASK_MESHES = (".png", ".jpg", ".jpeg", ".webp"), (".glb", ".ply", ".3mf")
"""Suffixes of files that may be a mask: images, and meshes that are one file with their colours."""
DEFAULT_FACTOR, LARGEST_FACTOR = 2.0, 5.0
"""Of a stroke that has none; and at most, as more makes the rest of the part disappear from the loss."""


@dataclass(frozen=True, eq=False)
class Stroke:
    """A stroke on the surface of an asset.

    kind: ``flat`` leaves the surface as it is; ``stronger`` multiplies the cap of the relief and the weight of the
        appearance by ``factor``, ``matters`` the weight alone; ``erase`` takes back what was painted before.
    points: ``float64 [N,3]``, a polyline in the coordinates of :attr:`genmf_mi.Asset.vertices`; one point is a dab.
    normals: ``float64 [N,3]``, the outward normals of the surface there, of any length.
    radius_mm: of the brush, on the part at the size that it is refined for.
    factor: 1 to 5, read for ``stronger`` and ``matters`` only.

    Raises:
        ConfigError: any of this is not so.
    """

    kind: StrokeKind
    points: np.ndarray
    normals: np.ndarray
    radius_mm: float
    factor: float = DEFAULT_FACTOR

    def __post_init__(self) -> None:
        def require(good: bool, what: str) -> None:
            if not good:
                raise ConfigError(f"a stroke {what}.")

        require(self.kind in KINDS, f"has the kind {self.kind!r}: there are {', '.join(KINDS)}")
        for name in ("points", "normals"):
            rows = _rows(getattr(self, name))
            require(rows is not None, f"has {name} that are not rows of three finite numbers, at least one row")
            object.__setattr__(self, name, rows)
        require(len(self.points) == len(self.normals), f"has {len(self.points)} points and {len(self.normals)} normals")
        require(
            bool((self.normals != 0).any(axis=1).all()),
            "has a normal of length 0: normals point away from the surface",
        )
        for name in ("radius_mm", "factor"):
            require(_is_number(getattr(self, name)), f"has a {name} that is no finite number")
        require(self.radius_mm > 0, f"has a radius_mm of {self.radius_mm:g}: it must be positive")
        require(
            self.kind not in WITH_FACTOR or 1 <= self.factor <= LARGEST_FACTOR,
            f"has the factor {self.factor:g}: it must be 1 to {LARGEST_FACTOR:g}",
        )

    def to_dict(self) -> dict[str, Any]:
        """As in the file."""
        told: dict[str, Any] = {
            "kind": self.kind,
            "points": self.points.tolist(),
            "normals": self.normals.tolist(),
            "radius_mm": float(self.radius_mm),
        }
        return told | ({"factor": float(self.factor)} if self.kind in WITH_FACTOR else {})


@dataclass(frozen=True, eq=False)
class Regions:
    """All strokes on an object, in the order in which they were painted: later ones override earlier ones."""

    strokes: tuple[Stroke, ...]

    @classmethod
    def read(cls, path: str | Path) -> Regions:
        """The strokes of a file.

        Raises:
            ConfigError: there is no such file, or it is not of the format ``genmf-regions``, version 1.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "it is not text"
            raise ConfigError(f"cannot read the regions {path}: {reason}. Give a file of strokes.") from error
        return cls.from_json(text, str(path))

    @classmethod
    def from_json(cls, text: str, name: str = "the text") -> Regions:
        """The strokes of the content of a file. Raises as :meth:`read`; ``name`` is for the message."""
        try:
            told: Any = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"{name} holds no regions: it is not JSON ({error}). Paint and save it again.") from error
        if not isinstance(told, dict) or cast("dict[str, Any]", told).get("format") != FORMAT:
            raise ConfigError(f'{name} holds no regions: its "format" is not "{FORMAT}". Give a file of strokes.')
        told = cast("dict[str, Any]", told)
        if told.get("version") != VERSION:
            raise ConfigError(
                f"{name} is of version {told.get('version')!r} of {FORMAT}, and only {VERSION} is known. "
                "Update genmf_mi, or save it as that version."
            )
        strokes = told.get("strokes")
        if not isinstance(strokes, list) or not strokes:
            raise ConfigError(f"{name} holds no strokes. Paint something, or leave the file out.")
        return cls(
            tuple(_stroke(each, f"stroke {i} of {name}") for i, each in enumerate(cast("list[Any]", strokes), 1))
        )

    def to_json(self) -> str:
        """The content of a file; :meth:`from_json` reads the same numbers back."""
        told = {"format": FORMAT, "version": VERSION, "strokes": [stroke.to_dict() for stroke in self.strokes]}
        return json.dumps(told, allow_nan=False) + "\n"


def _stroke(told: Any, name: str) -> Stroke:
    if not isinstance(told, dict):
        raise ConfigError(f"{name} is not an object with kind, points, normals and radius_mm.")
    told = cast("dict[str, Any]", told)
    missing = [key for key in ("kind", "points", "normals", "radius_mm") if key not in told]
    if missing:
        raise ConfigError(f"{name} has no {', '.join(missing)}.")
    try:
        return Stroke(
            told["kind"], told["points"], told["normals"], told["radius_mm"], told.get("factor", DEFAULT_FACTOR)
        )
    except ConfigError as error:
        raise ConfigError(str(error).replace("a stroke", name, 1)) from None


def _rows(values: Any) -> np.ndarray | None:
    """``float64 [N,3]``, N at least 1, or None if that is not what ``values`` are."""
    import numpy as np  # here, as the help of the commands starts without it

    try:
        rows = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    return rows if rows.ndim == 2 and rows.shape[1] == 3 and len(rows) and np.isfinite(rows).all() else None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
