"""The part of a batch that one of many machines does."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

from genmf_mi.core.errors import ConfigError

AUTO = "auto"
_ARRAYS = ("SLURM_ARRAY_TASK_ID", "AWS_BATCH_JOB_ARRAY_INDEX")


@dataclass(frozen=True)
class Shard:
    """The ``number``-th of ``count`` parts, counted from 1: the items ``number``, ``number + count`` ..."""

    number: int = 1
    count: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise ConfigError(
                f"there is no shard {self.number}/{self.count}: they are counted from 1/{self.count} to "
                f"{self.count}/{self.count}."
            )

    @property
    def file(self) -> str:
        """The name of the journal."""
        return "outcomes.jsonl" if self.count == 1 else f"outcomes-{self.number}-of-{self.count}.jsonl"

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


def shard_of(text: str, environment: Mapping[str, str] = os.environ) -> Shard:
    """The shard that ``3/64`` means, or ``auto`` in a job array of Slurm or AWS Batch; all for an empty text.

    Raises:
        ConfigError: something else, or there is no array.
    """
    if not text:
        return Shard()
    if text == AUTO:
        return _of_array(environment)
    if not (match := re.fullmatch(r"\s*(\d+)\s*/\s*(\d+)\s*", text)):
        raise ConfigError(f"--shard takes 3/64 for the third of 64, or auto in a job array, not {text!r}.")
    return Shard(int(match[1]), int(match[2]))


def in_array(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether this is one of the tasks of a job array."""
    return any(name in environment for name in _ARRAYS)


def _of_array(environment: Mapping[str, str]) -> Shard:
    def number(name: str) -> int:
        try:
            return int(environment[name])
        except (KeyError, ValueError):
            raise ConfigError(f"{name} is not set to a number here: give --shard 3/64.") from None

    if "SLURM_ARRAY_TASK_ID" in environment:
        first, last = number("SLURM_ARRAY_TASK_MIN"), number("SLURM_ARRAY_TASK_MAX")
        step = int(environment.get("SLURM_ARRAY_TASK_STEP", "1"))
        count = (last - first) // step + 1
        if "SLURM_ARRAY_TASK_COUNT" in environment and number("SLURM_ARRAY_TASK_COUNT") != count:
            raise ConfigError("the job array has gaps, and so would the batch: use --array 1-64, or give --shard 3/64.")
        return Shard((number("SLURM_ARRAY_TASK_ID") - first) // step + 1, count)
    if "AWS_BATCH_JOB_ARRAY_INDEX" in environment:
        return Shard(number("AWS_BATCH_JOB_ARRAY_INDEX") + 1, number("AWS_BATCH_JOB_ARRAY_SIZE"))
    raise ConfigError("--shard auto needs a job array of Slurm or AWS Batch around it. Give --shard 3/64.")
