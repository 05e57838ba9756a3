"""No search for garbage while the loop runs: it takes tens of milliseconds, in which no other Python runs."""

from __future__ import annotations

import gc
from collections.abc import Callable

from hapsim.loop.realtime.privilege import measure


def _advise(error: OSError) -> str:
    return f"the garbage collector failed ({error.strerror})"


@measure("garbage collector frozen", _advise, everywhere=True)
def frozen(_thread_id: int) -> tuple[str, Callable[[], object]]:
    """Collects once, then sets what is left aside and switches collecting off. References still free what they hold."""
    was_enabled, was_frozen = gc.isenabled(), gc.get_freeze_count() > 0
    gc.collect()
    # Thawing knows no share: what somebody froze before stays as it is, and nothing is added to it.
    if not was_frozen:
        gc.freeze()
    gc.disable()

    def undo() -> None:
        if not was_frozen:
            gc.unfreeze()
        if was_enabled:
            gc.enable()

    return f"{gc.get_freeze_count()} objects set aside, no collection", undo
