"""What a scene can be simulated by: the schemes that it may name, and how long its numbers are."""

from __future__ import annotations

from collections.abc import Iterable

from hapsim.cordis.schemes import SCHEMES
from hapsim.errors import UsageError

PRECISIONS = ("double", "single")


def schemes() -> tuple[str, ...]:
    """The schemes for simulated masses."""
    return tuple(SCHEMES)


def schemes_named(names: Iterable[str]) -> list[str]:
    """Those of these names, in their own order; none where there is no name. UsageError for another name."""
    wanted = set(names)
    for name in sorted(wanted - SCHEMES.keys()):
        raise UsageError(f"--scheme: found '{name}', expected one of {', '.join(SCHEMES)}")
    return [name for name in SCHEMES if name in wanted]
