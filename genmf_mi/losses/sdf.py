"""Regularisers of a field and of the surface extracted from it (GenMF, L_sdf-tv and L_reg)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


def sdf_tv(phi: Tensor, samples: Tensor, cell: float) -> Tensor:
    """L_sdf-tv = Σ E|∇Φ| over the three axes, by forward differences.

    phi: ``[m,m,m]``. samples: ``[N]``, indices into the flattened grid, none of them on its last layers; only these
    are looked at. cell: distance of neighbouring samples, in the unit of ``phi``. About 1.5 for a distance, whichever
    way it falls.
    """
    m, flat = phi.shape[0], phi.reshape(-1)
    here = flat[samples]
    return sum((flat[samples + step] - here).abs().mean() for step in (m * m, m, 1)) / cell


def l_dev(distance: Tensor, cell: float) -> Tensor:
    """L_dev, the first term of L_reg: how unequally far the dual vertices are from the crossings around them, in cells.

    distance: ``[D]``, :attr:`genmf_mi.sdf.flexicubes.Surface.deviation`, in the unit of ``cell``.
    """
    return distance.mean() / cell


def flexi_weight_reg(weights: Tensor) -> Tensor:
    """The second term of L_reg: the mean square of FlexiCubes' unbounded weights, as InstantMesh has it.

    weights: ``[S,21]``, :attr:`genmf_mi.sdf.flexicubes.Surface.weights`.
    """
    return weights.square().mean()
