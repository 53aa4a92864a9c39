"""Scenes: one Mitsuba XML file per object, loaded around a mesh that this package prepared.

A scene file says how the object is viewed: the two-light material, the camera's field of view, the reconstruction
filter, the standard views. The mesh is a parameter of it (``$mesh``). :class:`Scene` adds what the XML cannot say:
where the camera of a view stands and how its lights are turned. Files named ``*_sdf.xml`` show Φ on a grid instead of a
mesh, see :mod:`genmf_mi.render.sdf_scene`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy import ndarray

from genmf_mi.core.errors import SceneError
from genmf_mi.core.frame import UPRIGHT, Up
from genmf_mi.render import variant
from genmf_mi.render.scene_file import GRID, MESH, START, bundled_folder, find, one_line, read_defaults, standalone_xml
from genmf_mi.render.untyped import MitsubaObject, MitsubaScene, mi
from genmf_mi.render.view import View, camera_to_world, light_rotation

__all__ = [
    "GRID",
    "MARGIN",
    "MESH",
    "RenderSettings",
    "Scene",
    "View",
    "camera_to_world",
    "find",
    "load",
    "parse_views",
    "read_defaults",
    "standalone_xml",
]

MARGIN = 1.04
"""The frame is this much wider than the object's bounding sphere."""
_SHAPE = {MESH: "a `ply`", GRID: "an `sdfgrid`"}


@dataclass(frozen=True)
class RenderSettings:
    """How the scenes of one object are rendered.

    radius: of the object's bounding sphere about the origin, normalised units; sets the camera's distance.
    resolution, samples: pixels per side and samples per pixel; the scene file's own defaults if None.
    bulge: of the beads of a filament print whose layers are too fine to see (``twolight``); None for a smooth surface.
    """

    radius: float
    resolution: int | None = None
    samples: int | None = None
    bulge: float | None = None


@dataclass
class Scene:
    """A loaded scene, whose one object can be moved, lit and rendered from any view.

    scene, params: Mitsuba's own objects.
    shape_id, sensor_id: the ids that prefix the keys of ``params``.
    views: the standard views named in the file.
    distance: of the camera from the origin, in normalised units. fov: its field of view without any zoom, in degrees.
    resolution: pixels per side of the (square) image.
    lights: direction of each light before any turn, by its key in ``params``.
    bulge: as in :class:`RenderSettings`. up: unit vector away from the print bed, across the layers.
    moves: counts what invalidates the derivatives of earlier images, see :func:`genmf_mi.render.bridge.render`.
    """

    scene: MitsubaScene
    params: MitsubaObject
    shape_id: str
    sensor_id: str
    views: tuple[View, ...]
    distance: float
    fov: float
    resolution: int
    lights: dict[str, Float64[ndarray, " 3"]]
    bulge: float | None = None
    up: Up = UPRIGHT
    moves: int = 0

    @property
    def sensor(self) -> MitsubaObject:
        return next(s for s in self.scene.sensors() if s.id() == self.sensor_id)

    @property
    def integrator(self) -> MitsubaObject:
        return self.scene.integrator()

    @property
    def bsdf(self) -> MitsubaObject:
        return next(s.bsdf() for s in self.scene.shapes() if s.id() == self.shape_id)

    @property
    def material(self) -> dict[str, Any]:
        """The parameters of ``twolight`` in plain Python, by their names in the plugin; the lights before any turn."""
        bsdf = self.bsdf
        numbers = {name: getattr(bsdf, name) for name in ("ambient", "key_weight", "fill_weight", "sharpness")}
        numbers["albedo"] = bsdf.albedo.mean()
        return {
            **{name: float(np.ravel(number)[0]) for name, number in numbers.items()},
            **{key.rpartition(".")[2]: direction.tolist() for key, direction in self.lights.items()},
            "lights": bsdf.lights,
        }

    @property
    def light_weights(self) -> dict[str, float]:
        """The weight of each light, by its key in ``lights``."""
        return {key: float(np.ravel(getattr(self.bsdf, f"{key.rpartition('.')[2]}_weight"))[0]) for key in self.lights}

    @property
    def half_width(self) -> float:
        """Of the whole image at unit distance."""
        return float(np.tan(np.radians(self.fov / 2)))

    def has_attribute(self, name: str) -> bool:
        """Whether the mesh has this attribute."""
        return any(shape.has_attribute(name) for shape in self.scene.shapes() if shape.id() == self.shape_id)

    def resize(self, resolution: int) -> None:
        """Render at ``resolution`` pixels per side from now on."""
        if resolution != self.resolution:
            for key in variant.film_size_keys(self.sensor_id):
                self.params[key] = mi.ScalarVector2u(resolution)
            self.params.update()
            self.resolution = resolution

    def shade_as(self, other: Scene) -> None:
        """Render at the resolution of ``other`` and with its layers, or without as it does, from now on."""
        self.resize(other.resolution)
        self.stand(other.up)
        if other.bulge != self.bulge:
            self.bsdf.stack(other.bulge)
            self.bulge = other.bulge

    def stand(self, up: Up) -> None:
        """Print with the unit vector ``up`` away from the bed from now on."""
        if up != self.up:
            self.bsdf.build, self.up = mi.Vector3f(*up), up

    def set_view(self, view: View) -> None:
        """Move the camera to ``view``, zoom and turn the lights."""
        self.params[variant.camera_pose_key(self.sensor_id)] = mi.Transform4f(camera_to_world(view, self.distance))
        # A magnified part of the image: a smaller field of view whose axis leaves the middle of the film
        self.params[variant.fov_key(self.sensor_id)] = 2 * np.degrees(np.arctan(self.half_width / view.zoom))
        for key, share in zip(variant.principal_point_keys(self.sensor_id), view.centre, strict=True):
            self.params[key] = share * view.zoom
        turn = light_rotation(view)
        for key, direction in self.lights.items():
            self.params[key] = mi.Vector3f(turn @ direction)
        self.params.update()


def load(
    xml: str | Path,
    mesh: str | Path,
    *,
    radius: float,
    resolution: int | None = None,
    samples: int | None = None,
    bulge: float | None = None,
    attribute: str = "",
    silhouettes: bool = False,
    holds: str = MESH,
    **placement: float,
) -> Scene:
    """Load a scene file around the PLY file ``mesh``; the variant must have been chosen (:func:`variant.use`).

    radius, resolution, samples, bulge: as in :class:`RenderSettings`.
    attribute: mesh attribute that multiplies the albedo, for rendering the textured object.
    silhouettes: also differentiate silhouettes; the image then has no geometry buffers.
    holds: :data:`MESH`, or :data:`GRID` if ``mesh`` is a file of :func:`genmf_mi.render.sdf_scene.write_grid`; its
        ``placement`` is that of :func:`genmf_mi.render.sdf_scene.placement`. A grid is rendered with
        :func:`genmf_mi.render.bridge.render`, without vertices.

    Raises:
        SceneError: the file is missing, is not XML, or lacks the material or a sensor.
    """
    xml = Path(xml)
    defaults = read_defaults(xml, holds)
    settings = {holds: str(mesh), "resolution": resolution, "samples": samples, **placement}
    scene = _load_file(xml, {k: str(v) for k, v in settings.items() if k in defaults and v is not None})
    shape, sensor = _shape_and_sensor(scene, xml)
    if attribute:
        shape.bsdf().attribute = attribute
    if bulge is not None:
        shape.bsdf().stack(bulge)
    integrator = scene.integrator()
    if type(integrator).__name__ != "Monochrome":
        raise SceneError(f"the integrator of {xml} must be `monochrome`: {START}")
    if silhouettes:
        integrator.aovs, integrator.silhouettes, integrator.sppp = False, True, None

    width, height = sensor.film().size()
    if width != height:
        raise SceneError(f"the image of {xml} must be square, not {width} × {height}: set both to $resolution.")
    params = mi.traverse(scene)
    light_keys = variant.light_direction_keys(shape.id())
    fov_key = variant.fov_key(sensor.id())
    needed = [fov_key, variant.geometry_key(holds, shape.id()), *light_keys]
    if missing := [key for key in needed if key not in params]:
        raise SceneError(
            f"{xml} has no parameter {missing[0]}: the sensor must be `perspective`, the shape {_SHAPE[holds]} that "
            f"holds its material, and both must have an id. {START.capitalize()}"
        )
    fov = float(np.ravel(params[fov_key])[0])
    return Scene(
        scene=scene,
        params=params,
        shape_id=shape.id(),
        sensor_id=sensor.id(),
        views=parse_views(defaults.get("views", ""), xml),
        distance=float(MARGIN * radius / np.sin(np.radians(fov / 2))),
        fov=fov,
        resolution=int(width),
        bulge=bulge,
        lights={key: np.ravel(np.array(params[key])).astype(np.float64) for key in light_keys},
    )


def parse_views(text: str, source: Path | str = "views") -> tuple[View, ...]:
    """``"0:20 60:-10"`` to views (azimuth:elevation in degrees). Raises :class:`SceneError`."""
    try:
        views = tuple(View.parse(item, ":") for item in text.split())
    except ValueError as error:
        raise SceneError(f"{source}: views are written as `azimuth:elevation azimuth:elevation ...`.") from error
    if not views:
        raise SceneError(f'{source} names no views: add <default name="views" value="0:20 60:-10 ..."/>.')
    return views


def _load_file(xml: Path, settings: dict[str, str]) -> MitsubaScene:
    bundled, resolver = str(bundled_folder()), mi.file_resolver()
    if bundled not in list(resolver):
        resolver.append(bundled)  # a copy of a bundled file still finds what it includes
    try:
        return mi.load_file(str(xml), **settings)
    except Exception as error:  # Mitsuba reports every defect of a file as RuntimeError
        raise SceneError(f"Mitsuba cannot load {xml}: {one_line(error)} Fix it, or {START}") from error


def _shape_and_sensor(scene: MitsubaScene, xml: Path) -> tuple[MitsubaObject, MitsubaObject]:
    shapes = [s for s in scene.shapes() if type(s.bsdf()).__name__ == "TwoLight"]
    if not shapes:
        raise SceneError(f"no shape in {xml} has the material `twolight`: {START}")
    if len(shapes) < len(scene.shapes()):
        raise SceneError(f"a shape in {xml} has another material than `twolight`, which alone can be rendered: {START}")
    if not scene.sensors():
        raise SceneError(f"{xml} has no sensor: {START}")
    return shapes[0], scene.sensors()[0]
