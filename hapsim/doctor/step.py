"""How far an examination is, told to whoever shows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Tell = Callable[[float, str], None]
"""Told how long (s) one measurement runs by now, and the name of a function that is being compiled for it, or ""."""


@dataclass(frozen=True)
class Step:
    """One measurement of an examination."""

    number: int
    """From 1 on."""
    of: int
    what: str
    """In words: wake-ups at 4 kHz."""
    elapsed_s: float
    seconds: float
    """How long it takes in all."""
    compiling: str
    """The function that is being compiled before it begins, or ""."""
