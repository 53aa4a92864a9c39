"""Scenes around Φ itself: Mitsuba's ``sdfgrid`` shows the level set without a mesh. For looking, not for optimising.

``sdfgrid`` holds Φ on the unit cube, indexed z, y, x, and meets rays with its trilinear level set. It knows neither
deformation nor weights, so that where an :class:`SdfAsset` has them its mesh lies elsewhere, by a fraction of a cell.

Its derivatives with respect to the grid cannot be trusted (Mitsuba 3.9.1, ``tests/test_sdf_scene.py``). A hit point at
the distance t along the direction d has dt = -dΦ / (∇Φ · d). Mitsuba divides by the unit normal in place of ∇Φ when the
ray is fixed, so that every motion is too large by the slope |∇Φ| in units of the unit cube, pixel by pixel: the median
of (its derivative / finite difference / |∇Φ|) is 0.99999, and with Φ in grid units, of slope two, depth moves twice too
far. (``RayFlags.FollowShape`` does divide by ∇Φ, but glues the point to the surface where the ray should hold it.) The
shading normal is taken at that point. What it owes to the grid itself is right, so that the two no longer balance: grey
values are off by a factor of 2.2 on a ball, and parts of the normal have the wrong sign. Only a field of slope one
everywhere is differentiated well, with ``smooth`` normals (to 0.04 % on a ball at 129³, 4 % on an ellipsoid whose slope
is 0.8 to 1.2); ``analytic`` normals jump from cell to cell, which automatic differentiation cannot see (a factor of
0.3). An optimisation does not keep the slope, and its result would still have to be meshed: gradients go through
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
from genmf_mi.render import scene as scenes
from genmf_mi.render.scene import Scene


def write_grid(shape: SdfAsset, path: str | Path) -> Path:
    """Write Φ as the ``.vol`` file that ``sdfgrid`` reads, in units of the unit cube. Returns the path.

    A variant of Mitsuba must have been chosen (:func:`genmf_mi.render.variant.use`).

    Raises:
        OutputError: the file cannot be written.
    """
    import mitsuba as mi

    path = Path(path)
    grid = np.ascontiguousarray(shape.phi.transpose(2, 1, 0)[..., None] / 2, dtype=np.float32)
    try:
        with atomic(path) as temporary:
            mi.VolumeGrid(grid).write(str(temporary))
    except RuntimeError as error:  # so does Mitsuba call a full disk
        raise OutputError(f"cannot write {path}: {error}. Free some space or choose another --out.") from error
    return path


def placement(shape: SdfAsset, frame: Frame) -> dict[str, float]:
    """Where the grid lies in the normalised ``frame``: the parameters ``half``, ``x``, ``y``, ``z`` of a scene file."""
    centre = frame.normalise(np.asarray(shape.centre)[None])[0]
    return {"half": shape.half * frame.scale, **dict(zip("xyz", map(float, centre), strict=True))}


def load(
    xml: str | Path,
    grid: str | Path,
    shape: SdfAsset,
    frame: Frame,
    *,
    radius: float,
    resolution: int | None = None,
    samples: int | None = None,
) -> Scene:
    """Load the scene file ``xml`` (``*_sdf.xml``) around ``grid``, which :func:`write_grid` made of ``shape``.

    frame: of the surface that it is to be compared with, see :meth:`Frame.of`; the others as :func:`scene.load`. Render
    it with :func:`genmf_mi.render.bridge.render`, without vertices.

    Raises:
        SceneError: as :func:`scene.load`.
    """
    options = {"radius": radius, "resolution": resolution, "samples": samples}
    return scenes.load(xml, grid, holds=scenes.GRID, **options, **placement(shape, frame))
