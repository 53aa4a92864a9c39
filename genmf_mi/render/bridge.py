"""torch ⇄ Mitsuba: the only module in which tensors pass between the two.

``dr.wrap`` joins the two automatic differentiations, so that a loss computed in torch reaches the vertices through
Mitsuba's own adjoint, on the CPU and on the GPU alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float64, Int
from numpy import ndarray
from torch import Tensor

from genmf_mi.core.errors import OutputError
from genmf_mi.render import variant
from genmf_mi.render.scene import Scene, View
from genmf_mi.render.untyped import MitsubaObject, MitsubaScene, dr, mi


@dataclass(frozen=True)
class Buffers:
    """What one or more views show; float32 torch tensors, 0 outside of the object.

    grey: ``[B,1,H,W]`` G, linear, 0..1.
    depth: ``[B,1,H,W]`` planar depth in normalised units; None if the scene renders without geometry buffers.
    normal: ``[B,3,H,W]`` shading normal in the world frame, likewise.
    coverage: ``[B,1,H,W]`` share of the pixel that the object fills, likewise.
    """

    grey: Float[Tensor, "B 1 H W"]
    depth: Float[Tensor, "B 1 H W"] | None
    normal: Float[Tensor, "B 3 H W"] | None
    coverage: Float[Tensor, "B 1 H W"] | None

    @property
    def geometry(self) -> tuple[Float[Tensor, "B 1 H W"], Float[Tensor, "B 3 H W"], Float[Tensor, "B 1 H W"]]:
        """Depth, normal and coverage. Raises ValueError if the scene renders without geometry buffers."""
        if self.depth is None or self.normal is None or self.coverage is None:
            raise ValueError("the scene was loaded with silhouettes, which leaves no geometry buffers")
        return self.depth, self.normal, self.coverage

    def crop(self, window: tuple[slice, slice]) -> Buffers:
        """The rows and columns of ``window``."""
        rows, columns = window
        grey = self.grey[..., rows, columns]
        others = (None if x is None else x[..., rows, columns] for x in (self.depth, self.normal, self.coverage))
        return Buffers(grey, *others)


def render(
    scene: Scene,
    views: Sequence[View],
    vertices: Float[Tensor, "V 3"] | None = None,
    faces: Int[Tensor, "F 3"] | None = None,
    *,
    seed: int = 0,
    samples: int = 0,
) -> Buffers:
    """Render ``views`` of the object, differentiably with respect to ``vertices``.

    vertices: torch ``[V,3]`` in the normalised frame, or None to leave the object where it is. The acceleration
        structure is rebuilt once for all views of the call.
    faces: torch ``[F,3]`` between these vertices, of any number; None if they are those of the last render, or those
        that the scene was loaded with.
    seed: of the samples within the pixels; the same seed gives the same rays, for any geometry.
    samples: per pixel; the scene's own number if 0.

    The derivatives of the images can be propagated once, and before the object is moved again: Mitsuba evaluates
    parts of them only then, on the object as it is by then. Otherwise the backward pass raises RuntimeError.
    """

    def render_views(draw: Callable[..., MitsubaObject]) -> list[MitsubaObject]:
        images: list[MitsubaObject] = []
        for view in views:
            scene.set_view(view)
            images.append(draw(scene.scene, scene.sensor, seed, samples))
        return images

    @dr.wrap(source="torch", target="drjit")
    def render_moved(positions: MitsubaObject) -> list[MitsubaObject]:
        if face_indices is not None:
            scene.params[variant.faces_key(scene.shape_id)] = face_indices
        scene.params[variant.vertex_positions_key(scene.shape_id)] = positions.array
        scene.params.update()
        return render_views(scene.integrator.render_attached)

    face_indices = None if faces is None else mi.UInt32(faces.to(torch.int32).contiguous().flatten())
    images: list[Tensor] = (
        render_moved(vertices)
        if vertices is not None
        else [image.torch() for image in render_views(scene.integrator.render)]
    )
    stack = torch.stack([image.permute(2, 0, 1) for image in images])
    if vertices is not None:
        scene.moves += 1
        if stack.requires_grad:
            stack.register_hook(_propagated_once(scene))  # pyright: ignore[reportUnknownMemberType]  (torch's)
    if stack.shape[1] == 1:
        return Buffers(stack, None, None, None)
    return Buffers(stack[:, :1], stack[:, 1:2], stack[:, 2:5], stack[:, 5:6])


def _propagated_once(scene: Scene) -> Callable[[Tensor], None]:
    """A hook for the image that was just rendered, which refuses stale derivatives."""
    move = scene.moves

    def check(_gradient: Tensor) -> None:
        if scene.moves != move:
            raise RuntimeError(
                "the derivatives of this image are gone: the object was moved since it was rendered, or they "
                "were propagated before. Render it again, and propagate them at once."
            )
        scene.moves += 1

    return check


def free_ray_distance(
    scene: MitsubaScene, points: Float[ndarray, "N 3"], directions: Float[ndarray, "N 3"], offset: float = 1e-4
) -> Float64[ndarray, " N"]:
    """Distance ``[N]`` from points on the surface to the next surface along unit directions, inf if there is none.

    scene: of Mitsuba. points, directions ``[N,3]``. offset: skipped at the start, to leave the surface that the ray
    starts on.
    """
    start = np.asarray(points + offset * directions, dtype=np.float32)
    ray = mi.Ray3f(mi.Point3f(*start.T), mi.Vector3f(*np.asarray(directions, dtype=np.float32).T))
    return np.array(scene.ray_intersect_preliminary(ray).t, dtype=np.float64) + offset


def wall_thickness(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], chosen: Int[ndarray, " N"]
) -> Float64[ndarray, " N"]:
    """Length ``[N]`` of the way through the solid from the centroids of the ``chosen [N]`` faces, against the normal.

    The unit is that of ``vertices [V,3]``; inf where a ray meets no other face.
    """
    if mi.variant() not in (variant.CPU, variant.CUDA):  # a refinement stays on the device that it was given
        variant.use("auto")
    mesh, _ = _mesh("solid", vertices, faces)
    corner = vertices[faces[chosen]]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    offset = float(1e-4 * np.ptp(vertices, axis=0).max())
    return free_ray_distance(mi.load_dict({"type": "scene", "solid": mesh}), corner.mean(axis=1), -normals, offset)


def render_vertex_values(
    scene: Scene, views: Sequence[View], faces: Int[ndarray, "F 3"], values: Float[ndarray, " V"]
) -> Float[ndarray, "B H W"]:
    """Images ``[B,H,W]`` of per-vertex ``values [V]`` on the current surface, interpolated at the pixel centres.

    NaN where a pixel centre shows no surface.
    """
    n = scene.resolution
    centres = (np.arange(n, dtype=np.float32) + 0.5) / n
    x, y = (mi.Float(a.ravel()) for a in np.meshgrid(centres, centres))
    images: list[ndarray] = []
    for view in views:
        scene.set_view(view)
        ray, _ = scene.sensor.sample_ray(0, 0, mi.Point2f(x, y), mi.Point2f(0))
        hit = scene.scene.ray_intersect_preliminary(ray)
        valid = np.array(hit.is_valid()).astype(bool)
        # Where nothing is hit, the coordinates are undefined
        u, v = (np.where(valid, np.array(c), 0) for c in hit.prim_uv)
        corners = values[faces[np.where(valid, np.array(hit.prim_index), 0)]]
        blend = (corners * np.stack([1 - u - v, u, v], axis=1)).sum(axis=1)
        images.append(np.where(valid, blend, np.nan).reshape(n, n))
    return np.stack(images)


def write_ply(
    path: str | Path,
    vertices: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    *,
    normals: Float[ndarray, "V 3"] | None = None,
    attributes: dict[str, Float[ndarray, " V"]] | None = None,
) -> Float[ndarray, "V 3"]:
    """Write the PLY file that a scene is loaded around; returns its vertex normals ``[V,3]``.

    vertices ``[V,3]`` in the normalised frame, faces ``[F,3]``; normals ``[V,3]``, or None for Mitsuba's
    angle-weighted ones;
    attributes: one value per vertex ``[V]`` by name (``vertex_...``).

    Raises:
        OutputError: the disk is full, or the folder does not exist.
    """
    mesh, params = _mesh(Path(path).stem, vertices, faces, attributes or {}, has_vertex_normals=True)
    if normals is not None:
        params["vertex_normals"] = np.asarray(normals, dtype=np.float32).ravel()
        params.update()
    try:
        mesh.write_ply(str(path))
    except RuntimeError as error:
        reason = str(error).rpartition(": ")[2]
        raise OutputError(f"cannot write {path}: {reason}. Free some space, or point TMPDIR elsewhere.") from error
    return np.array(params["vertex_normals"]).reshape(-1, 3)


def _mesh(
    name: str,
    vertices: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    attributes: dict[str, Float[ndarray, " V"]] | None = None,
    **options: bool,
) -> tuple[MitsubaObject, MitsubaObject]:
    """Mitsuba's mesh of these buffers, and its parameters."""
    mesh = mi.Mesh(name, len(vertices), len(faces), **options)
    for attribute, values in (attributes or {}).items():
        mesh.add_attribute(attribute, 1, np.asarray(values, dtype=np.float32).ravel())
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.asarray(vertices, dtype=np.float32).ravel()
    params["faces"] = np.asarray(faces, dtype=np.uint32).ravel()
    params.update()
    return mesh, params
