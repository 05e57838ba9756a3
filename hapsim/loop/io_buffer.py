"""What one exchange reads and writes, channel by channel."""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from firmware_protocol.frames import ROOM
from hapsim.loop.last_bytes import KEPT, LAST_BYTES
from hapsim.loop.system import SCRATCH

_EACH = (schema.MAX_CHANNELS,)

IO_BUFFER = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("channels", np.int64),  # of the device; of what follows, so many are in use
        ("velocities", np.int64),  # 1: they are on the wire
        ("measured", np.float64, _EACH),  # m, the newest position, or what a predictor puts in its place
        ("before", np.float64, _EACH),  # m, the one before
        ("bridge", np.float64, _EACH),  # m, between the two where positions were lost
        ("velocity", np.float64, _EACH),  # m/s, sensed with it, or predicted; 0 where neither
        ("velocity_before", np.float64, _EACH),  # m/s, with the one before
        ("velocity_bridge", np.float64, _EACH),  # m/s, between the two where positions were lost
        ("asked", np.float64, _EACH),  # N, the scene's force
        ("as_hand", np.float64, _EACH),  # N, what an excitation that plays the hand adds to it
        ("excitation", np.float64, _EACH),  # N, all that is added to it: a push, or what plays the hand
        ("position_counts", np.int64, _EACH),  # from the scene's origin on
        ("origin_counts", np.int64, _EACH),  # which of the device's positions that is,
        ("origin_at_arming", np.int64, _EACH),  # or 1: the first one
        ("force_counts", np.int64, _EACH),  # what excitation and guards make of it
        ("position_scale", np.float64, _EACH),  # m per count
        ("velocity_scale", np.float64, _EACH),  # (m/s) per count
        ("force_scale", np.float64, _EACH),  # N per count
        ("force_limit", np.float64, _EACH),  # N
        SCRATCH,
        ("sent", LAST_BYTES),
        ("outbox", np.uint8, (KEPT + ROOM,)),  # the frame that is being written, and those before
    ],
    align=True,
)
