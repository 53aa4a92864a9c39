"""Arrays as InstantMesh and TRELLIS write them, of one figure whose distance is known, and what they should give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file
from scipy.spatial import KDTree

from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.mesh import measures, topology
from genmf_mi.sdf.flexicubes import FlexiCubes

HALF = np.array([0.2, 0.4, 0.3])
NOSE = np.array([0.1, 0.2, 0.35])


def figure(p: np.ndarray) -> np.ndarray:
    """Distance bound of a tall box with a nose in front (+z), above the middle and to the right; y up, file units."""
    q = np.abs(p) - HALF
    box = np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0)
    return np.minimum(box, np.linalg.norm(p - NOSE, axis=-1) - 0.12)


def check_figure(shape: SdfAsset, cell: float) -> None:
    """That ``shape`` is the figure: closed, in the right frame, at the right size, and its Φ about a distance."""
    vertices, faces = shape.surface()
    assert topology.is_closed(faces) and measures.signed_volume(vertices, faces) > 0
    assert np.abs(figure(vertices)).max() < 1.5 * cell
    np.testing.assert_allclose(vertices.min(axis=0), -HALF, atol=1.5 * cell)
    np.testing.assert_allclose(vertices.max(axis=0), [0.22, 0.4, 0.47], atol=1.5 * cell)
    step = 2 / shape.resolution
    around = np.argwhere(np.abs(shape.phi) < 3 * step)
    exact = figure(shape.restore(step * around - 1)) / shape.half
    near = np.abs(exact) < 1.5 * step
    assert near.sum() > 300
    assert np.median(shape.phi[tuple(around[near].T)] / exact[near]) == pytest.approx(1, abs=0.15)


def assert_same_points(found: np.ndarray, expected: np.ndarray, atol: float) -> None:
    """That both are the same points in any order."""
    assert len(found) == len(expected)
    distance, partner = KDTree(expected).query(found)
    assert distance.max() < atol and len(np.unique(partner)) == len(expected)


def write(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    """As a generator's user would, with the writer that the suffix asks for."""
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    elif path.suffix == ".safetensors":
        save_file({key: np.ascontiguousarray(array) for key, array in arrays.items()}, path)
    else:
        torch.save({key: torch.as_tensor(array) for key, array in arrays.items()}, path)
    return path


def of_instantmesh(n: int = 24, sign: float = -5.0, seed: int = 0) -> dict[str, np.ndarray]:
    """Raw outputs with InstantMesh's shapes: z up, the front along +x, the side of the grid 2.1, no metric scale.

    sign: -5 is a field that is positive inside.
    """
    random = np.random.default_rng(seed)
    ticks = (np.arange(n + 1) / n - 0.5) * 2.1
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    sdf = sign * figure(np.stack([y, z, x], axis=-1))
    return {
        "sdf": sdf.reshape(1, -1, 1).astype(np.float32),
        "deformation": random.standard_normal((1, (n + 1) ** 3, 3), dtype=np.float32),
        "weights": 0.1 * random.standard_normal((1, n**3, 21), dtype=np.float32),
    }


def instantmesh_mesh(arrays: dict[str, np.ndarray], n: int) -> np.ndarray:
    """Vertices as InstantMesh's application would write them: its own steps, in its own frame, then y up."""
    m = n + 1
    phi = torch.tensor(arrays["sdf"].reshape(m, m, m))
    phi = -phi if phi[0, 0, 0] < 0 else phi
    move = torch.tanh(torch.tensor(arrays["deformation"].reshape(m, m, m, 3))) / (n * 4)
    made = FlexiCubes(0.5)(phi, move / 1.05, torch.tensor(arrays["weights"][0]), training=False)
    return (made.vertices.numpy() * 1.05)[:, [1, 2, 0]]


def of_trellis(n: int = 64, painted: bool = True, seed: int = 0, band: float = 3) -> dict[str, np.ndarray]:
    """Sparse cubes with TRELLIS's layout: z up, the grid ± 1/2, the inside of the body unknown, the bias not yet added.

    Cubes that share a corner disagree about it by noise whose mean is zero only over all of them.
    """
    random = np.random.default_rng(seed)
    corner = np.array([[c & 1, c >> 1 & 1, c >> 2] for c in range(8)])
    ticks = (np.arange(n) + 0.5) / n - 0.5
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    coords = np.argwhere(np.abs(figure(np.stack([x, z, -y], axis=-1))) < band / n)
    place = (coords[:, None] + corner) / n - 0.5
    upright = np.stack([place[..., 0], place[..., 2], -place[..., 1]], axis=-1)
    sdf = figure(upright) + 1 / n + 0.02 / n * random.standard_normal((len(coords), 8))
    parts = [sdf, random.standard_normal((len(coords), 24)), 0.5 * random.standard_normal((len(coords), 21))]
    if painted:
        colours = np.zeros((len(coords), 8, 6))
        colours[..., 0], colours[..., 1] = 4 * upright[..., 1], -2
        parts.append(colours.reshape(len(coords), 48))
    return {"coords": coords.astype(np.int32), "feats": np.concatenate(parts, axis=1).astype(np.float32)}


def trellis_mesh(arrays: dict[str, np.ndarray], n: int) -> np.ndarray:
    """Vertices of the extractor's own steps, cube by cube, turned upright; the inside is filled beforehand."""
    m = n + 1
    total, count = np.zeros((m, m, m, 4)), np.zeros((m, m, m, 1))
    weights = np.zeros((n, n, n, 21), np.float32)
    for coord, feat in zip(arrays["coords"], arrays["feats"], strict=True):
        for c in range(8):
            at = tuple(coord + np.array([c & 1, c >> 1 & 1, c >> 2]))
            total[at] += [feat[c], *feat[8 + 3 * c : 11 + 3 * c]]
            count[at] += 1
        weights[tuple(coord)] = feat[32:53]
    mean = total / np.maximum(count, 1)
    place = np.stack(np.meshgrid(*[np.arange(m) / n - 0.5] * 3, indexing="ij"), axis=-1)
    far = figure(np.stack([place[..., 0], place[..., 2], -place[..., 1]], axis=-1))
    phi = np.where(count[..., 0] > 0, mean[..., 0] - 1 / n, np.sign(far))
    move = 0.5 / n * np.tanh(mean[..., 1:]) * 2
    made = FlexiCubes(0.99)(*(torch.tensor(x, dtype=torch.float32) for x in (phi, move)),
                            torch.tensor(weights.reshape(-1, 21)), training=False)  # fmt: skip
    vertices = made.vertices.numpy() / 2
    return np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1)
