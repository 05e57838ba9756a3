"""The binary messages of the WebSocket: blocks with rows of little-endian Float32."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.recording.recorder import Samples

SAMPLES, MODULES, PICTURE = 1, 2, 3
"""Kinds of a block."""
HEAD = struct.Struct("<IIIIdd")
"""Kind, rows, columns, channels, number of the first sample, sample period in s."""


def block_of(samples: Samples, period: float) -> bytes:
    """Returns a block with a row for each sample: [sample − first, flags, position × C, velocity × C, force × C, what
    is sensed × C, and each input and output]. `period`: s between two samples."""
    first, channels = int(samples.sample[0]), samples.position.shape[1]
    moved = samples.position, samples.velocity, samples.force, samples.sensed
    rows = np.column_stack([samples.sample - first, samples.flags, *moved, samples.words])
    return _block(SAMPLES, rows, channels, first, period)


def thinned(samples: Samples, every: int, before: int) -> Samples:
    """Returns every n-th of the samples that follow `before` others."""
    if every == 1:
        return samples
    kept = slice(-before % every, None, every)
    return Samples(**{name: values[kept] for name, values in vars(samples).items()})


def modules_block(
    glances: Sequence[tuple[int, NDArray[np.floating[Any]]]], channels: int, period: float, kind: int = MODULES
) -> bytes:
    """Returns a block with a row for each glance, a sample's number and numbers: [sample − first, each of them]. They
    are the positions of the watched modules in m, or those of `Picture.row`."""
    first = glances[0][0]
    rows = [np.concatenate([[sample - first], numbers]) for sample, numbers in glances]
    return _block(kind, rows, channels, first, period)


def _block(kind: int, rows: Any, channels: int, first: int, period: float) -> bytes:
    values = np.asarray(rows, "<f4")
    return HEAD.pack(kind, *values.shape, channels, first, period) + values.tobytes()
