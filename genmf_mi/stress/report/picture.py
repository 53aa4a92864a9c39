"""Pictures of a stress field on the surface, rendered by Mitsuba, with a colour bar in MPa."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from genmf_mi.core.colour import to_linear, to_srgb
from genmf_mi.core.files import atomic
from genmf_mi.mesh.measures import vertex_normals
from genmf_mi.stress.fem.simulation import Simulation

if TYPE_CHECKING:
    from genmf_mi.stress.model.predictor import Prediction

VIEWS = ((35.0, 20.0), (215.0, 20.0))
"""Azimuth and elevation in degrees; azimuth 0 looks at the front (the side at +z in the asset's frame)."""
COLOURS = "turbo"
_OVERSAMPLING = 2
_FIELD_OF_VIEW = 24.0
_MARGIN = 1.12
"""Width of the picture over that of the object."""


class SurfaceField(NamedTuple):
    """Vertices in the normalised frame ``[V,3]``, faces ``[F,3]`` and von Mises in MPa ``[V]`` of a surface."""

    vertices: np.ndarray
    faces: np.ndarray
    value: np.ndarray


@dataclass(frozen=True)
class RenderedField:
    """One view of a field, oversampled, ``[H,W]`` each: radiance of a white object ``shade``, the field's ``value``,
    and ``hit``, True on the object."""

    shade: np.ndarray
    value: np.ndarray
    hit: np.ndarray


def surface_field(simulation: Simulation | Prediction) -> SurfaceField:
    """The field on the surface of the mesh."""
    used, faces = np.unique(simulation.mesh.boundary(), return_inverse=True)
    return SurfaceField(
        simulation.mesh.points[used], faces.reshape(-1, 3), np.asarray(simulation.field.von_mises_nodes)[used]
    )


def render(surface: SurfaceField, azimuth: float, elevation: float, pixels: int, device: str = "auto") -> RenderedField:
    """One view of a field; the camera is as close as the object fits into a square picture.

    Args:
        azimuth, elevation: of the camera in degrees, see :data:`VIEWS`.

    Raises:
        SetupError: Mitsuba cannot run here.
    """
    from genmf_mi.render import variant

    variant.use(device)
    import mitsuba as mi

    size = pixels * _OVERSAMPLING
    camera = _Camera.around(surface.vertices, azimuth, elevation)
    sensor, body = camera.sensor(size), _mesh(surface)
    integrator = {"type": "path", "max_depth": 3}
    scene = mi.load_dict({"type": "scene", "integrator": integrator, "body": body, **camera.set()})
    shade = np.array(mi.render(scene, sensor=sensor, seed=mi.UInt32(0)))[..., 0]
    value, hit = _visible_value(body, sensor, size)
    return RenderedField(shade, value, hit)


def colourise(view: RenderedField, top: float) -> np.ndarray:
    """sRGB-encoded ``[H,W,3]`` of a rendered view, colours from 0 to ``top`` MPa, oversampling averaged out."""
    from matplotlib import colormaps

    shade = np.clip(view.shade, 0.0, None)[..., None]
    colour = to_linear(colormaps[COLOURS](np.clip(view.value / top, 0.0, 1.0))[..., :3])
    background = np.minimum(1.15 * shade, 1.0) * [0.97, 0.98, 1.0]
    image = np.where(view.hit[..., None], colour * (0.25 + 0.95 * shade), background)
    n = view.shade.shape[0] // _OVERSAMPLING
    image = image.reshape(n, _OVERSAMPLING, n, _OVERSAMPLING, 3).mean(axis=(1, 3))
    return to_srgb(np.clip(image, 0.0, 1.0))


def write_picture(path: Path, shapes: list[tuple[str, Simulation | Prediction]], title: str, pixels: int = 640) -> None:
    """A sheet with a row of views for each of ``shapes`` (caption, simulation) on one colour scale, up to their 99.5 %.

    Raises:
        SetupError: Mitsuba cannot run here. OutputError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    surfaces = [surface_field(simulation) for _, simulation in shapes]
    top = max(float(np.percentile(surface.value, 99.5)) for surface in surfaces)
    rows, columns = len(shapes), len(VIEWS)
    inch = 4.6
    figure = Figure(figsize=(columns * inch + 1.0, rows * inch + 0.75), facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        rows, columns + 1, width_ratios=[1] * columns + [0.045], wspace=0.03, hspace=0.09,
        left=0.015, right=0.925, bottom=0.02, top=1 - 0.7 / (rows * inch + 0.75),
    )  # fmt: skip
    figure.suptitle(
        title, x=0.02, y=1 - 0.14 / (rows * inch + 0.75), ha="left", va="top", fontsize=14, fontweight="bold"
    )
    for row, ((caption, _), surface) in enumerate(zip(shapes, surfaces)):
        for column, (azimuth, elevation) in enumerate(VIEWS):
            axes = figure.add_subplot(grid[row, column])
            axes.imshow(colourise(render(surface, azimuth, elevation, pixels), top), interpolation="lanczos")
            axes.set_axis_off()
            if column == 0:
                axes.set_title(caption, loc="left", fontsize=10.5, color="#444444", pad=5)
    bar = figure.add_subplot(grid[:, columns])
    scale = ScalarMappable(Normalize(0.0, top), COLOURS)
    figure.colorbar(scale, cax=bar, extend="max", label="von Mises stress, MPa").outline.set_visible(False)
    with atomic(path) as temporary:
        figure.savefig(temporary, dpi=140)


@dataclass(frozen=True)
class _Camera:
    """Where the picture is taken from, and the floor and the lights that go with it; all in the normalised frame.

    centre: of the bounding box; radius: half of its diagonal; base: height of its lower side. origin: of the camera.
    key: centre of the main light.
    """

    centre: np.ndarray
    radius: float
    base: float
    origin: np.ndarray
    key: np.ndarray

    @classmethod
    def around(cls, vertices: np.ndarray, azimuth: float, elevation: float) -> _Camera:
        """As close to ``vertices [V,3]`` as all of them fit into the picture."""
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        a, e = np.radians([azimuth, elevation])
        towards = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        side = np.array([np.cos(a), 0.0, -np.sin(a)])
        across = np.abs((vertices - centre) @ np.stack([side, np.cross(towards, side)], axis=1)).max(axis=1)
        depth = (vertices - centre) @ towards
        distance = (depth + _MARGIN * across / np.tan(np.radians(_FIELD_OF_VIEW / 2))).max()
        key = centre + radius * (4.0 * towards - 3.0 * side + np.array([0, 4.5, 0]))
        return cls(centre, radius, float(low[1]), centre + distance * towards, key)

    def sensor(self, size: int) -> Any:
        """A Mitsuba camera with ``size`` × ``size`` pixels."""
        import mitsuba as mi

        film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
        return mi.load_dict(
            {
                "type": "perspective",
                "fov": _FIELD_OF_VIEW,
                "to_world": self._look_from(self.origin),
                "film": {**film, "pixel_format": "luminance"},
                "sampler": {"type": "multijitter", "sample_count": 9},
            }
        )

    def set(self) -> dict[str, Any]:
        """Floor and lights as entries of a Mitsuba scene."""
        import mitsuba as mi

        floor: Any = mi.ScalarTransform4f()
        floor = floor.translate([self.centre[0], self.base - 1e-3, self.centre[2]]).rotate([1, 0, 0], -90)
        return {
            "floor": {
                "type": "disk",
                "bsdf": {"type": "diffuse", "reflectance": 0.88},
                "to_world": floor.scale(40 * self.radius),
            },
            "sky": {"type": "constant", "radiance": 0.62},
            "key": {
                "type": "rectangle",
                "to_world": self._look_from(self.key).scale(2.2 * self.radius),
                "emitter": {"type": "area", "radiance": 1.9},
            },
        }

    def _look_from(self, origin: np.ndarray) -> Any:
        import mitsuba as mi

        transform: Any = mi.ScalarTransform4f()
        return transform.look_at(origin=list(origin), target=list(self.centre), up=[0.0, 1.0, 0.0])


def _mesh(surface: SurfaceField) -> Any:
    """A Mitsuba mesh with smooth normals and the field as its attribute ``vertex_value``."""
    import mitsuba as mi

    body: Any = mi.Mesh("body", len(surface.vertices), len(surface.faces), has_vertex_normals=True)
    body.add_attribute("vertex_value", 1, np.asarray(surface.value, dtype=np.float32))
    params = mi.traverse(body)
    params["vertex_positions"] = np.asarray(surface.vertices, dtype=np.float32).reshape(-1)
    params["faces"] = np.asarray(surface.faces, dtype=np.uint32).reshape(-1)
    params["vertex_normals"] = vertex_normals(surface.vertices, surface.faces).astype(np.float32).reshape(-1)
    params.update()
    return body


def _visible_value(body: Any, sensor: Any, size: int) -> tuple[np.ndarray, np.ndarray]:
    """``vertex_value`` of ``body`` in the middle of each pixel, and whether the body is seen there, ``[H,W]`` both."""
    import drjit as dr
    import mitsuba as mi

    body_alone: Any = mi.load_dict({"type": "scene", "body": body})
    index = dr.arange(mi.UInt32, size * size)
    place = mi.Point2f((mi.Float(index % size) + 0.5) / size, (mi.Float(index // size) + 0.5) / size)
    ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    interaction = body_alone.ray_intersect(ray)
    hit = interaction.is_valid()
    value = interaction.shape.eval_attribute_1("vertex_value", interaction, hit)
    return np.array(value).reshape(size, size), np.array(hit).reshape(size, size)
