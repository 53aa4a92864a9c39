"""Relief on a mesh: what the optimiser moves, and what keeps it within bounds.

The latent variable u is related to the offsets x of the vertices by (I + λL) x = u with the combinatorial Laplacian L
(Nicolet, Jacobson and Jakob, *Large Steps in Inverse Rendering of Geometry*, 2021): a step on u is a smooth step on the
surface. The offsets are squashed into the room that each vertex has along and across its normal, so that the cap holds
at every iteration and not only in the end.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from genmf_mi.geometry.back_off import untangle
from genmf_mi.geometry.parameterization import Crossings, Geometry, RefinedSurface

if TYPE_CHECKING:
    from torch import Tensor


class MeshParameterization:
    """Offsets from a fixed surface, a :class:`genmf_mi.geometry.parameterization.Parameterization`.

    base: ``[V,3]`` initial vertices, normalised frame. normals: ``[V,3]`` unit. faces: ``[F,3]``.
    inward, outward: ``[V]`` room along the normal, normalised units, not negative; a vertex with neither is pinned.
    sideways: ``[V]`` room across the normal.
    smoothing: λ.
    broad: takes the broad part out of the heights. Shading sees slopes, so that it carries nothing, and the gradient,
        which does not see outlines move, would thin limbs with it.
    """

    blocks = (slice(None),)

    def __init__(
        self,
        base: np.ndarray,
        normals: np.ndarray,
        faces: np.ndarray,
        inward: np.ndarray,
        outward: np.ndarray,
        sideways: np.ndarray,
        *,
        smoothing: float,
        broad: ImplicitDiffusion | None = None,
        device: str = "cpu",
    ) -> None:
        import torch

        def tensor(x: np.ndarray) -> Tensor:
            return torch.as_tensor(np.ascontiguousarray(x), dtype=torch.float32, device=device)

        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        self.base, self.normals = tensor(base), tensor(normals)
        self.initial, self.exact = self.base, (np.asarray(base, np.float64), np.asarray(normals, np.float64))
        self.inward, self.outward, self.sideways = (
            tensor(x)[:, None].clamp_min(1e-9) for x in (inward, outward, sideways)
        )
        self.solve, self.broad = ImplicitDiffusion(faces, len(base), smoothing, device), broad
        self.latent = torch.zeros(len(base), 3, device=device, requires_grad=True)

    def offsets(self) -> Tensor:
        """``[V,3]``, no longer than the cap: inside the cylinder of each vertex's room, normalised units."""
        import torch

        x = self.solve(self.latent)
        height = (x * self.normals).sum(dim=1, keepdim=True)
        across = x - height * self.normals
        if self.broad is not None:
            height = height - self.broad(height)
        room = torch.where(height > 0, self.outward, self.inward)
        reach = (across.square().sum(dim=1, keepdim=True) / self.sideways.square() + 1e-12).sqrt()
        return room * torch.tanh(height / room) * self.normals + across * (torch.tanh(reach) / reach)

    def rates(self, progress: float) -> tuple[float, ...]:
        """The whole learning rate, always."""
        return (1.0,)

    def vertices(self) -> Tensor:
        """``[V,3]`` in the normalised frame."""
        return self.base + self.offsets()

    def moved(self) -> Geometry:
        """The vertices; the faces stay."""
        vertices = self.vertices()
        return Geometry(vertices, None, vertices, {})

    def distance(self, samples: int) -> Callable[[Tensor], Tensor]:
        """See :class:`genmf_mi.geometry.mesh_distance.MeshDistance`."""
        from genmf_mi.geometry.mesh_distance import MeshDistance

        return MeshDistance(self.faces, samples, every=1)

    def reached(self) -> np.ndarray:
        """:meth:`offsets` as an array."""
        return self.offsets().detach().cpu().numpy().astype(np.float64)

    def displaced(self, heights: np.ndarray) -> np.ndarray:
        """Offsets ``[V,3]`` along the normals."""
        return heights[:, None] * self.exact[1]

    def surface(self, reached: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices ``[V,3]`` and faces ``[F,3]``."""
        return self.exact[0] + reached, self.faces

    def finished(self, reached: np.ndarray, crossings: Crossings) -> RefinedSurface:
        """See :func:`genmf_mi.geometry.back_off.untangle`."""
        base, normals = self.exact
        offsets, report = untangle(base, self.faces, reached, crossings)
        return RefinedSurface(base + offsets, self.faces, base, normals, report)

    def start_from(self, heights: np.ndarray) -> None:
        """Make :meth:`offsets` ``heights [V]`` along the normals, up to 0.98 of the room."""
        import torch

        with torch.no_grad():
            wanted = torch.as_tensor(heights, dtype=torch.float32, device=self.base.device)[:, None]
            room = torch.where(wanted > 0, self.outward, self.inward)
            x = room * torch.atanh((wanted / room).clamp(-0.98, 0.98))
            self.latent.copy_(self.solve.inverse(x * self.normals))


class ImplicitDiffusion:
    """x = (I + λL)⁻¹ u, differentiable, factorised once by cholespy, on the CPU or the GPU."""

    def __init__(self, faces: np.ndarray, count: int, smoothing: float, device: str = "cpu") -> None:
        import torch
        from cholespy import CholeskySolverF, MatrixType

        matrix = laplacian(faces, count) * smoothing
        matrix.setdiag(matrix.diagonal() + 1)
        matrix = matrix.tocoo()
        rows, columns = (torch.as_tensor(x, dtype=torch.int32, device=device) for x in (matrix.row, matrix.col))
        values = torch.as_tensor(matrix.data, dtype=torch.float64, device=device)
        self.solver = CholeskySolverF(count, rows, columns, values, MatrixType.COO)
        self.matrix = torch.sparse_coo_tensor(
            torch.stack([rows, columns]).long(), values.float(), (count, count), check_invariants=False
        ).coalesce()

    def __call__(self, u: Tensor) -> Tensor:
        """``[V,k]`` to ``[V,k]``."""
        return _solve()(u, self.solver)

    def inverse(self, x: Tensor) -> Tensor:
        """u = (I + λL) x."""
        return self.matrix @ x


def laplacian(faces: np.ndarray, count: int):
    """The combinatorial Laplacian (valence minus adjacency) as a SciPy CSR matrix ``[count,count]``.

    faces: ``[F,3]``, or the edges ``[E,2]`` of any other graph.
    """
    from scipy.sparse import coo_matrix, diags

    i, j = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    adjacency = coo_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(count, count)).tocsr()
    adjacency.data[:] = 1
    return diags(np.asarray(adjacency.sum(axis=1)).ravel()).tocsr() - adjacency


def _solve():
    """The autograd function, made on first use so that this module can be imported without torch."""
    import torch

    global _SOLVE
    if _SOLVE is None:

        def solved(solver, u: Tensor) -> Tensor:
            u = u.contiguous()
            x = torch.empty_like(u)
            solver.solve(u, x)
            return x

        class Solve(torch.autograd.Function):
            @staticmethod
            def forward(ctx, u, solver):
                ctx.solver = solver
                return solved(solver, u.detach())

            @staticmethod
            def backward(ctx, gradient):
                return solved(ctx.solver, gradient), None  # the matrix is symmetric: its adjoint is the same solve

        _SOLVE = Solve.apply
    return _SOLVE


_SOLVE = None


class UniformAdam:
    """Adam whose step is scaled by one number for the whole surface (Nicolet et al. 2021), made robust.

    The scale is the 99th percentile of the root second moments instead of their maximum, and single gradients are
    clipped at ten times that: a vertex on a silhouette, whose gradient is a spike, must neither jump nor slow down
    all others.

    blocks: parts of the first axis that have a scale each. scale: that of the first one at the last step.
    floor: added to it. Gradients well below the floor move the surface in proportion;
        without it, round-off would be blown up to full steps.
    """

    def __init__(
        self,
        parameter: Tensor,
        rate: float,
        *,
        beta1: float = 0.9,
        beta2: float = 0.99,
        floor: float = 0.0,
        blocks: tuple[slice, ...] = (slice(None),),
    ) -> None:
        import torch

        self.parameter, self.rate, self.beta1, self.beta2, self.floor = parameter, rate, beta1, beta2, floor
        self.first, self.second = torch.zeros_like(parameter), torch.zeros_like(parameter)
        self.steps, self.scale, self.blocks = 0, 0.0, blocks

    def step(self, rate: float | None = None, shares: tuple[float, ...] | None = None) -> None:
        """Move the parameter along its gradient and clear the gradient; ``rate`` overrides the learning rate once, and
        each block takes its share of it, all of it if None."""
        import torch

        rate = self.rate if rate is None else rate

        with torch.no_grad():
            gradient = torch.nan_to_num(self.parameter.grad, nan=0.0, posinf=0.0, neginf=0.0)
            self.parameter.grad = None
            self.steps += 1
            scales = []
            for block, share in zip(self.blocks, shares or (1.0,) * len(self.blocks), strict=True):
                along, first, second = gradient[block], self.first[block], self.second[block]
                limit = 10 * percentile(along.abs(), 0.99)
                along.clamp_(-limit, limit)
                first.mul_(self.beta1).add_(along, alpha=1 - self.beta1)
                second.mul_(self.beta2).addcmul_(along, along, value=1 - self.beta2)
                scale = (percentile(second, 0.99) / (1 - self.beta2**self.steps)).sqrt()
                step = first / (1 - self.beta1**self.steps) / (scale + self.floor + 1e-20)
                self.parameter[block].sub_(step, alpha=rate * share)
                scales.append(float(scale))
            self.scale = scales[0]


def percentile(x: Tensor, share: float) -> Tensor:
    """The value that ``share`` of the entries of ``x`` do not exceed, a scalar."""
    flat = x.flatten()
    return flat.kthvalue(max(1, int(share * flat.numel()))).values
