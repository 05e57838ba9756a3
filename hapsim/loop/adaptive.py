"""The correction `adaptive`: the force follows the estimated mass (mass_estimate.py), by a factor e in SLEW_S at most.

`prediction/correction/adaptive.py` computes the predictor's table beforehand: what to simulate for which mass, stable
for all of them. A scene without this correction never compiles it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of, array_at, native, record_at
from hapsim.loop.buffers import IO_BUFFER
from hapsim.loop.mass_estimate import MASS_ESTIMATE, MOST_SLOW_SPAN, MOST_SPAN, estimate_mass, note_sample, take_spans
from hapsim.loop.predictor import ADD, PREDICT, PREDICTOR, look_ahead, observe, set_numbers, take_posted

SLEW_S, LEAST_SLEW = 0.05, 25  # s, samples: for a factor e of the mass
_LEAST_STIFFNESS = 1e-9  # N/m

_EACH = (schema.MAX_CHANNELS,)

ADAPTIVE = np.dtype(
    [
        ("adapts", np.int64, _EACH),  # 1: this channel's force follows an estimate
        ("log_least", np.float64, _EACH),  # ln kg: the span of masses,
        ("log_most", np.float64, _EACH),
        ("log_mass", np.float64, _EACH),  # and the mass that the force is for
        ("slew", np.float64),  # the largest change of ln m in a sample
        ("estimate", MASS_ESTIMATE),
    ],
    align=True,
)

_predictor_at, _io_at, _doubles_at = record_at(PREDICTOR), record_at(IO_BUFFER), array_at(np.float64)
_adaptive_at = record_at(ADAPTIVE)
_ROW = schema.MAX_CHANNELS

ADDED = 3
"""The last of a channel's numbers: N/m, N·s/m and N, which are added to the scene's force."""


@native(PREDICT.return_type, *PREDICT.args)
def predict_adaptively(predictor, io, gap, late, age):
    """As `predict`, with the numbers for the estimated mass."""
    predictor, io = _predictor_at(predictor), _io_at(io)
    adaptive = _adaptive_at(predictor.adaptive)
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * 2 * _ROW)
    observe(predictor, io, gap, late, age)
    if take_posted(predictor):
        take_spans(adaptive.estimate)
    follows = predictor.left > 0
    predictor.left -= follows
    note_sample(adaptive.estimate, gap, late)
    for c in range(io.channels):
        if adaptive.adapts[c]:
            step = estimate_mass(adaptive.estimate, predictor, forces, c, io.measured[c]) - adaptive.log_mass[c]
            adaptive.log_mass[c] += min(max(step, -adaptive.slew), adaptive.slew)
            span = adaptive.log_most[c] - adaptive.log_least[c]
            set_numbers(predictor, c, (adaptive.log_mass[c] - adaptive.log_least[c]) / span * (predictor.rows - 1))
        elif follows:
            set_numbers(predictor, c, 0.0)
    look_ahead(predictor, io)


@native(ADD.return_type, *ADD.args)
def add_difference(predictor, io):
    """Adds to the scene's force: the scene's links are those for the least mass."""
    predictor, io = _predictor_at(predictor), _io_at(io)
    numbers = _doubles_at(predictor.numbers, _ROW * predictor.width)
    for c in range(io.channels):
        dK = (c + 1) * predictor.width - ADDED
        io.asked[c] += numbers[dK + 2] - numbers[dK] * io.measured[c] - numbers[dK + 1] * io.velocity[c]


class EstimatedMass(NamedTuple):
    """An estimate of a channel's mass."""

    mass_kg: float
    uncertainty_kg: float  # standard; the whole span where nothing is known
    explained: float  # R²: the share of the latest motion that the forces explain


class AdaptiveChannel(NamedTuple):
    """A channel whose force follows the estimate."""

    span: tuple[float, float]  # kg: the first and the last row of its table, in equal ratios
    device_stiffness: float  # N/m
    desired_stiffness: float  # N/m, of a hand that moves nothing else


class Adaptation:
    """Fills an ADAPTIVE."""

    def __init__(
        self,
        predictor: Any,
        channels: Mapping[int, AdaptiveChannel],
        *,
        period_s: float,
        numerator: NDArray[np.float64],
        first_lag: int,
        count_m: NDArray[np.float64],
    ) -> None:
        """`predictor`: a filled PREDICTOR, whose numbers end with the ADDED ones. `numerator`: the shares of
        T²/m f[n - first_lag], and of the forces before it, in the second difference of the positions at sample n.
        `count_m`: (channels,) m per count."""
        self.record = record = new_record(ADAPTIVE)
        self._channels, self._period_s = channels, period_s
        record.slew = 1.0 / max(SLEW_S / period_s, LEAST_SLEW)
        estimate = record.estimate
        estimate.first_lag, estimate.count = first_lag, len(numerator)
        estimate.weights[: len(numerator)] = period_s**2 * numerator
        estimate.uncertainty[:] = math.inf
        for channel, one in channels.items():
            record.adapts[channel] = 1
            for spans in (record, estimate):
                spans.log_least[channel], spans.log_most[channel] = np.log(one.span)
                spans.log_mass[channel] = spans.log_least[channel]
            estimate.sprung[channel] = one.device_stiffness * period_s**2
            estimate.rounding[channel] = count_m[channel] ** 2 / 12.0
        self.follow(channels)
        estimate.span[:] = estimate.next_span
        estimate.slow_span[:] = np.minimum(estimate.span, MOST_SLOW_SPAN)
        predictor.adaptive = address_of(record)
        predictor.predict = predict_adaptively.address()
        predictor.add = add_difference.address()

    def follow(self, channels: Mapping[int, AdaptiveChannel]) -> None:
        """Restarts the estimates with other spans of samples, together with the table that is posted next."""
        for channel, one in channels.items():
            half_period_s = math.pi * math.sqrt(one.span[0] / max(one.desired_stiffness, _LEAST_STIFFNESS))
            samples = min(max(half_period_s / self._period_s, 1.0), float(MOST_SPAN))
            self.record.estimate.next_span[channel] = round(samples)

    def masses(self) -> dict[int, EstimatedMass]:
        """Returns the estimate of every channel that adapts."""
        found, record = {}, self.record.estimate
        for channel, one in self._channels.items():
            mass, relative = float(np.exp(record.log_mass[channel])), float(record.uncertainty[channel])
            uncertainty = min(relative * mass, one.span[1] - one.span[0])
            found[channel] = EstimatedMass(mass, uncertainty, float(record.explained[channel]))
        return found
