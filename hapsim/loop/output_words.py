"""The digital word that goes out with every force: bits that programs set, and bits that hooks of the loop set.

A hook of stage ADD that writes `events` comes before `compose_outputs`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hapsim.compiling.native import record_at
from hapsim.loop.hooks import Hook, Stage, hook, io_at, tick_at

WORDS_STATE = np.dtype(
    [
        ("set", np.int64),  # bits of the outputs that programs set; a change comes through the mailbox
        ("events", np.int64),  # bits of the outputs that follow the scene,
        ("slot", np.uint64),  # which is that of the SCENE_SLOT at this address
    ],
    align=True,
)

_own_at = record_at(WORDS_STATE)


@hook
def compose_outputs(own, tick):
    """Sets the outputs of this tick."""
    own = _own_at(own)
    io_at(tick_at(tick).io).outputs = own.set | own.events
    return 0


def words_hook(record: Any) -> Hook:
    """Returns the hook of WORDS_STATE, for scenes with digital words."""
    return Hook(Stage.ADD, compose_outputs, record)
