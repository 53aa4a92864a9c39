"""From an asset to what a refinement works on: the initial surface, its bounds, its scenes and its references."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from genmf_mi.assets.asset import Asset
from genmf_mi.assets.maps import Look
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import AssetError, ConfigError, SolidError
from genmf_mi.core.frame import Frame, Up
from genmf_mi.core.printer import PRINTERS
from genmf_mi.core.progress import Progress
from genmf_mi.core.timer import Timer
from genmf_mi.geometry.displacement_bounds import DisplacementBounds, base, displacement_bounds
from genmf_mi.geometry.low_pass import LowPass
from genmf_mi.geometry.mesh import MeshParameterization
from genmf_mi.geometry.parameterization import Parameterization
from genmf_mi.geometry.plain_areas import relief_cap
from genmf_mi.geometry.sdf import SdfParameterization
from genmf_mi.mesh import solid, topology
from genmf_mi.mesh.manifold import is_solid
from genmf_mi.mesh.measures import signed_volume, vertex_normals
from genmf_mi.mesh.remesh import shortest_edge
from genmf_mi.pipeline import evaluator
from genmf_mi.pipeline.detail import DETAIL_MM, FULL_CONTRAST, SOFT, crispness, local_contrast, local_range
from genmf_mi.pipeline.poses import Pose, named, pose
from genmf_mi.pipeline.region_images import RegionImages
from genmf_mi.pipeline.regions import AssetRegions, RegionField
from genmf_mi.pipeline.surface import InitialSurface, initial_surface
from genmf_mi.render import bridge, target
from genmf_mi.render import scene as scenes
from genmf_mi.render.scene import RenderSettings, Scene
from genmf_mi.render.target import Picture, Reference
from genmf_mi.sdf.grid import without_small_components

COARSE_SHARE, COARSEST_MM = 0.35, 1.3
"""Of the face budget, for the triangles that are everywhere where the texture has crisp edges; and how long their edges
may be: with longer ones too much is lost beside the crispest places."""
ONE_BRIGHTNESS = 0.01
"""Range of the encoded albedo below which the object has one brightness."""
FIELD_SMOOTHING = 11.0
"""λ of a field over that of a mesh whose edges are as long as a cell; a field has four neighbours instead of six, and
the surface out of it bears no finer relief than its cells."""


@dataclass(frozen=True)
class ScenePair:
    """The part in one colour, and the textured object that it is compared with, at one resolution."""

    part: Scene
    reference: Reference

    def resize(self, resolution: int) -> None:
        """Render both at ``resolution`` pixels per side from now on, the object shaded as the part is."""
        self.part.resize(resolution)
        self.reference.scene.shade_as(self.part)


@dataclass(frozen=True)
class RefinementProblem:
    """The initial part and what it is compared with.

    asset: as it was given, with the maps that are wanted; an :class:`SdfAsset` without small components.
    bounds: of the displacement of each vertex, normalised units; plain areas are held.
    loose_bounds: the same without regard to what is plain, for the displacement by brightness.
    training, evaluation: scenes at the resolutions of the optimisation and of the scores; they share the reference,
        which is resized for either.
    low_pass: of :data:`DETAIL_MM` on the surface, on the CPU. detail: ``[V]``, by how much what is seen differs from
        its low-frequency component.
    contrast: :func:`local_contrast` of that where there may be relief; cap_mm: the cap that it permits.
    report: what was done to make the part solid. pose: how it stands on the bed.
    regions: what is asked for at each vertex, and images of that; None where nothing is.
    """

    asset: Asset | SdfAsset
    frame: Frame
    surface: InitialSurface
    bounds: DisplacementBounds
    loose_bounds: DisplacementBounds
    training: ScenePair
    evaluation: ScenePair
    low_pass: LowPass
    detail: np.ndarray
    contrast: float
    cap_mm: float
    report: dict[str, Any]
    pose: Pose
    regions: RegionField | None = None
    region_images: RegionImages | None = None

    @property
    def relief(self) -> np.ndarray:
        """``bool [V]``: where the surface may move at all."""
        return np.ones(len(self.surface.vertices), bool) if self.regions is None else self.regions.relief


def build_problem(
    asset: Asset | SdfAsset,
    config: RefineConfig,
    xml: Path,
    folder: Path,
    *,
    references: tuple[str, ...] = (),
    regions: AssetRegions | None = None,
    progress: Progress | None = None,
    timer: Timer | None = None,
) -> RefinementProblem:
    """Make the initial part and build the scenes.

    A mesh becomes a solid, finely meshed; of a signed distance, the extracted surface is taken as it is.

    Args:
        xml: scene file. folder: for the PLY files that Mitsuba reads.
        references: pictures to match instead of the texture, ``image.png@azimuth,elevation``.
        regions: where there shall be more or less relief, see :func:`genmf_mi.pipeline.regions.of_asset`.

    Raises:
        AssetError: no texture and no reference pictures.
        ConfigError: all of the surface shall be flat.
        SolidError: the asset cannot be made solid.
        SceneError: the scene file cannot be used.
    """
    progress, timer = progress or Progress(), timer or Timer()
    given = asset
    asset = asset.with_maps(normal=config.normal_map, occlusion=config.occlusion_map, emission=config.emissive_map)
    if not asset.textured and not references:
        switches = " but in maps that are left out (--normal-map, --occlusion-map, --emissive-map)" * given.textured
        raise AssetError(
            f"{asset.name} has no texture and no colours{switches}, so there is nothing for the relief to show. "
            "Give pictures of it with --reference image.png@azimuth,elevation."
        )
    for note in asset.notes:
        progress.warn(f"of {asset.name}, {note}")
    pictures = tuple(target.read_picture(text) for text in references)
    _require_usable(xml, folder)
    if isinstance(asset, SdfAsset):
        progress.stage("extracting the surface")
        asset, body = extract(asset)
        timer.lap("extract")
    else:
        progress.stage("making it solid")
        body = solid.solidify(asset.name, asset.vertices, asset.matter)
        timer.lap("solid")
        progress.stage("meshing")
        body = mesh_finely(asset, body, config, regions)
        timer.lap("remesh")

    progress.stage("building scenes")
    frame = Frame.of(body.vertices, config.size_mm)
    posed = pose(config.stand, frame.normalise(body.vertices), body.faces)
    frame = frame.standing(posed.up)
    surface, training, evaluation = build_scenes(asset, body, frame, config, xml, folder, pictures)
    field = None if regions is None else regions.on(body.vertices, surface.faces, surface.normals, frame)
    if field is not None and not field.relief.any():
        raise ConfigError("all of the surface is to stay flat, so there is no relief to make. Leave some of it free.")
    low_pass = LowPass(surface.vertices, surface.faces, DETAIL_MM / frame.mm_per_unit)
    detail = surface.contrast(low_pass)
    contrast = local_contrast(detail if field is None else detail[field.relief])
    cap_mm = config.max_relief_mm * (1.0 if references else min(1.0, contrast / FULL_CONTRAST))
    bounds, loose = bounds_of(surface, frame, training, cap_mm, config.nozzle_mm, field)
    images = None if field is None else RegionImages(training.reference.scene, surface.faces, field)
    timer.lap("scenes")
    return RefinementProblem(
        asset, frame, surface, bounds, loose, training, evaluation, low_pass, detail, contrast, cap_mm, body.report,
        posed, field, images,
    )  # fmt: skip


def bounds_of(
    surface: InitialSurface,
    frame: Frame,
    training: ScenePair,
    cap_mm: float,
    nozzle_mm: float,
    regions: RegionField | None = None,
) -> tuple[DisplacementBounds, DisplacementBounds]:
    """``bounds`` and ``loose_bounds`` of a :class:`RefinementProblem`."""
    share = np.ones(len(surface.vertices)) if regions is None else regions.cap
    loose = displacement_bounds(
        surface.vertices,
        surface.faces,
        surface.normals,
        share * (cap_mm / frame.mm_per_unit),
        2 * nozzle_mm / frame.mm_per_unit,
        lambda points, directions: bridge.free_ray_distance(training.part.scene, points, directions),
        frame.up,
    )
    if training.reference.pictures:
        return loose, loose
    points = surface.vertices * frame.mm_per_unit
    return loose.capped(share * relief_cap(points, surface.signals, cap_mm) / frame.mm_per_unit), loose


def standing(problem: RefinementProblem, up: Up, config: RefineConfig) -> RefinementProblem:
    """The problem of the same part, printed with ``up`` away from the bed."""
    if up == problem.frame.up:
        return problem
    frame = problem.frame.standing(up)
    problem.evaluation.part.stand(up)
    bounds, loose = bounds_of(
        problem.surface, frame, problem.training, problem.cap_mm, config.nozzle_mm, problem.regions
    )
    unsteady = len(base(problem.surface.vertices, problem.surface.faces, up)) == 0
    posed = replace(problem.pose, name=named(np.array(up))[0], up=up, unsteady=unsteady)
    return replace(problem, frame=frame, bounds=bounds, loose_bounds=loose, pose=posed)


def mesh_finely(
    asset: Asset, body: solid.Solid, config: RefineConfig, regions: AssetRegions | None = None
) -> solid.Solid:
    """The solid in small triangles, smaller ones along the edges of the texture and larger ones elsewhere.

    Even triangles serve a texture without crisp edges best, a small budget, and an object whose target is not its
    texture. Where the surface stays flat, texture calls for no small triangles.
    """
    frame = Frame.of(body.vertices, config.size_mm)

    def importance(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        contrast = local_range(asset, vertices, faces)
        if regions is None:
            return contrast
        return contrast * regions.on(vertices, faces, vertex_normals(vertices, faces), frame).of_faces(faces)

    mm = 1 / (frame.mm_per_unit * frame.scale)
    few = round(COARSE_SHARE * config.max_faces)
    if asset.textured and shortest_edge(body.vertices, body.faces, few) <= COARSEST_MM * mm:
        coarse = solid.remesh(body, config.mesh_edge_mm * mm, few)
        if crispness(coarse.vertices, coarse.faces, importance(coarse.vertices, coarse.faces)) > SOFT:
            return solid.refine(coarse, body, importance, config.max_faces, config.nozzle_mm / 2 * mm)
    return solid.remesh(body, config.mesh_edge_mm * mm, config.max_faces)


def build_scenes(
    asset: Asset | SdfAsset,
    body: solid.Solid,
    frame: Frame,
    config: RefineConfig,
    xml: Path,
    folder: Path,
    pictures: tuple[Picture, ...] = (),
) -> tuple[InitialSurface, ScenePair, ScenePair]:
    """The initial surface, and the scenes of the optimisation and of the evaluation around it."""
    vertices, faces = frame.normalise(body.vertices), body.faces
    radius = float(np.linalg.norm(vertices, axis=1).max())

    def albedo(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        return asset.closest_albedo(frame.restore(points), normals)

    def look(points: np.ndarray, normals: np.ndarray, spacing: float) -> Look | None:
        return asset.look(frame.restore(points), normals, spacing / frame.scale)

    ply = folder / "part.ply"
    normals = bridge.write_ply(ply, vertices, faces)
    optimised = RenderSettings(radius, config.resolution, config.samples)
    training = ScenePair(
        scenes.load(xml, ply, **asdict(optimised), silhouettes=config.silhouettes),
        target.build_reference(xml, folder, vertices, faces, normals, albedo, optimised, pictures, look),
    )
    # Layers are looked at, and not optimised: on a wall they leave slopes without any gradient
    bulge = PRINTERS[config.printer].visible_bulge
    scored = RenderSettings(radius, evaluator.RESOLUTION, evaluator.SAMPLES, bulge)
    evaluation = ScenePair(scenes.load(xml, ply, **asdict(scored)), training.reference)
    evaluation.part.stand(frame.up)
    return initial_surface(asset, frame, vertices, faces, normals), training, evaluation


def extract(asset: SdfAsset) -> tuple[SdfAsset, solid.Solid]:
    """The field without small components and cavities, and its surface.

    Raises:
        SolidError: the surface is no closed manifold.
    """
    phi, dropped = without_small_components(asset.phi)
    asset = replace(asset, phi=phi)
    vertices, faces = asset.surface(training=True)
    if not is_solid(vertices, faces):
        raise SolidError(f"the surface of {asset.name} is no solid. Generate it again, or refine its mesh instead.")
    report = {
        "samples_per_axis": len(phi),
        "faces": len(faces),
        "bodies": int(topology.components(faces).max() + 1),
        "specks_dropped": dropped,
        "volume": signed_volume(vertices, faces),
    }
    return asset, solid.Solid(vertices, faces, asset.report | report)


def parameterize(problem: RefinementProblem, config: RefineConfig, device: str) -> Parameterization:
    """What the refinement moves: the vertices of the part, or the field that it is extracted from."""
    surface, wavelength = problem.surface, DETAIL_MM / problem.frame.mm_per_unit
    if isinstance(problem.asset, SdfAsset):
        # As wide in mm as on a mesh, where a vertex has six neighbours around it instead of four
        cell_mm = 2 / problem.asset.resolution * problem.asset.half * problem.frame.scale * problem.frame.mm_per_unit
        return SdfParameterization(
            problem.asset,
            problem.frame,
            surface.vertices,
            surface.faces,
            surface.normals,
            problem.bounds,
            smoothing=FIELD_SMOOTHING * (config.mesh_edge_mm / cell_mm) ** 2 * config.smoothing,
            wavelength=wavelength,
            device=device,
        )
    return MeshParameterization(
        surface.vertices,
        surface.normals,
        surface.faces,
        problem.bounds,
        smoothing=config.smoothing,
        low_pass=problem.low_pass if device == "cpu" else LowPass(surface.vertices, surface.faces, wavelength, device),
        device=device,
    )


def _require_usable(xml: Path, folder: Path) -> None:
    """Raise :class:`SceneError` for a scene file that cannot be used, before minutes of meshing."""
    bridge.write_ply(folder / "trial.ply", np.eye(3), np.array([[0, 1, 2]]))
    scenes.load(xml, folder / "trial.ply", radius=1.0)
