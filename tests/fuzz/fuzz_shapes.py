"""Meshes whose file is sound and whose surface is not."""

from __future__ import annotations

import numpy as np
from fuzz_edits import Draw
from fuzz_seeds import Case, shape_arrays, shape_file
from hypothesis import strategies as st


def shape(draw: Draw, case: Case) -> Case:
    """A mesh whose file is sound and whose surface is not: torn, flat, crossing itself, in many pieces."""
    vertices, faces, rgb = shape_arrays(case.files[case.main])
    pick, few = np.random.default_rng(draw(st.integers(0, 2**32 - 1))), draw(st.sampled_from([1, 5, 40, 400]))
    way = draw(st.sampled_from(["move", "garbage", "tear", "turn", "double", "flatten", "far", "weld", "inside",
                                "twist", "scale", "shift", "indices", "mirror"]))  # fmt: skip
    rows, corners = pick.integers(0, len(faces), few), pick.integers(0, len(vertices), few)
    if way == "move":
        vertices[corners] += pick.normal(0, 0.3, (few, 3))
    elif way == "garbage":
        vertices[:] = pick.uniform(-1, 1, vertices.shape)
    elif way == "tear":
        faces = np.delete(faces, rows, axis=0)
    elif way == "turn":
        faces[rows] = faces[rows][:, ::-1]
    elif way == "double":
        faces = np.concatenate([faces, faces[rows]])
    elif way == "flatten":
        vertices[:, draw(st.integers(0, 2))] *= draw(st.sampled_from([0.0, 1e-12, 1e-6, 1e-3]))
    elif way == "far":
        vertices[corners] *= draw(st.sampled_from([1e2, 1e4, 1e8, 1e14]))
    elif way == "weld":
        vertices[corners] = vertices[corners[0]]
    elif way in ("inside", "mirror"):
        size = -1.0 if way == "mirror" else draw(st.sampled_from([0.5, 0.99, 1.0, -0.8]))
        shift = pick.normal(0, draw(st.sampled_from([0.0, 1e-7, 0.3, 3.0])), 3)
        faces = np.concatenate([faces, faces + len(vertices)])
        vertices, rgb = np.concatenate([vertices, size * vertices + shift]), np.concatenate([rgb, rgb])
    elif way == "twist":
        angle = draw(st.sampled_from([2, 20])) * vertices[:, 1]
        x, z = vertices[:, 0].copy(), vertices[:, 2].copy()
        vertices[:, 0], vertices[:, 2] = x * np.cos(angle) - z * np.sin(angle), x * np.sin(angle) + z * np.cos(angle)
    elif way in ("scale", "shift"):
        number = draw(st.sampled_from([1e-38, 1e-20, 1e-9, 1e6, 1e14, 1e30]))
        vertices = vertices * number if way == "scale" else vertices + number
    else:
        faces[rows] = pick.integers(0, len(vertices), (few, 3))
    return case.with_file(case.main, shape_file(vertices, faces, rgb))
