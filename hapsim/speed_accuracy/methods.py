"""What a scene can be simulated by: the schemes that it may name, and how long its numbers are."""

from __future__ import annotations

from hapsim.cordis.schemes import SCHEMES

PRECISIONS = ("double", "single")


def schemes() -> tuple[str, ...]:
    """The schemes for simulated masses."""
    return tuple(SCHEMES)
