"""Inside or outside, for surfaces that may be open or intersect themselves."""

from __future__ import annotations

import igl
import numpy as np


def winding_number(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Generalised winding number ``float64 [N]`` of the surface about ``points [N,3]``.

    Inside a closed surface that is oriented outwards it is 1, outside 0; with holes it lies between (Jacobson et al.
    2013). Evaluated by the tree of dipoles of Barill et al. (2018).
    """
    return np.asarray(igl.fast_winding_number(*map(np.ascontiguousarray, (vertices, faces, points))))
