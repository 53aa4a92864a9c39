"""Φ of a mesh as a differentiable function of its vertices.

Where the point c of the surface that is closest to a sample x lies on a triangle, Φ(x) = u·(x − c), u being the unit
vector between c and x that points outwards. Only the search for the triangle is expensive. It is done every few
calls: by libigl near the surface, and further inside by taking the nearest of the points found there. In between, c
and u follow the triangle. As c is where a distance is least, its place on the triangle need not be differentiated:
∂Φ/∂vᵢ = −wᵢ u, with the barycentric coordinates w of c.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from genmf_mi.sdf.distance import narrow_band, signed_distance
from genmf_mi.sdf.redistance import REACH_CELLS

SPARE_CELLS = 2.0
"""How much further out than the network looks triangles are kept: the surface may come that much closer between two
searches."""
_ON_SURFACE = 1e-6


class MeshDistance:
    """Φ on the grid [-1, 1]³, negative inside, of a mesh whose vertices move and whose faces stay.

    Just after a search it is exact near the surface, and at most some hundredths of a cell too large inside. Further
    out than the network looks, it is that of the last search and has no derivatives.

    faces: ``[F,3]``. n: samples per axis. every: calls from one search to the next.
    """

    def __init__(self, faces: np.ndarray, n: int = 129, every: int = 10) -> None:
        self.faces, self.n, self.every = np.ascontiguousarray(faces, dtype=np.int64), n, every
        self._calls = 0

    def __call__(self, vertices: Tensor) -> Tensor:
        """Φ ``[1,n,n,n]`` for ``vertices [V,3]`` in the normalised frame, differentiable with respect to them.

        Raises:
            SolidError: the surface encloses nothing, or its vertices are not numbers.
        """
        if self._calls % self.every == 0:
            self.search(vertices)
        self._calls += 1
        corners = vertices[self._corners]
        with torch.no_grad():
            weights, away, length = self._closest(corners)
            # A sample that the surface has passed over is on the other side
            side = torch.where((away * self._normal).sum(dim=1, keepdim=True) < 0, -1.0, 1.0).to(away)
            outwards = torch.where(length > _ON_SURFACE, side * away / length.clamp_min(_ON_SURFACE), self._normal)
        closest = (weights[..., None] * corners).sum(dim=1)
        value = ((self._points - closest) * outwards).sum(dim=1)
        return self._rest.index_put((self._index,), value).view(1, self.n, self.n, self.n)

    def search(self, vertices: Tensor) -> None:
        """Find the closest triangles anew; a call does so by itself when it is time."""
        from scipy.spatial import KDTree

        place = vertices.detach().cpu().double().numpy()
        near = narrow_band(place, self.faces, self.n)
        phi = signed_distance(place, self.faces, self.n, near).reshape(-1)
        reached = phi < (REACH_CELLS + SPARE_CELLS) * 2.0 / (self.n - 1)
        face = np.full(len(phi), -1)
        face[near.index] = near.face
        deep = np.flatnonzero(reached & (face < 0))
        if len(deep):
            some = near.distance < 2.0 / (self.n - 1)  # their points lie as dense as the others' and are far fewer
            tree = KDTree(near.closest[some], balanced_tree=False, compact_nodes=False)
            _, nearest = tree.query(self._at(deep), workers=-1)
            face[deep] = near.face[some][nearest]
        index = np.flatnonzero(reached)

        like = {"device": vertices.device, "dtype": vertices.dtype}
        self._index = torch.as_tensor(index, device=vertices.device)
        self._corners = torch.as_tensor(self.faces[face[index]], device=vertices.device)
        self._points, self._rest = torch.as_tensor(self._at(index), **like), torch.as_tensor(phi, **like)
        corners = vertices.detach()[self._corners]
        _, away, length = self._closest(corners)
        of_face = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        outwards = torch.where(self._rest[self._index] < 0, -1.0, 1.0).to(away)[:, None] * away
        self._normal = torch.nn.functional.normalize(torch.where(length > _ON_SURFACE, outwards, of_face), dim=1)

    def _closest(self, corners: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Barycentric coordinates of c, x − c, and its length ``[M,1]``."""
        weights = closest_weights(self._points, corners)
        away = self._points - (weights[..., None] * corners).sum(dim=1)
        return weights, away, away.norm(dim=1, keepdim=True)

    def _at(self, index: np.ndarray) -> np.ndarray:
        """Positions ``[M,3]`` of samples of the flattened grid."""
        return np.stack(np.unravel_index(index, (self.n,) * 3), axis=1) * (2.0 / (self.n - 1)) - 1.0


def closest_weights(points: Tensor, corners: Tensor) -> Tensor:
    """Where on each triangle ``corners [N,3,3]`` the point closest to ``points [N,3]`` is, in barycentric coordinates.

    Returns ``[N,3]``: none negative, their sum one; triangles without area will do.
    """
    a, b, c = corners.unbind(dim=1)
    first, second, offset = b - a, c - a, points - a
    aa, ab, bb = _dot(first, first), _dot(first, second), _dot(second, second)
    oa, ob = _dot(offset, first), _dot(offset, second)
    area = aa * bb - ab * ab
    flat = area <= 1e-9 * aa * bb
    v, w = ((bb * oa - ab * ob) / area.masked_fill(flat, 1), (aa * ob - ab * oa) / area.masked_fill(flat, 1))
    result = torch.stack([1 - v - w, v, w], dim=1)
    beside = flat | (result < 0).any(dim=1)
    result[beside] = _closest_on_edges(points[beside], corners[beside])
    return result


def _closest_on_edges(points: Tensor, corners: Tensor) -> Tensor:
    """The same for the three edges alone."""
    weights = points.new_zeros(3, len(points), 3)
    square = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        along, offset = corners[:, j] - corners[:, i], points - corners[:, i]
        share = (_dot(offset, along) / _dot(along, along).clamp_min(1e-30)).clamp(0, 1)
        weights[i, :, i], weights[i, :, j] = 1 - share, share
        square.append((offset - share[:, None] * along).square().sum(dim=1))
    nearest = torch.stack(square).argmin(dim=0)
    return weights[nearest, torch.arange(len(points), device=points.device)]


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(dim=1)
