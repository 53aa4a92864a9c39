"""Pictures of a field on the surface, rendered by Mitsuba, with a colour bar in MPa."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from genmf_mi.core.files import atomic
from genmf_mi.stress.fem.simulation import Simulation

VIEWS = ((35.0, 20.0), (215.0, 20.0))
"""Azimuth and elevation in degrees; azimuth 0 looks at the front (the side at +z in the asset's frame)."""
COLOURS = "turbo"
_OVERSAMPLING = 2
_FIELD_OF_VIEW = 24.0


def surface_field(simulation: Simulation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices in the normalised frame ``[V,3]``, faces ``[F,3]`` and von Mises in MPa ``[V]`` of the surface."""
    faces = simulation.mesh.boundary()
    used, faces = np.unique(faces, return_inverse=True)
    return simulation.mesh.points[used], faces.reshape(-1, 3), simulation.field.von_mises_nodes[used]


def render(vertices, faces, value, azimuth: float, elevation: float, pixels: int, device: str = "auto") -> dict:
    """One view of a value on a surface, as arrays ``[H,W]``: ``shade`` in 0..1, ``value``, and ``hit``, True on the
    object.

    Raises:
        SetupError: Mitsuba cannot run here.
    """
    from genmf_mi.render import variant

    variant.use(device)
    import drjit as dr
    import mitsuba as mi

    size = pixels * _OVERSAMPLING
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
    a, e = np.radians([azimuth, elevation])
    towards = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    side = np.array([np.cos(a), 0.0, -np.sin(a)])
    across = np.abs((vertices - centre) @ np.stack([side, np.cross(towards, side)], axis=1)).max(axis=1)
    distance = ((vertices - centre) @ towards + 1.12 * across / np.tan(np.radians(_FIELD_OF_VIEW / 2))).max()
    key = centre + radius * (4.0 * towards - 3.0 * side + np.array([0, 4.5, 0]))
    transform = mi.ScalarTransform4f()
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": _FIELD_OF_VIEW,
            "to_world": transform.look_at(
                origin=list(centre + distance * towards), target=list(centre), up=[0.0, 1.0, 0.0]
            ),
            "film": {
                "type": "hdrfilm",
                "width": size,
                "height": size,
                "rfilter": {"type": "box"},
                "pixel_format": "luminance",
            },
            "sampler": {"type": "multijitter", "sample_count": 9},
        }
    )
    body = mi.Mesh("body", len(vertices), len(faces), has_vertex_normals=True)
    body.add_attribute("vertex_value", 1, np.asarray(value, dtype=np.float32))
    params = mi.traverse(body)
    params["vertex_positions"] = np.asarray(vertices, dtype=np.float32).reshape(-1)
    params["faces"] = np.asarray(faces, dtype=np.uint32).reshape(-1)
    params["vertex_normals"] = _normals(vertices, faces).astype(np.float32).reshape(-1)
    params.update()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "body": body,
            "floor": {
                "type": "disk",
                "bsdf": {"type": "diffuse", "reflectance": 0.88},
                "to_world": transform.translate([centre[0], float(low[1]) - 1e-3, centre[2]])
                .rotate([1, 0, 0], -90)
                .scale(40 * float(radius)),
            },
            "sky": {"type": "constant", "radiance": 0.62},
            "key": {
                "type": "rectangle",
                "to_world": transform.look_at(origin=list(key), target=list(centre), up=[0.0, 1.0, 0.0]).scale(
                    2.2 * float(radius)
                ),
                "emitter": {"type": "area", "radiance": 1.9},
            },
        }
    )
    shade = np.array(mi.render(scene, sensor=sensor, seed=0))[..., 0]

    alone = mi.load_dict({"type": "scene", "body": body})
    index = dr.arange(mi.UInt32, size * size)
    place = mi.Point2f((mi.Float(index % size) + 0.5) / size, (mi.Float(index // size) + 0.5) / size)
    ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    found = alone.ray_intersect(ray)
    hit = found.is_valid()
    seen = found.shape.eval_attribute_1("vertex_value", found, hit)
    return {
        "shade": shade,
        "value": np.array(seen).reshape(size, size),
        "hit": np.array(hit).reshape(size, size),
    }


def coloured(view: dict, top: float) -> np.ndarray:
    """sRGB ``[H,W,3]`` of a rendered view, colours from 0 to ``top`` MPa, oversampling averaged out."""
    from matplotlib import colormaps

    shade = np.clip(view["shade"], 0.0, None)[..., None]
    colour = colormaps[COLOURS](np.clip(view["value"] / top, 0.0, 1.0))[..., :3] ** 2.2
    image = np.where(
        view["hit"][..., None], colour * (0.25 + 0.95 * shade), np.minimum(1.15 * shade, 1.0) * [0.97, 0.98, 1.0]
    )
    n = view["shade"].shape[0] // _OVERSAMPLING
    image = image.reshape(n, _OVERSAMPLING, n, _OVERSAMPLING, 3).mean(axis=(1, 3))
    return np.clip(image, 0.0, 1.0) ** (1 / 2.2)


def write_picture(path: Path, shapes: list[tuple[str, Simulation]], title: str, pixels: int = 640) -> None:
    """A sheet with a row of views for each of ``shapes`` (caption, simulation) on one colour scale, up to their 99.5 %.

    Raises:
        SetupError: Mitsuba cannot run here. OutputError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    surfaces = [surface_field(simulation) for _, simulation in shapes]
    top = max(float(np.percentile(value, 99.5)) for _, _, value in surfaces)
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
        for column, view in enumerate(VIEWS):
            axes = figure.add_subplot(grid[row, column])
            axes.imshow(coloured(render(*surface, *view, pixels), top), interpolation="lanczos")
            axes.set_axis_off()
            if column == 0:
                axes.set_title(caption, loc="left", fontsize=10.5, color="#444444", pad=5)
    bar = figure.add_subplot(grid[:, columns])
    scale = ScalarMappable(Normalize(0.0, top), COLOURS)
    figure.colorbar(scale, cax=bar, extend="max", label="von Mises stress, MPa").outline.set_visible(False)
    with atomic(path) as temporary:
        figure.savefig(temporary, dpi=140)


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted vertex normals ``[V,3]``."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    normal = np.stack(
        [np.bincount(faces.reshape(-1), np.repeat(face[:, i], 3), len(vertices)) for i in range(3)], axis=1
    )
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
