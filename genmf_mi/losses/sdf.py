"""Regularisation of a field and of the surface extracted from it (GenMF, L_sdf-tv and L_reg)."""

from __future__ import annotations

from jaxtyping import Float, Int
from torch import Tensor

from genmf_mi.losses.shapes import Scalar


def sdf_tv(phi: Float[Tensor, "m m m"], samples: Int[Tensor, " N"], cell: float) -> Scalar:
    """L_sdf-tv = Σ E|∇Φ| over the three axes, by forward differences.

    phi: ``[m,m,m]``. samples: ``[N]``, indices into the flattened grid, none of them on its last layers; only these
    count. cell: distance of neighbouring samples, in the unit of ``phi``. About 1.5 for a distance, in whichever
    direction it falls.
    """
    m, flat = phi.shape[0], phi.reshape(-1)
    values = flat[samples]
    first, second, third = ((flat[samples + step] - values).abs().mean() for step in (m * m, m, 1))
    return (first + second + third) / cell


def l_dev(distance: Float[Tensor, " D"], cell: float) -> Scalar:
    """L_dev, the first term of L_reg: how unequally far the dual vertices are from the crossings around them, in cells.

    distance: ``[D]``, :attr:`genmf_mi.sdf.flexicubes.Surface.deviation`, in the unit of ``cell``.
    """
    return distance.mean() / cell


def flexi_weight_reg(weights: Float[Tensor, "S 21"]) -> Scalar:
    """The second term of L_reg: the mean square of FlexiCubes' unbounded weights, as InstantMesh has it.

    weights: ``[S,21]``, :attr:`genmf_mi.sdf.flexicubes.Surface.weights`.
    """
    return weights.square().mean()
