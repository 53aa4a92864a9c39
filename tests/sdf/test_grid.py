"""Operations on grids: rotations of all that lies on one, and what reaches its border."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
import torch
from generator_files import assert_same_points

from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.mesh import topology
from genmf_mi.sdf import grid
from genmf_mi.sdf.flexicubes import FlexiCubes

ROTATIONS = [
    np.eye(3, dtype=int)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
]


@pytest.mark.parametrize("sparse", [False, True])
def test_rotated_grids_give_the_rotated_surface(sparse):
    """All rotations and mirror images of a random grid; α and β go with their corners and edges."""
    random, n = np.random.default_rng(0), 5
    phi = np.ones((n + 1, n + 1, n + 1), np.float32)
    phi[1:-1, 1:-1, 1:-1] = random.random((n - 1, n - 1, n - 1)) - 0.45
    move = 0.1 * random.standard_normal((n + 1, n + 1, n + 1, 3)).astype(np.float32)
    weights, rows = random.standard_normal((n**3, 21)).astype(np.float32), None
    if sparse:
        rows, weights = random.permutation(n**3).astype(np.int32) - 25, weights[25:]

    def vertices(phi, move, weights, rows):
        extract = FlexiCubes(0.9, None if rows is None else torch.tensor(rows))
        return extract(*map(torch.tensor, (phi, move, weights)), training=False).vertices.double().numpy()

    original = vertices(phi, move, weights, rows)
    for rotation in ROTATIONS:
        found = vertices(*grid.rotated(rotation, phi, move, weights, rows))
        assert_same_points(found, original @ rotation.T, atol=3e-6)


def test_what_reaches_the_border_is_cut_off():
    ticks = np.linspace(-1, 1, 17)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    phi, report = grid.sealed(grid.outside_positive(np.maximum(np.hypot(x, y) - 0.3, z - 0.5), "rod"))
    assert report["samples_cut_off"] > 0 and report["samples_filled"] == 0
    assert topology.is_closed(SdfAsset("rod", grid.scaled(phi)).surface()[1])
