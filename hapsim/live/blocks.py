"""The binary blocks of the WebSocket: samples, and where watched modules are, as rows of little-endian Float32."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.recording.feed import Samples
from hapsim.running.state import State
from hapsim.scene.issue import did_you_mean

SAMPLES, MODULES = 1, 2
"""Kinds of a block."""
HEAD = struct.Struct("<IIIIdd")
"""Kind, rows, columns, channels, number of the first sample, sample period in s."""


def block_of(samples: Samples, period: float) -> bytes:
    """Returns a block with a row for each sample: [sample − first, flags, position × C, velocity × C, force × C].
    `period`: s between two samples."""
    first, channels = int(samples.sample[0]), samples.position.shape[1]
    rows = np.column_stack(
        [samples.sample - first, samples.flags, samples.position, samples.velocity, samples.force]
    ).astype("<f4")
    return HEAD.pack(SAMPLES, *rows.shape, channels, first, period) + rows.tobytes()


def thinned(samples: Samples, every: int, before: int) -> Samples:
    """Returns every n-th of the samples that follow `before` others."""
    if every == 1:
        return samples
    kept = slice(-before % every, None, every)
    return Samples(**{name: values[kept] for name, values in vars(samples).items()})


def modules_block(state: State, watched: Sequence[str], period: float) -> bytes:
    """Returns a block of one row: [0, position of each watched module in m]."""
    row = np.array([0.0, *(place_of(state, name) for name in watched)], "<f4")
    return HEAD.pack(MODULES, 1, row.size, len(state.position), state.sample, period) + row.tobytes()


def place_of(state: State, name: str) -> float:
    """Returns where a point is, or a structure's mass ("gut.7"), in m. Raises UsageError where there is none."""
    part, _, number = name.partition(".")
    place = state.modules.get(part)
    if isinstance(place, float) and not number:
        return place
    masses: NDArray[np.float64] | None = place if isinstance(place, np.ndarray) else None
    if masses is not None and number.isascii() and number.isdigit() and len(number) < 8 and int(number) < masses.size:
        return float(masses[int(number)])
    if masses is not None:
        raise UsageError(f"found '{name[:80]}', expected one of its masses, {part}.0 to {part}.{masses.size - 1}")
    raise UsageError(f"found '{name[:80]}', expected a point or a structure{did_you_mean(part, list(state.modules))}")
