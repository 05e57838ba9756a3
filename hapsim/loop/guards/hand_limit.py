"""The limit of hands in the plane: one factor brings x and y within the force limit, so that clipping does not turn the
force. The exchange has clipped each channel by itself, as a device does."""

from __future__ import annotations

from typing import Any

import numpy as np

from hapsim.compiling.native import record_at
from hapsim.loop.buffers import clip, share_within_limit
from hapsim.loop.hooks import Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.ring import LIMITED

HAND_LIMIT = np.dtype([("limited", np.int64)], align=True)
"""Ticks in which it changed a force."""

_limit_at = record_at(HAND_LIMIT)


@hook
def limit_hands(limit, tick):
    """Limits the scene's force and excitation of each hand by one factor."""
    limit, tick = _limit_at(limit), tick_at(tick)
    io = io_at(tick.io)
    for c in range(io.channels if tick.withheld == 0 else 0):
        share = share_within_limit(io, c, True)
        if share < 1.0:
            force = clip((io.asked[c] + io.excitation[c]) * share, io.force_limit[c])
            io.force_counts[c] = np.int64(np.rint(force / io.force_scale[c]))
            tick.flags |= LIMITED
    limit.limited += tick.flags & LIMITED != 0
    return 0


def _set_up(loop: Any, setting: Setting) -> Any:
    return loop.hand_limit if any(len(hand) > 1 for hand in setting.scene.channel_groups) else None


GUARD = Guard("hand_limit", HAND_LIMIT, {Stage.LOWER: limit_hands}, _set_up)
