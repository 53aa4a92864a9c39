"""Scenes around Φ itself: Mitsuba's ``sdfgrid`` shows the level set without a mesh. For viewing, not for optimising.

``sdfgrid`` holds Φ on the unit cube, indexed z, y, x, and meets rays with its trilinear level set. It knows neither
deformation nor weights, so that where an :class:`SdfAsset` has them its mesh lies elsewhere, by a fraction of a cell.
A scene file ``*_sdf.xml`` is loaded around the grid by :func:`genmf_mi.render.scene.load` with ``holds=GRID``.

Its derivatives with respect to the grid are wrong (Mitsuba 3.9.1, ``tests/render/test_sdf_derivatives.py``):

- The hit point at the distance t along the direction d has dt = -dΦ / (∇Φ · d). With fixed rays Mitsuba divides by the
  unit normal in place of ∇Φ, so that every motion is too large by the slope |∇Φ| in units of the unit cube, pixel by
  pixel: the median of (its derivative / finite difference / |∇Φ|) is 0.99999, and with Φ in grid units, of slope two,
  depth moves twice too far. (``RayFlags.FollowShape`` does divide by ∇Φ, but moves the point with the surface where it
  should stay on its ray.)
- The shading normal is taken at that point. Its direct derivative with respect to the grid is right, so that the two no
  longer balance: grey values are off by a factor of 2.2 on a ball, and parts of the normal have the wrong sign.
- Only a field of slope one everywhere is differentiated well, with ``smooth`` normals (to 0.04 % on a ball at 129³, 4 %
  on an ellipsoid whose slope is 0.8 to 1.2). ``analytic`` normals jump from cell to cell, which automatic
  differentiation cannot see (a factor of 0.3).

An optimisation does not keep the slope, and its result would still have to be meshed: gradients go through
:mod:`genmf_mi.sdf.flexicubes`, and the integrator ``monochrome`` refuses them here.

Whoever changes the grid of a loaded scene must call ``drjit.sync_thread()`` first, since Embree reads the old one while
a kernel runs: without waiting the process crashed in 8 of 9 runs of 60 changes each, with it in none of 12.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.errors import OutputError
from genmf_mi.core.files import atomic
from genmf_mi.core.frame import Frame
from genmf_mi.render.untyped import mi


def write_grid(shape: SdfAsset, path: str | Path) -> Path:
    """Write Φ as the ``.vol`` file that ``sdfgrid`` reads, in units of the unit cube. Returns the path.

    A variant of Mitsuba must have been chosen (:func:`genmf_mi.render.variant.use`).

    Raises:
        OutputError: the file cannot be written.
    """
    path = Path(path)
    grid = np.ascontiguousarray(shape.phi.transpose(2, 1, 0)[..., None] / 2, dtype=np.float32)
    try:
        with atomic(path) as temporary:
            mi.VolumeGrid(grid).write(str(temporary))
    except RuntimeError as error:  # which is how Mitsuba reports a full disk
        raise OutputError(f"cannot write {path}: {error}. Free some space or choose another --out.") from error
    return path


def placement(shape: SdfAsset, frame: Frame) -> dict[str, float]:
    """Where the grid lies in the normalised ``frame``: the parameters ``half``, ``x``, ``y``, ``z`` of a scene file."""
    centre = frame.normalise(np.asarray(shape.centre)[None])[0]
    return {"half": shape.half * frame.scale, **dict(zip("xyz", map(float, centre), strict=True))}
