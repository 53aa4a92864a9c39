"""Signed-distance fields on grids: noise, and shapes whose distance is known. Points are ``[...,3]``."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from genmf_mi.sdf.flexicubes import WEIGHTS


def grid(m: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """Sample positions ``[m,m,m,3]``."""
    ticks = torch.linspace(-1, 1, m, dtype=dtype)
    return torch.stack(torch.meshgrid(ticks, ticks, ticks, indexing="ij"), dim=-1)


def random_field(m: int, seed: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """Noise with a share of negative samples that differs by seed, positive on the border."""
    generator = torch.Generator().manual_seed(seed)
    phi = torch.ones(m, m, m, dtype=dtype)
    share = 0.2 + 0.6 * torch.rand((), generator=generator)
    phi[1:-1, 1:-1, 1:-1] = torch.rand(m - 2, m - 2, m - 2, generator=generator, dtype=dtype) - share
    return phi


def random_weights(m: int, seed: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return torch.randn((m - 1) ** 3, WEIGHTS, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def ball(p):
    return p.norm(dim=-1) - 0.7


def torus(p):
    return ((p[..., [0, 2]].norm(dim=-1) - 0.55).square() + p[..., 1].square()).sqrt() - 0.25


TURN = torch.as_tensor(Rotation.from_euler("xyz", [25, 37, 14], degrees=True).as_matrix(), dtype=torch.float32)
HALF = torch.tensor([0.62, 0.45, 0.53])


def box(p):
    """A rotated box, exact."""
    q = (p @ TURN.to(p)).abs() - HALF.to(p)
    return q.clamp_min(0).norm(dim=-1) + q.amax(dim=-1).clamp_max(0)


def gyroid(p):
    """A gyroid cut by a ball; about a distance near the surface."""
    a, b, c = (7 * p).unbind(-1)
    wave = a.sin() * b.cos() + b.sin() * c.cos() + c.sin() * a.cos()
    return torch.maximum(wave / 9, p.norm(dim=-1) - 0.8)


VOLUMES = {ball: 4 / 3 * np.pi * 0.7**3, torus: 2 * np.pi**2 * 0.55 * 0.25**2, box: 8 * float(HALF.prod())}
