"""The ring of a scene's sound: frames with a value per channel, one for each step of the modules.

The loop writes the ring and waits for none of its readers. Each reader counts its own frames. In virtual time the loop
returns instead, until the reader that writes a file has made room, so that no frame is ever lost.

Each channel passes a high-pass, y[n] = r (y[n-1] + x[n] - x[n-1]), r = exp(-2 pi f T) for steps of T, and then a soft
clip: values up to KNEE stay as they are, larger ones approach 1 smoothly, and are counted.

All steps of a sample come at once, so a reader on the device's clock needs the time of the last frame. `publish` shows
count and time together, under a version that is odd while they change.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import fence, inlined
from hapsim.compiling.native import array_at, native, record_at
from hapsim.cordis.dispatch import ADD_FRAME
from hapsim.scene.sound_channels import MOST_PICK_UPS

KNEE = 0.75

_EACH = (MOST_PICK_UPS,)

SOUND_RING = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("frames", np.uint64),  # address of (capacity, channels) float32
        ("capacity", np.int64),  # a power of two; 0: the scene has no sound
        ("channels", np.int64),
        ("written", np.int64),  # frames that a reader may see,
        ("time_ns", np.int64),  # arrival of the position of the last of them
        ("version", np.int64),  # odd while these two change
        ("pushed", np.int64),  # frames, with those not yet published
        ("clipped", np.int64),  # values that the soft clip changed
        ("keeps", np.float64, _EACH),  # r
        ("last", np.float64, _EACH),  # x[n-1]
        ("passed", np.float64, _EACH),  # y[n-1]
        ("frame", np.float64, _EACH),  # the newest frame
        ("peak", np.float64, _EACH),  # the largest absolute value before the clip
        ("waits", np.int64),  # 1: the loop returns when it is half full of frames that are not `read` (virtual time)
        ("read", np.int64),  # frames that this reader has taken
    ],
    align=True,
)

_ring_at, _doubles_at, _floats_at = record_at(SOUND_RING), array_at(np.float64), array_at(np.float32)


class SoundRing:
    """The memory of a ring, and a reader of every frame."""

    def __init__(self, record: Any, channels: int, capacity: int, waits: bool = False) -> None:
        """Makes an empty ring in `record`, a SOUND_RING. `capacity`: in frames, a power of two."""
        self.record = record
        self._frames = np.zeros((capacity, channels), np.float32)
        self._frames.fill(0)  # so that the loop causes no page fault
        record.address = record.__array_interface__["data"][0]
        record.frames = self._frames.ctypes.data
        record.capacity, record.channels = self._frames.shape
        record.waits = waits
        self.lost = 0
        """Frames that were overwritten before `drain` took them."""

    def drain(self) -> NDArray[np.float32]:
        """Returns the frames since the last call, (frames, channels), without lost ones."""
        capacity, begin, end = len(self._frames), int(self.record.read), int(self.record.written)
        begin = max(begin, end - capacity)
        frames: NDArray[np.float32] = self._frames[np.arange(begin, end) & (capacity - 1)]
        # Meanwhile the loop may have overwritten the oldest of them, and may be writing the next.
        torn = max(0, int(self.record.pushed) + 1 - capacity - begin)
        frames = frames[torn:]
        self.lost += end - int(self.record.read) - len(frames)
        self.record.read = end
        return frames


@native(ADD_FRAME.return_type, *ADD_FRAME.args)
def add_frame(ring, pick_up_values, other, weight):
    """Adds a frame of a step's pick-up values, at an address. During a crossfade `other` is the address of another
    program's values, and `weight` their share; else `other` is 0."""
    ring = _ring_at(ring)
    values, others = (
        _doubles_at(pick_up_values, ring.channels),
        _doubles_at(pick_up_values if other == 0 else other, ring.channels),
    )
    for c in range(np.uint64(ring.channels)):
        x = values[c] + weight * (others[c] - values[c])
        if not math.isfinite(x):
            x = 0.0  # the scene diverges, and a guard will end the run
        if ring.keeps[c] < 1.0:
            passed = ring.keeps[c] * (ring.passed[c] + x - ring.last[c])
            ring.last[c] = x
            x = ring.passed[c] = passed if math.isfinite(passed) else 0.0
        size = abs(x)
        ring.peak[c] = max(ring.peak[c], size)
        if size > KNEE:
            ring.clipped += 1
            beyond = (size - KNEE) / (1.0 - KNEE)
            x = math.copysign(1.0 - (1.0 - KNEE) / (1.0 + beyond), x)  # 1 even where `beyond` is infinite
        ring.frame[c] = x
    push(ring, ring.frame)


@inlined
def push(ring, frame):
    """Writes a frame, an array or a tuple of a value per channel, invisible to readers before `publish`."""
    channels = np.uint64(ring.channels)
    place = np.uint64(ring.frames) + np.uint64(4) * channels * np.uint64(ring.pushed & (ring.capacity - 1))
    values = _floats_at(place, ring.channels)
    for c in range(channels):
        values[c] = frame[c]
    ring.pushed += 1


@inlined
def publish(ring, time_ns):
    """Makes the pushed frames visible to the readers. `time_ns`: arrival of the position of the last frame."""
    if ring.pushed == ring.written:
        return
    ring.version += 1
    fence()
    ring.time_ns = time_ns
    ring.written = ring.pushed
    fence()
    ring.version += 1
