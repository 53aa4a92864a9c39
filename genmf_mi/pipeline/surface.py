"""The surface before refinement, with what there is to see on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from genmf_mi.assets.asset import Asset
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.colour import to_srgb, value
from genmf_mi.core.frame import Frame
from genmf_mi.geometry.low_pass import LowPass

TILT_AS_BRIGHTNESS = 0.2
"""By how much the encoded brightness changes under the two lights as the sine of a normal's tilt goes from 0 to 1: the
lights are some 40 degrees off the camera, a fifth of the light is ambient, and the curve of sRGB has a slope of about
0.6 in the middle."""


@dataclass(frozen=True)
class InitialSurface:
    """The surface before refinement, in the normalised frame.

    vertices, normals: ``float64 [V,3]``, the normals of unit length. faces: ``int64 [F,3]``. rgb: ``[V,3]``, linear, in
    full light. tilt: ``[V,3]``, what a normal map adds to the normals along the surface; None without one.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    rgb: np.ndarray
    tilt: np.ndarray | None = None

    @property
    def brightness(self) -> np.ndarray:
        """HSV value of the colour per vertex ``[V]``, sRGB-encoded."""
        return to_srgb(value(self.rgb))

    @property
    def signals(self) -> np.ndarray:
        """All that there is to see, ``[V,K]``, as changes of the encoded brightness; see :func:`signals`."""
        return signals(self.rgb, self.tilt)

    def contrast(self, low_pass: LowPass) -> np.ndarray:
        """``[V]``: by how much what is seen differs from its low-frequency component."""
        return np.max([np.abs(signal - low_pass.of(signal)) for signal in self.signals.T], axis=0)


def signals(rgb: np.ndarray, tilt: np.ndarray | None) -> np.ndarray:
    """What is seen at points as changes of the encoded brightness, ``[N,K]``: the brightness of ``rgb [N,3]``, and with
    a ``tilt [N,3]`` of the normals its three components too, as the lights show them."""
    brightness = to_srgb(value(rgb))[:, None]
    return brightness if tilt is None else np.concatenate([brightness, TILT_AS_BRIGHTNESS * tilt], axis=1)


def seen_at(
    asset: Asset | SdfAsset, points: np.ndarray, normals: np.ndarray, spacing: float = 0.0
) -> tuple[np.ndarray, np.ndarray | None]:
    """Linear RGB ``[N,3]`` in full light at ``points [N,3]`` in file units, and the tilt ``[N,3]`` of the ``normals
    [N,3]``, None without a normal map.

    spacing: of the points, see :func:`genmf_mi.assets.maps.look`.
    """
    rgb = asset.closest_albedo(points, normals)
    look = asset.look(points, normals, spacing)
    if look is None:
        return rgb, None
    tilt = look.tilt(normals)
    return look.colour(rgb), tilt if tilt.any() else None


def initial_surface(
    asset: Asset | SdfAsset, frame: Frame, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray
) -> InitialSurface:
    """Of ``vertices [V,3]`` and unit ``normals [V,3]`` in the normalised frame."""
    edges = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1)
    rgb, tilt = seen_at(asset, frame.restore(vertices), normals, float(edges.mean()) / frame.scale)
    return InitialSurface(vertices, faces, normals, rgb, tilt)
