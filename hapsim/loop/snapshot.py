"""A copy of the loop's state, made within a tick.

A hook makes the copy, the first one of its tick, when the position is read and no change is taken. It is among the
loop's hooks for one tick (posted.py), and compiled only where a record begins during a run. A tick itself reads about
as much memory as the copy.
"""

from __future__ import annotations

import numpy as np

from hapsim.compiling import fence
from hapsim.compiling.native import array_at, native, record_at
from hapsim.loop.hooks import HOOK, tick_at

SNAPSHOT = np.dtype(
    [
        ("blocks", np.uint64),  # address of (count, 3): where a block is, where its copy is, and its bytes
        ("count", np.int64),
        ("taken", np.int64),  # 1: the copies are complete,
        ("tick", np.int64),  # of this tick
        ("sample", np.int64),  # and this sample
    ],
    align=True,
)

_own_at, _words_at, _bytes_at = record_at(SNAPSHOT), array_at(np.int64), array_at(np.uint8)


@native(HOOK.return_type, *HOOK.args, bulk=True)
def copy_state(own, tick):
    """Copies every block, once."""
    own, tick = _own_at(own), tick_at(tick)
    if own.taken == 0:
        blocks = _words_at(own.blocks, 3 * own.count)
        for i in range(own.count):
            size = blocks[np.uint64(3 * i + 2)]
            source = _bytes_at(np.uint64(blocks[np.uint64(3 * i)]), size)
            target = _bytes_at(np.uint64(blocks[np.uint64(3 * i + 1)]), size)
            for j in range(np.uint64(size)):
                target[j] = source[j]
        own.tick, own.sample = tick.number, tick.sample
        fence()
        own.taken = 1
    return 0
