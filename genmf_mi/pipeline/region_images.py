"""The regions of a part as its views show them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from genmf_mi.losses.emphasis import Emphasis
from genmf_mi.pipeline.regions import RegionField
from genmf_mi.render import bridge
from genmf_mi.render.scene import Scene
from genmf_mi.render.target import subdivided
from genmf_mi.render.view import View


class RegionImages:
    """Images of a :class:`RegionField`, on the surface that the reference is rendered from.

    Args:
        scene: of the reference. faces: ``[F,3]`` of the initial surface. field: at its vertices.

    Attributes:
        shares: of each view of the scene, how much what it shows counts: the mean over what it sees of the weights, 0
            where nothing but flat areas is seen.
    """

    def __init__(self, scene: Scene, faces: np.ndarray, field: RegionField) -> None:
        self._scene = scene
        self._faces, self._mask, self._strength, self._weight = subdivided(
            faces, field.mask, field.strength, field.weight
        )
        self.shares = np.nanmean(self._images(scene.views, self._mask * self._weight), axis=(1, 2))

    def emphasis(self, views: Sequence[View], device: torch.device | str = "cpu") -> Emphasis:
        """What counts in each view, at the resolution of the scene; 1 beside the object."""
        wanted, weight = (
            torch.as_tensor(np.nan_to_num(self._images(views, values), nan=1.0)[:, None]).to(device, torch.float32)
            for values in (self._mask, self._weight)
        )
        return Emphasis(wanted, weight)

    def maps(self, views: Sequence[View]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mask, strength and weight ``[B,H,W]``, NaN beside the object."""
        mask, strength, weight = (self._images(views, each) for each in (self._mask, self._strength, self._weight))
        return mask, strength, weight

    def _images(self, views: Sequence[View], values: np.ndarray) -> np.ndarray:
        return bridge.render_vertex_values(self._scene, views, self._faces, values)
