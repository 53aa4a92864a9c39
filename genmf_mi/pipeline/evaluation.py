"""How close the one-colour part comes to the textured object, in numbers.

Protocol: six standard views at 384² with 16 samples per pixel, both images encoded for a screen (sRGB). The render is
aligned to the reference in mean and variance inside the mask (one exposure, one contrast per view), clipped to 0..1,
background 0 in both. SSIM and LPIPS are taken over the full frame, and once more inside the mask. The g-metrics
compare the gradient magnitudes. "Unseen" means six views between the standard ones, three under each of two turned
lightings that no iteration uses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from genmf_mi.losses.appearance import align_srgb, gradient_magnitude
from genmf_mi.losses.perceptual import features, lpips
from genmf_mi.render import bridge
from genmf_mi.render.scene import Scene, View
from genmf_mi.render.target import Reference

if TYPE_CHECKING:
    from torch import Tensor

RESOLUTION, SAMPLES, SEED = 384, 16, 999
UNSEEN_TURNS = ((20.0, 0.0), (-15.0, -15.0))
"""Turns of the lights in the unseen set, in degrees."""


def unseen(views: tuple[View, ...]) -> tuple[View, ...]:
    """Half-way between the standard views in azimuth, at other elevations, under the two unseen lightings."""
    around = sorted(views, key=lambda v: v.azimuth % 360)
    between = []
    for i, (a, b) in enumerate(zip(around, [*around[1:], around[0]], strict=True)):
        azimuth = a.azimuth + (360 if a is b else (b.azimuth - a.azimuth) % 360) / 2
        between.append(View(azimuth % 360, (5.0, 35.0)[i % 2], UNSEEN_TURNS[2 * i // len(around)]))
    return tuple(between)


@dataclass
class Evaluator:
    """Scores parts against one reference from one set of views.

    networks: which LPIPS networks to report.
    """

    reference: Reference
    scene: Scene
    views: tuple[View, ...]
    networks: tuple[str, ...] = ("alex", "vgg")

    def __post_init__(self) -> None:
        import torch

        with torch.no_grad():
            seen = self.reference.look(self.views, seed=SEED, samples=SAMPLES)
            self.seen, self.mask = seen.grey, seen.coverage
            self.target = align_srgb(seen.grey, seen.coverage, seen.grey, seen.coverage)[1].clamp(0, 1)
            self.target_gradient = gradient_magnitude(self.target)

    def render(self, vertices: Tensor, faces: Tensor | None = None) -> Tensor:
        """``[B,1,H,W]`` the part as it is compared: encoded, aligned, clipped, 0 outside of the mask.

        faces: as for :func:`bridge.render`."""
        import torch

        with torch.no_grad():
            part = self.look(vertices, faces)
            return align_srgb(part.grey, part.coverage, self.seen, self.mask)[0].clamp(0, 1)

    def look(self, vertices: Tensor, faces: Tensor | None = None) -> bridge.Buffers:
        """The part as it is lit, before any alignment."""
        import torch

        with torch.no_grad():
            return bridge.render(self.scene, self.views, vertices, faces, seed=SEED, samples=SAMPLES)

    def score(self, image: Tensor, networks: tuple[str, ...] | None = None) -> dict[str, float | None]:
        """:meth:`scores` of a single part."""
        return self.scores({"part": image}, networks)["part"]

    def scores(
        self, images: dict[str, Tensor], networks: tuple[str, ...] | None = None
    ) -> dict[str, dict[str, float | None]]:
        """Means over the views, of images as :meth:`render` returns them, by the names of the parts.

        Keys: ``ssim``, ``g_ssim``, ``ssim_mask``, ``g_ssim_mask``, for each network ``lpips_*`` and ``lpips_mask_*``,
        and ``g_lpips`` (AlexNet). None stands for a network that was not asked for.
        """
        import torch

        with torch.no_grad():
            gradients = {name: gradient_magnitude(image) for name, image in images.items()}
            table: dict[str, dict[str, float | None]] = {name: {} for name in images}
            for name, row in table.items():
                row["ssim"], row["ssim_mask"] = ssim(images[name], self.target, self.mask)
                row["g_ssim"], row["g_ssim_mask"] = ssim(gradients[name], self.target_gradient, self.mask)
                row |= dict.fromkeys(("lpips_alex", "lpips_vgg", "lpips_mask_alex", "lpips_mask_vgg"))
            for n in networks or self.networks:
                for name, (frame, inside) in self.lpips(images, n).items():
                    table[name][f"lpips_{n}"], table[name][f"lpips_mask_{n}"] = frame, inside
            for name, (frame, _) in self.lpips(gradients, "alex", self.target_gradient).items():
                table[name]["g_lpips"] = frame
        return table

    def lpips(
        self, images: dict[str, Tensor], network: str, target: Tensor | None = None
    ) -> dict[str, tuple[float, float]]:
        """LPIPS over the frame and inside the mask, means over the views, against ``target [B,1,H,W]`` (the reference).
        One view at a time: the features of VGG16 take 70 MB each."""
        target = self.target if target is None else target
        sums = {name: np.zeros(2) for name in images}
        for i in range(len(target)):
            theirs, mask = features(target[i : i + 1], network), self.mask[i : i + 1]
            for name, image in images.items():
                ours = features(image[i : i + 1], network)
                sums[name] += [float(lpips(ours, theirs)), float(lpips(ours, theirs, mask=mask))]
        return {name: tuple(map(float, total / len(target))) for name, total in sums.items()}


def ssim(image: Tensor, reference: Tensor, mask: Tensor) -> tuple[float, float]:
    """SSIM (Wang et al. 2004, scikit-image's 7 × 7 window, data range 1) over the frame and over the mask, means over
    views."""
    from skimage.metrics import structural_similarity

    frame, inside = [], []
    for a, b, m in zip(image[:, 0].cpu().numpy(), reference[:, 0].cpu().numpy(), mask[:, 0].cpu().numpy(), strict=True):
        mean, local = structural_similarity(a, b, data_range=1.0, full=True)
        frame.append(mean)
        inside.append((local * m).sum() / max(m.sum(), 1e-6))
    return float(np.mean(frame)), float(np.mean(inside))


def evaluate(
    original, refined, *, size_mm: float = 100.0, scene=None, networks: tuple[str, ...] = ("alex", "vgg")
) -> dict:
    """Score a one-colour shape against a textured asset: ``genmf-mi evaluate ORIGINAL REFINED``.

    original, refined: files, bundled samples or loaded assets in the same pose; each is fitted into the frame by its
    own bounding box, z-up print files are turned upright by their format.

    Returns ``before`` and ``after`` (the scores of :meth:`Evaluator.score`), and the same under ``unseen``.

    Raises:
        GenmfError: as :func:`genmf_mi.refine`.
    """
    import tempfile
    from pathlib import Path

    import torch

    from genmf_mi.assets import samples
    from genmf_mi.assets.asset import Asset, load
    from genmf_mi.core.config import RefineConfig
    from genmf_mi.core.frame import Frame
    from genmf_mi.losses import lpips_weights as weights
    from genmf_mi.mesh import topology
    from genmf_mi.pipeline.problem import prepare
    from genmf_mi.render import scene as scenes
    from genmf_mi.render import variant

    variant.use("auto")
    weights.require(*networks)
    original, refined = (a if isinstance(a, Asset) else load(samples.resolve(a)) for a in (original, refined))
    xml = Path(scene) if scene else scenes.find(original.name)
    with tempfile.TemporaryDirectory(prefix="genmf-") as folder:
        piece = prepare(original, RefineConfig(size_mm=size_mm), xml, Path(folder))
        # STL and textured files split their vertices, which would show every facet
        longest = np.ptp(refined.vertices, axis=0).max()
        vertices, faces = topology.weld(refined.vertices, refined.faces, 1e-6 * longest)
        vertices = Frame.of(vertices, size_mm).normalise(vertices)
        mesh = Path(folder) / "refined.ply"
        bridge.write_ply(mesh, vertices, faces)
        radius = float(np.linalg.norm(piece.vertices, axis=1).max())
        after = scenes.load(xml, mesh, radius=radius, resolution=RESOLUTION, samples=SAMPLES)
        metrics: dict = {"asset": original.name, "unseen": {}}
        for block, views in ((metrics, piece.reference.views), (metrics["unseen"], unseen(piece.reference.views))):
            judge = Evaluator(piece.judged_reference, piece.judged_part, views, networks)
            images = {}
            for name, shown, points in (("before", piece.judged_part, piece.vertices), ("after", after, vertices)):
                judge.scene = shown
                points = torch.as_tensor(points, dtype=torch.float32, device=judge.target.device)
                images[name] = judge.render(points)
            block |= judge.scores(images)
    return metrics
