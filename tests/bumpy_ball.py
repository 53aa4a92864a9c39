"""A ball with known bumps: as real geometry, and as a plain ball with the normal map of these bumps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from gltf_writer import Gltf

HEIGHT, AROUND, DOWN = 0.02, 9, 6
"""Of the bumps over the radius, and how many waves of them there are around the equator and from pole to pole."""


def height(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Of the bumps at the angle ``theta`` from the north pole and the azimuth ``phi``; they end before the poles."""
    return HEIGHT * np.sin(AROUND * phi) * np.sin(DOWN * theta) * np.sin(theta) ** 3


def normal_map(rows: int = 512) -> np.ndarray:
    """``uint8 [rows,2·rows,3]``: tangent space, right along the azimuth, green towards the north pole."""
    theta = (np.arange(rows) + 0.5)[:, None] / rows * np.pi
    phi = (np.arange(2 * rows) + 0.5)[None] / rows * np.pi
    step, radius = 1e-5, 1 + height(theta, phi)
    east = (height(theta, phi + step) - height(theta, phi - step)) / (2 * step) / (radius * np.sin(theta))
    south = (height(theta + step, phi) - height(theta - step, phi)) / (2 * step) / radius
    normal = np.stack([-east, south, np.ones_like(east)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.rint((normal + 1) * 127.5).astype(np.uint8)


def ball(rows: int = 96) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices ``[V,3]`` of radius 1, faces ``[F,3]``, ``theta`` and ``phi [V]`` of a ball with a seam, y up."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, 2 * rows + 1), indexing="ij")
    index = np.arange(theta.size).reshape(theta.shape)
    a, b, c, d = (x.ravel() for x in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    theta, phi = theta.ravel(), phi.ravel()
    vertices = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], axis=1)
    vertices[np.abs(vertices) < 1e-12] = 0
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    corner = vertices[faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    return vertices, faces[area > 1e-9], theta, phi


def mapped(
    path: Path, *, mirrored: bool = False, given_tangents: bool = False, node: dict | None = None, **texture
) -> Path:
    """A GLB of the plain ball with the map. mirrored: the picture runs against the azimuth. texture: of the map."""
    vertices, faces, theta, phi = ball()
    gltf, pixels = Gltf(), normal_map()
    u = phi / (2 * np.pi)
    if mirrored:
        pixels = pixels[:, ::-1].copy()
        pixels[..., 0] = 255 - pixels[..., 0]
        u = 1 - u
    attributes = {
        "POSITION": gltf.accessor(vertices.astype(np.float32)),
        "TEXCOORD_0": gltf.accessor(np.stack([u, theta / np.pi], axis=1).astype(np.float32)),
    }
    if given_tangents:
        side = -1.0 if mirrored else 1.0
        along = side * np.stack([np.cos(phi), 0 * phi, -np.sin(phi)], axis=1)
        attributes["NORMAL"] = attributes["POSITION"]
        attributes["TANGENT"] = gltf.accessor(np.c_[along, np.full(len(along), side)].astype(np.float32))
    gltf.tree |= {
        "textures": [{"source": gltf.image(pixels)}],
        "materials": [{"name": "bumps", "normalTexture": {"index": 0, **texture}}],
    }
    primitive = {"attributes": attributes, "indices": gltf.accessor(faces.astype(np.uint32).ravel()), "material": 0}
    return gltf.mesh(primitive, nodes=[{"mesh": 0, **(node or {})}]).glb(path)
