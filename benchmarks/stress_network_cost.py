"""CPU seconds of one pass of the stress network, for the published architecture and for others that were tried."""

from __future__ import annotations

import torch

from benchmarks import record
from benchmarks.inputs import Inputs
from benchmarks.record import cpu_seconds
from genmf_mi.core.memory import peak_gb
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.model import compute
from genmf_mi.stress.model.network import PRESETS, Architecture, StressNetwork

FULL, MEAN = (128, 128, 128), (128, 96, 80)
"""The largest crop at 129³, and about the mean one of the data set."""
VARIANTS = (
    ("compact", PRESETS["compact"], FULL, True),
    ("compact", PRESETS["compact"], FULL, False),
    ("compact", PRESETS["compact"], MEAN, True),
    ("compact", PRESETS["compact"], MEAN, False),
    ("direct", PRESETS["direct"], MEAN, True),
    ("narrower, C = 16", Architecture(16, block_size=2), MEAN, True),
    ("wider, C = 32", Architecture(32, block_size=2), MEAN, True),
    ("three poolings", Architecture(24, block_size=2, poolings=3), MEAN, True),
    ("no blocks, C = 8", Architecture(8), MEAN, True),
)
"""Name, architecture, samples of Φ, and whether to compute in bfloat16 where the processor has it."""


def main(inputs: Inputs, *, threads: int = 1) -> None:
    """Time a forward pass, a training pass and a refinement pass of each variant.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
        threads: Of the CPU; part of the name of the result file.
    """
    torch.set_num_threads(threads)
    has_bfloat16 = compute.bfloat16_on(torch.device("cpu"))
    rows = []
    for name, architecture, shape, bfloat16 in VARIANTS:
        rows.append({"network": name, **row(architecture, shape, bfloat16 and has_bfloat16)})
        print(rows[-1], flush=True)
    record.write(f"stress_network_cost_{threads}", rows)


def row(architecture: Architecture, shape: tuple[int, int, int], bfloat16: bool) -> dict:
    """CPU seconds of a forward pass, with the backward pass to the weights, and to Φ."""
    network = StressNetwork(architecture)
    phi = 0.1 * torch.randn(1, 1, *shape)
    # The time of the coarse solve is not included
    coarse = torch.rand(1, 1, *shape) if architecture.coarse_mm else None

    def forward_and_backward() -> None:
        compute.log_stress(network, phi, bfloat16, coarse, Settings()).mean().backward()

    @torch.no_grad()
    def forward() -> None:
        compute.log_stress(network, phi, bfloat16, coarse, Settings())

    result = {
        "parameters": sum(p.numel() for p in network.parameters()),
        "window": list(shape),
        "bfloat16": bfloat16,
        "forward": cpu_seconds(forward, 2, warm_up=True),
        "training": cpu_seconds(forward_and_backward, 2, warm_up=True),
    }
    network.requires_grad_(False)
    phi.requires_grad_()
    return {**result, "refinement": cpu_seconds(forward_and_backward, 2, warm_up=True), "peak_gb": round(peak_gb(), 2)}
