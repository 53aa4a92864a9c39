"""The check of types and shapes that conftest.py puts on every function of some packages."""

from __future__ import annotations

from beartype import BeartypeConf, beartype

check = beartype(conf=BeartypeConf(is_pep484_tower=True))  # an int may stand for a float, as type checkers have it
