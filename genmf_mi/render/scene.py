"""Scene files: one Mitsuba XML per object, loaded around a mesh that this package prepared.

A scene file says how the object is looked at: the two-light material, the camera's field of view, the reconstruction
filter, the standard views. The mesh is a parameter of it (``$mesh``). :class:`Scene` adds what the XML cannot say:
where a view stands and how its lights are turned. Files named ``*_sdf.xml`` hold Φ on a grid instead of a mesh, see
:mod:`genmf_mi.render.sdf_scene`.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from genmf_mi.core.errors import SceneError
from genmf_mi.render import variant

MESH, GRID = "mesh", "grid"
"""What a scene file is around: the name of its parameter."""
_PARAMETERS = {MESH: (MESH,), GRID: (GRID, "half", "x", "y", "z")}
_SHAPE = {MESH: "a `ply`", GRID: "an `sdfgrid`"}
START = "start from the output of `genmf-mi scene`."
MARGIN = 1.04
"""The frame is this much wider than the object's bounding sphere."""


@dataclass(frozen=True)
class View:
    """A camera on a sphere around the object, and a turn of its lights.

    azimuth, elevation: degrees; azimuth 0 looks at the +z side, 90 at the +x side.
    light_turn: degrees by which both lights are turned about the camera's vertical and horizontal axis.
    """

    azimuth: float
    elevation: float
    light_turn: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def parse(cls, text: str, separator: str) -> View:
        """Azimuth and elevation from text. Raises ValueError."""
        azimuth, elevation = map(float, text.split(separator))
        if not (np.isfinite(azimuth) and abs(elevation) <= 90):
            raise ValueError(text)
        return cls(azimuth, elevation)

    @property
    def label(self) -> str:
        return f"azimuth {self.azimuth:g}°, elevation {self.elevation:g}°"


@dataclass
class Scene:
    """A loaded scene whose one object is about to be moved, lit and looked at.

    scene, params: Mitsuba's own objects.
    shape_id, sensor_id: the ids that prefix the keys of ``params``.
    views: the standard views named in the file.
    distance: of the camera from the origin, in normalised units.
    resolution: pixels per side of the (square) image.
    moves: counts what invalidates the derivatives of earlier images, see :func:`genmf_mi.render.bridge.render`.
    """

    scene: Any
    params: Any
    shape_id: str
    sensor_id: str
    views: tuple[View, ...]
    distance: float
    resolution: int
    lights: dict[str, np.ndarray] = field(default_factory=dict)
    moves: int = 0

    @property
    def sensor(self) -> Any:
        return next(s for s in self.scene.sensors() if s.id() == self.sensor_id)

    @property
    def integrator(self) -> Any:
        return self.scene.integrator()

    @property
    def bsdf(self) -> Any:
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

    def set_view(self, view: View) -> None:
        """Move the camera to ``view`` and turn the lights."""
        import mitsuba as mi

        self.params[variant.camera_pose_key(self.sensor_id)] = mi.Transform4f(camera_to_world(view, self.distance))
        turn = _rotation(1, view.light_turn[0]) @ _rotation(0, view.light_turn[1])
        for key, direction in self.lights.items():
            self.params[key] = mi.Vector3f(turn @ direction)
        self.params.update()


def camera_to_world(view: View, distance: float) -> np.ndarray:
    """``[4,4]`` camera-to-world matrix; Mitsuba's camera looks along +z with +x to its left."""
    matrix = np.eye(4)
    matrix[:3, :3] = _rotation(1, view.azimuth) @ _rotation(0, -view.elevation) @ _rotation(1, 180)
    matrix[:3, 3] = -distance * matrix[:3, 2]
    return matrix


def _rotation(axis: int, degrees: float) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("xyz"[axis], degrees, degrees=True).as_matrix()


def load(
    xml: str | Path,
    mesh: str | Path,
    *,
    radius: float,
    resolution: int | None = None,
    samples: int | None = None,
    attribute: str = "",
    silhouettes: bool = False,
    holds: str = MESH,
    **placement: float,
) -> Scene:
    """Load a scene file around the PLY file ``mesh``; the variant must have been chosen (:func:`variant.use`).

    radius: of the object's bounding sphere about the origin, normalised units; sets the camera's distance.
    resolution, samples: pixels per side and samples per pixel; the file's own defaults if None.
    attribute: mesh attribute that multiplies the albedo, for rendering the textured object.
    silhouettes: also differentiate silhouettes; the image then has no geometry buffers.
    holds, placement: of Φ on a grid, for :func:`genmf_mi.render.sdf_scene.load`.

    Raises:
        SceneError: the file is missing, is not XML, or lacks the material or a sensor.
    """
    import mitsuba as mi

    xml = Path(xml)
    defaults = read_defaults(xml, holds)
    settings = {holds: str(mesh), "resolution": resolution, "samples": samples, **placement}
    settings = {k: str(v) for k, v in settings.items() if k in defaults and v is not None}
    try:
        scene = mi.load_file(str(xml), **settings)
    except Exception as error:  # Mitsuba reports every defect of a file as RuntimeError
        raise SceneError(f"Mitsuba cannot load {xml}: {_one_line(error)} Mend it, or {START}") from error

    shapes = [s for s in scene.shapes() if type(s.bsdf()).__name__ == "TwoLight"]
    if not shapes:
        raise SceneError(f"no shape in {xml} has the material `twolight`: {START}")
    if len(shapes) < len(scene.shapes()):
        raise SceneError(f"a shape in {xml} has another material than `twolight`, which alone can be rendered: {START}")
    if not scene.sensors():
        raise SceneError(f"{xml} has no sensor: {START}")
    shape, sensor = shapes[0], scene.sensors()[0]
    if attribute:
        shape.bsdf().attribute = attribute
    integrator = scene.integrator()
    if type(integrator).__name__ != "Monochrome":
        raise SceneError(f"the integrator of {xml} must be `monochrome`: {START}")
    if silhouettes:
        integrator.aovs, integrator.silhouettes, integrator.sppp = False, True, None

    width, height = sensor.film().size()
    if width != height:
        raise SceneError(f"the image of {xml} must be square, not {width} × {height}: set both to $resolution.")
    params = mi.traverse(scene)
    needed = [f"{sensor.id()}.x_fov", variant.geometry_key(holds, shape.id()), *variant.light_direction_keys(shape.id())]
    if missing := [key for key in needed if key not in params]:
        raise SceneError(
            f"{xml} has no parameter {missing[0]}: the sensor must be `perspective`, the shape {_SHAPE[holds]} that "
            f"holds its material, and both must have an id. {START.capitalize()}"
        )
    fov = float(np.ravel(params[needed[0]])[0])
    lights = {key: np.ravel(np.array(params[key])).astype(float) for key in needed[2:]}
    return Scene(
        scene=scene,
        params=params,
        shape_id=shape.id(),
        sensor_id=sensor.id(),
        views=parse_views(defaults.get("views", ""), xml),
        distance=MARGIN * radius / np.sin(np.radians(fov / 2)),
        resolution=int(width),
        lights=lights,
    )


def read_defaults(xml: Path, holds: str = MESH) -> dict[str, str]:
    """The ``<default>`` parameters of a scene file. Raises :class:`SceneError` if it cannot be read or used."""
    try:
        root = ElementTree.parse(xml).getroot()
    except FileNotFoundError as error:
        raise SceneError(f"there is no scene file {xml}. Check the spelling, or {START}") from error
    except (ElementTree.ParseError, OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{xml} is not readable as XML: {_one_line(error)} Mend it, or {START}") from error
    defaults = {e.get("name", ""): e.get("value", "") for e in root.iter("default")}
    if missing := [name for name in _PARAMETERS[holds] if name not in defaults]:
        raise SceneError(
            f'{xml} has no <default name="{missing[0]}" .../>, so no {holds} can be put in: see `genmf-mi scene`.'
        )
    return defaults


def parse_views(text: str, source: Path | str = "views") -> tuple[View, ...]:
    """``"0:20 60:-10"`` to views (azimuth:elevation in degrees). Raises :class:`SceneError`."""
    try:
        views = tuple(View.parse(item, ":") for item in text.split())
    except ValueError as error:
        raise SceneError(f"{source}: views are written as `azimuth:elevation azimuth:elevation ...`.") from error
    if not views:
        raise SceneError(f'{source} names no views: add <default name="views" value="0:20 60:-10 ..."/>.')
    return views


def find(name: str, holds: str = MESH) -> Path:
    """The scene file of a bundled sample, or the default one; ``NAME_sdf`` is NAME held as Φ and looks alike."""
    import genmf_mi.scenes

    folder = Path(genmf_mi.scenes.__file__).parent
    ending = ".xml" if holds == MESH else "_sdf.xml"
    path = folder / f"{name.removesuffix('_sdf')}{ending}"
    return path if path.exists() else folder / f"default{ending}"


def _one_line(error: Exception) -> str:
    """What the error says, as a sentence on one line."""
    return (" ".join(str(error).split()) or type(error).__name__).rstrip(".") + "."


def author(asset: str, mesh: Path | None = None) -> None:
    """Print a scene file for an asset, to edit and hand back with ``--scene``.

    Args:
        asset: A file or the name of a bundled sample.
        mesh: What to name as the mesh in it; NAME.ply if not given. A refinement puts its own mesh there.
    """
    from genmf_mi.assets import samples

    name = samples.resolve(asset).stem
    text = find(name).read_text(encoding="utf-8")
    value = quoteattr(str(mesh or f"{name}.ply"))
    print(re.sub(r'(?<=<default name="mesh" value=)"[^"]*"', lambda _: value, text), end="")
