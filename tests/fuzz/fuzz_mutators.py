"""Damaged inputs as Hypothesis strategies, and a number of them that is the same for the same seed."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from unittest.mock import patch

import fuzz_kinds
import fuzz_shapes
from fuzz_edits import Draw
from fuzz_seeds import Case, seeds
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st
from hypothesis.internal.conjecture import providers
from hypothesis.internal.constants_ast import Constants

_STRUCTURE: dict[str, Callable[[Draw, Case], Case]] = {
    "glb": fuzz_kinds.glb, "gltf": fuzz_kinds.gltf, "obj": fuzz_kinds.obj, "ply": fuzz_kinds.ply,
    "stl": fuzz_kinds.stl, "3mf": fuzz_kinds.threemf, "npz": fuzz_kinds.npz, "safetensors": fuzz_kinds.safetensors,
    "pt": fuzz_kinds.pt, "image": fuzz_kinds.image, "run": fuzz_kinds.run, "scene": fuzz_kinds.scene,
    "shape": fuzz_shapes.shape,
}  # fmt: skip


def mutated(kind: str) -> st.SearchStrategy[Case]:
    """Damaged inputs of one kind; some are left as they are."""

    @st.composite
    def cases(draw: Draw) -> Case:
        case = draw(st.sampled_from(seeds(kind)))
        for _ in range(draw(st.sampled_from([0, 1, 1, 1, 1, 1, 2, 3]))):
            ways = [fuzz_kinds.bytes_of_any] * (kind != "shape") + [_STRUCTURE[kind]] * 4
            case = draw(st.sampled_from(ways))(draw, case)
        return case

    return cases()


@cache
def inputs(kind: str, seed: int, count: int) -> tuple[Case, ...]:
    """``count`` inputs of one kind, the same ones for the same ``seed``."""
    made: list[Case] = []

    @seeded(seed)
    @settings(max_examples=count, database=None, deadline=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(mutated(kind))
    def collect(case: Case) -> None:
        made.append(case)

    # Hypothesis would mix in constants of the code under test, and a seed mean other inputs after every change to it
    with patch.object(providers, "_get_local_constants", Constants):
        collect()
    return tuple(made[:count])
