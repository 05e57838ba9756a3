"""What an object of the comparison is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from hapsim.scene import Scene


@dataclass(frozen=True)
class Found:
    """What came of a run: how far each quantity is off, relative to the continuous object, with its sign.

    `why_not`: in words, where there is none.
    """

    errors: dict[str, float]
    why_not: str = ""


class Object(Protocol):
    """Something with a closed form in continuous time, that hapsim simulates."""

    name: str
    """As the command's option has it."""
    title: str
    """As a picture has it."""
    quantities: tuple[str, ...]
    """What can be off."""

    def methods(self) -> tuple[str, ...]:
        """By what it is simulated."""

    def scene(self, method: str, precision: str, rate: float) -> Scene:
        """What is timed: rate in Hz."""

    def found(self, method: str, precision: str, rate: float) -> Found:
        """Runs it."""
