"""From an asset to everything the refinement works on: the fine solid, its room, its reference, its scene."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from genmf_mi.assets.asset import Asset
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.colour import to_srgb, value
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import AssetError, SolidError
from genmf_mi.core.frame import Frame
from genmf_mi.geometry.displacement_bounds import room
from genmf_mi.geometry.low_pass import low_frequency, low_pass
from genmf_mi.mesh import solid, topology
from genmf_mi.mesh.manifold import is_solid
from genmf_mi.render import bridge, target
from genmf_mi.render import scene as scenes
from genmf_mi.render.scene import Scene
from genmf_mi.render.target import Reference
from genmf_mi.sdf.grid import without_specks

if TYPE_CHECKING:
    from genmf_mi.geometry.parameterization import Parameterization

BROAD_MM = 8.0
"""What is broader than this on the printed part is shape or tone, not detail."""
FULL_CONTRAST = 0.11
"""Local contrast of the encoded brightness from which on the whole cap may be used."""


@dataclass(frozen=True)
class RefinementProblem:
    """The initial part and what it is compared with; all geometry in the normalised frame.

    vertices, normals ``[V,3]`` float64; faces ``[F,3]``; rgb ``[V,3]`` linear; inward, outward, sideways ``[V]``: the
    room of each vertex.
    asset: of an :class:`SdfAsset` without specks, whose extracted surface is the initial part.
    part, reference: at the resolution of the optimisation; judged_part, judged_reference: at that of the evaluation.
    contrast: :func:`local_contrast` of the brightness, and cap_mm: the cap that it earns. report: of the solid;
    seconds: per step.
    """

    asset: Asset | SdfAsset
    frame: Frame
    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    rgb: np.ndarray
    inward: np.ndarray
    outward: np.ndarray
    sideways: np.ndarray
    part: Scene
    reference: Reference
    judged_part: Scene
    judged_reference: Reference
    report: dict
    seconds: dict
    contrast: float
    cap_mm: float

    @property
    def brightness(self) -> np.ndarray:
        """HSV value of the albedo per vertex ``[V]``, encoded for a screen."""
        return to_srgb(value(self.rgb))

    def movable(self, config: RefineConfig, device: str) -> Parameterization:
        """What the refinement moves: the vertices of the part, or the field that it is extracted from."""
        from genmf_mi.geometry.mesh import MeshParameterization
        from genmf_mi.geometry.sdf import SdfParameterization

        surface, length = (self.vertices, self.faces), BROAD_MM / self.frame.mm_per_unit
        if isinstance(self.asset, SdfAsset):
            # As wide in mm as on a mesh, where a vertex has six neighbours around it instead of four
            cell_mm = 2 / self.asset.resolution * self.asset.half * self.frame.scale * self.frame.mm_per_unit
            smoothing = 1.5 * (config.mesh_edge_mm / cell_mm) ** 2 * config.smoothing
            return SdfParameterization(self.asset, self.frame, *surface, self.normals, self.inward, self.outward,
                               smoothing=smoothing, broad=length, device=device)  # fmt: skip
        broad = low_pass(*surface, length, device)
        return MeshParameterization(self.vertices, self.normals, self.faces, self.inward, self.outward, self.sideways,
                      smoothing=config.smoothing, broad=broad, device=device)  # fmt: skip


def prepare(
    asset: Asset | SdfAsset,
    config: RefineConfig,
    xml: Path,
    folder: Path,
    *,
    references: tuple = (),
    say: Callable[[str], None] = lambda text: None,
) -> RefinementProblem:
    """Make the initial part and build the scenes; PLY files for Mitsuba go to ``folder``.

    A mesh becomes a solid, finely meshed; of a field, the surface is taken as it is.

    Raises:
        AssetError: no texture and no reference images.
        SolidError: the asset cannot be made solid.
        SceneError: the scene file cannot be used.
    """
    from genmf_mi.pipeline.evaluation import RESOLUTION, SAMPLES

    if not asset.textured and not references:
        raise AssetError(
            f"{asset.name} has no texture and no colours, so there is nothing for the relief to show. "
            "Give pictures of it with --reference image.png@azimuth,elevation."
        )
    pictures = tuple(target.read_picture(text) for text in references)
    # A scene file that cannot be used is refused now, not after minutes of meshing
    bridge.write_ply(folder / "trial.ply", np.eye(3), np.array([[0, 1, 2]]))
    scenes.load(xml, folder / "trial.ply", radius=1.0)
    seconds, started = {}, time.perf_counter()

    def lap(name: str) -> None:
        nonlocal started
        seconds[name], started = time.perf_counter() - started, time.perf_counter()

    if isinstance(asset, SdfAsset):
        say("extracting the surface")
        asset, body = extracted(asset)
        lap("extract")
    else:
        say("making it solid")
        body = solid.solidify(asset.name, asset.vertices, asset.faces)
        lap("solid")

        say("meshing")
        frame = Frame.of(body.vertices, config.size_mm)
        body = solid.remesh(body, config.mesh_edge_mm / frame.mm_per_unit / frame.scale, config.max_faces)
        lap("remesh")
    frame = Frame.of(body.vertices, config.size_mm)
    vertices, faces = frame.normalise(body.vertices), body.faces

    say("building scenes")
    radius = float(np.linalg.norm(vertices, axis=1).max())

    def albedo(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        return asset.closest_albedo(frame.restore(points), normals)

    ply = folder / "part.ply"
    normals = bridge.write_ply(ply, vertices, faces)
    part = scenes.load(
        xml, ply, radius=radius, resolution=config.resolution, samples=config.samples, silhouettes=config.silhouettes
    )
    reference = target.make(
        xml,
        folder,
        vertices,
        faces,
        normals,
        albedo,
        radius=radius,
        resolution=config.resolution,
        samples=config.samples,
        pictures=pictures,
    )
    judged_part = scenes.load(xml, ply, radius=radius, resolution=RESOLUTION, samples=SAMPLES)
    judged_reference = target.load(
        xml, folder, radius=radius, resolution=RESOLUTION, samples=SAMPLES, pictures=pictures
    )

    per_mm = 1 / frame.mm_per_unit
    rgb = albedo(vertices, normals)
    contrast = local_contrast(vertices, faces, to_srgb(value(rgb)), BROAD_MM * per_mm)
    cap = config.max_relief_mm * (1.0 if references else min(1.0, contrast / FULL_CONTRAST))
    inward, outward, sideways = room(
        vertices,
        faces,
        normals,
        cap * per_mm,
        2 * config.nozzle_mm * per_mm,
        lambda points, directions: bridge.free_ray_distance(part.scene, points, directions),
    )
    lap("scenes")
    return RefinementProblem(
        asset=asset,
        frame=frame,
        vertices=vertices,
        faces=faces,
        normals=normals,
        rgb=rgb,
        inward=inward,
        outward=outward,
        sideways=sideways,
        part=part,
        reference=reference,
        judged_part=judged_part,
        judged_reference=judged_reference,
        report=body.report,
        contrast=contrast,
        cap_mm=cap,
        seconds=seconds,
    )


def extracted(asset: SdfAsset) -> tuple[SdfAsset, solid.Solid]:
    """The field without specks and cavities, and its surface.

    Raises:
        SolidError: the surface is no closed manifold.
    """
    phi, dropped = without_specks(asset.phi)
    asset = replace(asset, phi=phi)
    vertices, faces = asset.surface(training=True)
    if not is_solid(vertices, faces):
        raise SolidError(f"the surface of {asset.name} is no solid. Generate it again, or refine its mesh instead.")
    report = {
        "samples_per_axis": len(phi),
        "faces": len(faces),
        "bodies": int(topology.bodies(faces).max() + 1),
        "specks_dropped": dropped,
        "volume": topology.volume(vertices, faces),
    }
    return asset, solid.Solid(vertices, faces, asset.report | report)


def local_contrast(vertices: np.ndarray, faces: np.ndarray, brightness: np.ndarray, length: float) -> float:
    """How much detail there is: the 99th percentile of | brightness − its broad part |, in encoded grey values.

    A soft blush or the speckle of a lemon has 0.05, painted porcelain 0.12, spots and windows 0.3 to 0.5. Relief in
    proportion keeps what is faint in colour faint in shape: mean–variance alignment alone would blow it up.
    """
    return float(np.percentile(np.abs(brightness - low_frequency(vertices, faces, brightness, length)), 99))
