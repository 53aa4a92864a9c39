"""Views: where the camera stands, and how the lights are turned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64
from numpy import ndarray
from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs]  (SciPy ships no types)


@dataclass(frozen=True)
class View:
    """A camera on a sphere around the object, and a turn of its lights.

    azimuth, elevation: degrees; azimuth 0 looks at the +z side, 90 at the +x side.
    light_turn: degrees by which both lights are turned about the camera's vertical and horizontal axis.
    zoom: magnification of the image about its point ``centre``, which is given from the middle of the whole image, to
        the right and downwards, in shares of its width.
    """

    azimuth: float
    elevation: float
    light_turn: tuple[float, float] = (0.0, 0.0)
    zoom: float = 1.0
    centre: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def parse(cls, text: str, separator: str) -> View:
        """Azimuth and elevation from text. Raises ValueError."""
        azimuth, elevation = map(float, text.split(separator))
        if not (np.isfinite(azimuth) and abs(elevation) <= 90):
            raise ValueError(text)
        return cls(azimuth, elevation)

    @classmethod
    def facing(cls, normal: Float[ndarray, " 3"]) -> View:
        """The camera looks along ``-normal``, a unit vector."""
        x, y, z = (float(k) for k in normal)
        return cls(float(np.degrees(np.arctan2(x, z))), float(np.degrees(np.arcsin(np.clip(y, -1, 1)))))

    @property
    def label(self) -> str:
        return f"azimuth {self.azimuth:g}°, elevation {self.elevation:g}°"


def light_rotation(view: View) -> Float64[ndarray, "3 3"]:
    """By how the lights of a view are turned."""
    return rotation("y", view.light_turn[0]) @ rotation("x", view.light_turn[1])


def image_axes(view: View) -> Float64[ndarray, "3 3"]:
    """The columns right, up, and towards the viewer of the image, in the world."""
    # Mitsuba's camera has x to the left and looks along z
    return camera_to_world(view, 1.0)[:3, :3] * [-1.0, 1.0, -1.0]


def camera_to_world(view: View, distance: float) -> Float64[ndarray, "4 4"]:
    """Camera-to-world matrix of a camera at ``distance`` from the origin, which it faces.

    Mitsuba's camera looks along +z with +x to its left.
    """
    matrix = np.eye(4)
    matrix[:3, :3] = rotation("y", view.azimuth) @ rotation("x", -view.elevation) @ rotation("y", 180)
    matrix[:3, 3] = -distance * matrix[:3, 2]
    return matrix


def project(points: Float64[ndarray, "N 3"], view: View, distance: float, half_width: float) -> Float64[ndarray, "N 2"]:
    """Where points ``[N,3]`` appear in the whole image, in the coordinates of :attr:`View.centre`.

    half_width: of the image at unit distance.
    """
    matrix = camera_to_world(view, distance)
    local = (points - matrix[:3, 3]) @ matrix[:3, :3]
    return -local[:, :2] / local[:, 2:] / (2 * half_width)


def rotation(axis: str, degrees: float) -> Float64[ndarray, "3 3"]:
    """Rotation about ``x``, ``y`` or ``z``."""
    return np.asarray(Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), dtype=np.float64)
