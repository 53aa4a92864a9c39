"""What can go wrong for a user, as types.

Every message is one or two plain sentences: what is wrong, and what to do next. The command line prints the message
alone and exits with ``exit_code``; a traceback is reserved for defects of this package.
"""


class GenmfError(Exception):
    """Base of all errors that are the input's or the machine's, not ours."""

    exit_code = 2


class AssetError(GenmfError):
    """The asset cannot be read, or holds nothing that can be refined."""


class SolidError(GenmfError):
    """The asset cannot be made into a closed manifold solid."""


class SceneError(GenmfError):
    """The scene file is unreadable or lacks what the refinement needs."""


class ConfigError(GenmfError):
    """A setting is out of range, or two settings contradict each other."""


class OutputError(GenmfError):
    """A result cannot be written, or would overwrite one that is there."""


class SetupError(GenmfError):
    """The machine lacks something: LLVM, a variant of Mitsuba, the LPIPS weights."""


class OptimisationError(GenmfError):
    """The optimisation cannot go on: its loss is not a finite number any more."""
