"""The binary blocks of the WebSocket: samples, and where watched modules are, as rows of little-endian Float32."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hapsim.recording.feed import Samples

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


def modules_block(glances: Sequence[tuple[int, NDArray[np.float64]]], channels: int, period: float) -> bytes:
    """Returns a block with a row for each glance at watched modules, a sample's number and (modules,) positions in m:
    [sample − first, position of each]."""
    first = glances[0][0]
    rows = np.array([[sample - first, *places] for sample, places in glances], "<f4")
    return HEAD.pack(MODULES, *rows.shape, channels, first, period) + rows.tobytes()
