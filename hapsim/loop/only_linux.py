"""What of hapsim takes Linux, asked before anything is compiled that calls the system: LLVM would end the process.

Nothing is guessed from the system's name: its C library has the calls of `system.py`, or it has not.
"""

from __future__ import annotations

import ctypes
import sys

from hapsim.errors import UsageError
from hapsim.loop.system import CALLS


def missing_calls() -> list[str]:
    """Those of the loop's system calls that this system does not have."""
    try:
        library = ctypes.CDLL(None)
    except (OSError, TypeError):  # Windows has no such library
        return list(CALLS)
    return [name for name in CALLS if not hasattr(library, name)]


def require_linux(what: str, instead: str) -> None:
    """UsageError where a call is missing. `what`: what takes Linux; `instead`: what there is elsewhere."""
    missing = missing_calls()
    if missing:
        raise UsageError(f"{what} takes Linux; this system ({sys.platform}) has no {', '.join(missing)}: {instead}")
