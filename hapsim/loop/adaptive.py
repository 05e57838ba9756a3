"""A force that follows the mass of the temporary hybrid system, which `loop/mass_estimate.py` estimates while it runs:
no faster than by a factor e in SLEW_S.

For which masses there is something to simulate, and that it is stable for all of them, is worked out before
(`prediction/correction/adaptive.py`) and comes as a table. Who adapts nothing never compiles this.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.records import new_record
from hapsim.compiling import entry, helper
from hapsim.compiling.memory_fence import fence
from hapsim.compiling.native import address_of, array_at, native, record_at
from hapsim.loop.io_buffer import IO_BUFFER
from hapsim.loop.mass_estimate import (
    MASS_ESTIMATE,
    estimate_mass,
    fill_channel,
    fill_mass_estimate,
    note_sample,
    span_of,
    take_spans,
)
from hapsim.loop.predictor import ADD, PREDICT, PREDICTOR, keep_forces, predict_state

SLEW_S, LEAST_SLEW = 0.05, 25  # s, samples: for a factor e of the mass
_LEAST_STIFFNESS = 1e-9  # N/m: of a loop that hardly swings

_EACH = (schema.MAX_CHANNELS,)

ADAPTIVE = np.dtype(
    [
        ("table", np.uint64),  # address of (channels, rows, 3 + 2 (2 + lags)): dK, dB, dK rest; then the weights
        ("before", np.uint64),  # of the one before it, while one follows the other
        ("posted", np.uint64),  # of one that shall follow; 0: none
        ("posted_samples", np.int64),
        ("samples", np.int64),  # in so many
        ("left", np.int64),  # samples until the one before is left
        ("rows", np.int64),
        ("adapts", np.int64, _EACH),  # 1: this channel's force follows an estimate
        ("log_least", np.float64, _EACH),  # of the span, ln kg
        ("log_most", np.float64, _EACH),
        ("log_mass", np.float64, _EACH),  # for which the force is now
        ("dK", np.float64, _EACH),  # N/m, N·s/m and N: what comes to the scene's force now
        ("dB", np.float64, _EACH),
        ("dF", np.float64, _EACH),
        ("slew", np.float64),  # of ln m in a sample, at most
        ("estimate", MASS_ESTIMATE),
    ],
    align=True,
)

_predictor_at, _io_at, _doubles_at = record_at(PREDICTOR), record_at(IO_BUFFER), array_at(np.float64)
_adaptive_at = record_at(ADAPTIVE)
_ROW = schema.MAX_CHANNELS


@native(PREDICT.return_type, *PREDICT.args)
def predict_adaptively(predictor, io, gap, late, age):
    """As `predict`, with the weights for the mass that is estimated."""
    predictor, io = _predictor_at(predictor), _io_at(io)
    adaptive = _adaptive_at(predictor.adaptive)
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * 2 * _ROW)
    if predictor.begun:
        keep_forces(predictor, io, forces, gap, late, age)
    _take_posted(adaptive)
    note_sample(adaptive.estimate, gap, late)
    for c in range(io.channels):
        if adaptive.adapts[c]:
            _follow(adaptive, estimate_mass(adaptive.estimate, predictor, forces, c, io.measured[c]), c)
            _set_weights(adaptive, predictor, c)
    if adaptive.left > 0:
        adaptive.left -= 1
    predict_state(predictor, io, forces, gap)


@native(ADD.return_type, *ADD.args)
def add_difference(predictor, io):
    """What comes to the scene's force, since the scene's links are those for the least mass."""
    predictor, io = _predictor_at(predictor), _io_at(io)
    adaptive = _adaptive_at(predictor.adaptive)
    for c in range(io.channels):
        if adaptive.adapts[c]:
            io.asked[c] += adaptive.dF[c] - adaptive.dK[c] * io.measured[c] - adaptive.dB[c] * io.velocity[c]


@helper
def _take_posted(adaptive):
    if adaptive.posted != 0 and adaptive.left == 0:
        adaptive.before, adaptive.table = adaptive.table, adaptive.posted
        adaptive.samples = adaptive.left = adaptive.posted_samples
        fence()
        take_spans(adaptive.estimate)
        adaptive.posted = np.uint64(0)


@helper
def _follow(adaptive, log_mass, c):
    """The mass that the force is for goes to the one that is estimated."""
    step = log_mass - adaptive.log_mass[c]
    adaptive.log_mass[c] += min(max(step, -adaptive.slew), adaptive.slew)


@helper
def _set_weights(adaptive, predictor, c):
    """From the table: between the two rows, and, while one table follows another, between the two tables."""
    width = 2 + predictor.lags
    row_width = 3 + 2 * width
    size = _ROW * adaptive.rows * row_width
    table, before = _doubles_at(adaptive.table, size), _doubles_at(adaptive.before, size)
    s = 1.0 - adaptive.left / adaptive.samples
    newer = s * s * (3.0 - 2.0 * s)
    span = adaptive.log_most[c] - adaptive.log_least[c]
    at = (adaptive.log_mass[c] - adaptive.log_least[c]) / span * (adaptive.rows - 1)
    row = min(np.int64(at), adaptive.rows - 2)
    share = at - row
    first = (c * adaptive.rows + row) * row_width
    weights = _doubles_at(predictor.weights, _ROW * 2 * width)
    for i in range(row_width):
        value = table[first + i] + share * (table[first + row_width + i] - table[first + i])
        if newer < 1.0:
            older = before[first + i] + share * (before[first + row_width + i] - before[first + i])
            value = older + newer * (value - older)
        if i == 0:
            adaptive.dK[c] = value
        elif i == 1:
            adaptive.dB[c] = value
        elif i == 2:
            adaptive.dF[c] = value
        else:
            weights[2 * c * width + i - 3] = value


class EstimatedMass(NamedTuple):
    """A mass in kg, its standard uncertainty in kg, the whole span where nothing is known, and R²: the share of the
    latest motion that the forces explain."""

    mass_kg: float
    uncertainty_kg: float
    explained: float


class AdaptiveChannel(NamedTuple):
    """What follows the estimate on a channel: R rows, for masses in equal ratios from the least to the most, in kg."""

    span: tuple[float, float]
    stiffness: NDArray[np.float64]
    """(R,) N/m, that come to the scene's,"""
    damping: NDArray[np.float64]
    """(R,) N·s/m,"""
    rest: float
    """and the position in m at which they are at rest"""
    weights: NDArray[np.float64]
    """(R, 2, 2 + lags): those of the predictor"""
    device_stiffness: float
    """N/m"""
    desired_stiffness: float
    """N/m: what the hand shall feel, if it moves nothing else"""


class Adaptation:
    """Fills an ADAPTIVE, and keeps what it points to."""

    def __init__(
        self,
        predictor: Any,
        channels: dict[int, AdaptiveChannel],
        *,
        period_s: float,
        numerator: NDArray[np.float64],
        first_lag: int,
        count_m: NDArray[np.float64],
    ) -> None:
        """`predictor`: its PREDICTOR, already filled. `numerator`: how much of T²/m f[n - first_lag], and of the forces
        before it, is in the second difference of the positions at sample n. `count_m`: m per count, each channel's."""
        self.record = record = new_record(ADAPTIVE)
        self._predictor = predictor
        self._channels, self._period_s = channels, period_s
        record.rows = len(next(iter(channels.values())).stiffness)
        self._tables = [self._table(channels)]
        record.table = record.before = self._tables[0].ctypes.data
        record.samples = 1
        record.slew = 1.0 / max(SLEW_S / period_s, LEAST_SLEW)
        fill_mass_estimate(record.estimate, period_s, numerator, first_lag)
        for channel, one in channels.items():
            record.adapts[channel] = 1
            record.log_least[channel], record.log_most[channel] = np.log(one.span)
            record.log_mass[channel] = record.log_least[channel]
            sprung = one.device_stiffness * period_s**2
            fill_channel(record.estimate, channel, one.span, sprung, count_m[channel], self._span(one))
        predictor.adaptive = address_of(record)
        predictor.predict = predict_adaptively.address()
        predictor.add = add_difference.address()

    def follow(self, channels: dict[int, AdaptiveChannel], samples: int) -> None:
        """Other tables for the same channels, over so many samples, once the last have taken their place."""
        self._tables = [*self._tables[-8:], self._table(channels)]
        for channel, one in channels.items():
            self.record.estimate.next_span[channel] = self._span(one)
        post_table(self.record, self._tables[-1].ctypes.data, samples)

    def _span(self, one: AdaptiveChannel) -> int:
        half_period_s = math.pi * math.sqrt(one.span[0] / max(one.desired_stiffness, _LEAST_STIFFNESS))
        return span_of(half_period_s / self._period_s)

    def masses(self) -> dict[int, EstimatedMass]:
        """What is known of the mass on every channel that adapts."""
        return {channel: self._mass(channel) for channel in self._channels}

    def _mass(self, channel: int) -> EstimatedMass:
        record = self.record.estimate
        mass, relative = float(np.exp(record.log_mass[channel])), float(record.uncertainty[channel])
        least, most = self._channels[channel].span
        return EstimatedMass(mass, min(relative * mass, most - least), float(record.explained[channel]))

    def _table(self, channels: dict[int, AdaptiveChannel]) -> NDArray[np.float64]:
        rows, lags = int(self.record.rows), int(self._predictor.lags)
        table = np.zeros((_ROW, rows, 3 + 2 * (2 + lags)))
        for channel, one in channels.items():
            table[channel, :, 0], table[channel, :, 1] = one.stiffness, one.damping
            table[channel, :, 2] = one.stiffness * one.rest
            table[channel, :, 3:] = one.weights.reshape(rows, -1)
        return table


@entry
def post_table(adaptive, table, samples):
    """`Adaptation.follow`, compiled."""
    adaptive.posted_samples = samples
    fence()
    adaptive.posted = np.uint64(table)
