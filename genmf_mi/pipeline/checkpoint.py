"""All that the next iteration depends on, in memory and as a file."""

from __future__ import annotations

import copy
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor

from genmf_mi.core.errors import OutputError
from genmf_mi.core.files import atomic
from genmf_mi.geometry.uniform_adam import UniformAdam


@dataclass(frozen=True)
class Checkpoint:
    """The state of an optimisation between two iterations; tensors are copies.

    iteration: the number of iterations made. parameters: of the surface.
    optimiser: ``state_dict`` of :class:`genmf_mi.geometry.uniform_adam.UniformAdam`.
    stress: ``state_dict`` of :class:`genmf_mi.pipeline.stress_stage.StressStage`.
    stage_one: the state at the end of stage one, once stage two has begun.
    """

    iteration: int
    parameters: tuple[Tensor, ...]
    optimiser: dict[str, Any]
    stress: dict[str, Any]
    stage_one: Checkpoint | None = None

    @classmethod
    def of(
        cls,
        iteration: int,
        parameters: tuple[Tensor, ...],
        optimiser: UniformAdam,
        stress: dict[str, Any],
        stage_one: Checkpoint | None = None,
    ) -> Checkpoint:
        """Copy the current state."""
        copies = tuple(p.detach().cpu().clone() for p in parameters)
        return cls(iteration, copies, copy.deepcopy(optimiser.state_dict()), copy.deepcopy(stress), stage_one)

    def save(self, path: Path) -> None:
        """Write the checkpoint, whole or not at all. Raises :class:`OutputError`."""
        with atomic(path) as temporary, temporary.open("wb") as file:
            torch.save(asdict(self), file)

    @classmethod
    def load(cls, path: Path) -> Checkpoint:
        """Read what :meth:`save` wrote; the file cannot run code.

        Raises:
            OutputError: missing or damaged.
        """
        try:
            return cls._from_dict(torch.load(path, map_location="cpu", weights_only=True))
        except Exception as error:  # damaged files make the reader raise anything at all
            raise OutputError(f"the checkpoint in {path.parent} is damaged. Start again with --force.") from error

    @classmethod
    def _from_dict(cls, values: Any) -> Checkpoint:
        """``values`` as :meth:`save` wrote them, or whatever else a file may hold."""
        if not isinstance(values, dict):
            raise TypeError("not a checkpoint")
        content = cast(dict[str, Any], values)
        if not (isinstance(content["iteration"], int) and isinstance(content["optimiser"], dict)):
            raise TypeError("not a checkpoint")
        if not all(bool(torch.isfinite(parameter).all()) for parameter in content["parameters"]):
            raise ValueError("values that are not numbers")
        stage_one = content["stage_one"]
        content["stage_one"] = None if stage_one is None else cls._from_dict(stage_one)
        return cls(**content)
