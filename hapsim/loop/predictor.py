"""What the scene gets in place of the position that was read: where the device's mass will be, and how fast, when
the force that answers the sample begins to act.

A line in two readings and in the forces that have been sent since: `hapsim.theory.correction` says which. The forces
are those that left, cut, rounded and with every push; where the device said that one came too late, the one that it
went on with. An excitation that measures an impedance plays the hand, of which no predictor knows: it is left out.

Who predicts nothing never compiles this: it is called by an address, which is 0 then.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.compiling.native import address_of, array_at, function_at, native, record_at
from hapsim.loop.io_buffer import IO_BUFFER

PREDICTOR = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("predict", np.uint64),  # and of what predicts; 0: the scene gets what was read
        ("add", np.uint64),  # and of what is added to the scene's force; 0: nothing
        ("adaptive", np.uint64),  # address of an ADAPTIVE, for these two
        ("lags", np.int64),  # so many past forces count
        ("senses", np.int64),  # 1: the second reading is the velocity of this sample, 0: the position of the one before
        ("goes_on", np.int64),  # 1: the device keeps a force until the next one comes,
        ("lives", np.int64),  # for so many samples at most
        ("weights", np.uint64),  # address of (channels, 2, 2 + lags): of position and velocity, of readings and forces
        ("forces", np.uint64),  # address of (rows, 2, MAX_CHANNELS): N, of the last samples, known and in all
        ("mask", np.int64),  # rows - 1, and rows is a power of two
        ("newest", np.int64),  # the row of the last sample
        ("begun", np.int64),  # 1: there was a sample
        ("sent", np.float64, (2, schema.MAX_CHANNELS)),  # N, with the sample before the last, known and in all
        ("read", np.float64, (schema.MAX_CHANNELS,)),  # m, with the last sample
    ],
    align=True,
)

PREDICT = types.void(types.uint64, types.uint64, types.int64, types.int64, types.int64)
ADD = types.void(types.uint64, types.uint64)
call_predict, call_add = function_at(PREDICT), function_at(ADD)
"""Call what predicts, with `predict`'s arguments, and what adds a force, with the first two of them."""

_predictor_at, _io_at, _doubles_at = record_at(PREDICTOR), record_at(IO_BUFFER), array_at(np.float64)
_ROW = 2 * schema.MAX_CHANNELS
IN_ALL = schema.MAX_CHANNELS


@native(PREDICT.return_type, *PREDICT.args)
def predict(predictor, io, gap, late, age):
    """Puts the state that is expected in place of what was read `gap` samples after the last. `late`: the last force
    did not act in time; `age`: samples since the one that acts was asked for."""
    predictor, io = _predictor_at(predictor), _io_at(io)
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * _ROW)
    if predictor.begun:
        keep_forces(predictor, io, forces, gap, late, age)
    predict_state(predictor, io, forces, gap)


@helper
def predict_state(predictor, io, forces, gap):
    """By the weights, from what is read and the forces that acted."""
    width = 2 + predictor.lags
    weights = _doubles_at(predictor.weights, io.channels * 2 * width)
    for c in range(io.channels):
        position, second = io.measured[c], io.measured[c]
        if predictor.senses:
            second = io.velocity[c]
        else:
            io.velocity_before[c] = io.velocity[c]
            if predictor.begun:
                second -= (position - predictor.read[c]) / gap
        of_position, of_velocity = 2 * c * width, (2 * c + 1) * width
        x = weights[of_position] * position + weights[of_position + 1] * second
        v = weights[of_velocity] * position + weights[of_velocity + 1] * second
        for lag in range(predictor.lags):
            force = forces[((predictor.newest - lag) & predictor.mask) * _ROW + c]
            x += weights[of_position + 2 + lag] * force
            v += weights[of_velocity + 2 + lag] * force
        predictor.read[c] = position
        io.measured[c] = x
        io.velocity[c] = v
    predictor.begun = 1


@helper
def keep_forces(predictor, io, forces, gap, late, age):
    """The forces of the samples since the last: those that acted. Instead of one that was late the one before it did:
    it went on, or, on a wire that takes a sample longer, was late itself."""
    holds = predictor.goes_on and age <= predictor.lives
    for sample in range(gap):
        before = predictor.newest * _ROW
        predictor.newest = (predictor.newest + 1) & predictor.mask
        row = predictor.newest * _ROW
        for c in range(io.channels):
            in_all = io.force_counts[c] * io.force_scale[c]
            known = in_all - io.as_hand[c]
            if sample > 0:
                known, in_all = forces[before + c], forces[before + IN_ALL + c]
            elif late and gap == 1:
                known, in_all = predictor.sent[0, c], predictor.sent[1, c]
            acts = holds or (sample == 0 and not (late and gap == 1))
            forces[row + c] = known if acts else 0.0
            forces[row + IN_ALL + c] = in_all if acts else 0.0
    for c in range(io.channels):
        in_all = io.force_counts[c] * io.force_scale[c]
        predictor.sent[0, c], predictor.sent[1, c] = in_all - io.as_hand[c], in_all


class PredictorMemory:
    """Fills a PREDICTOR, and keeps what it points to."""

    def __init__(
        self,
        record: Any,
        weights: Mapping[int, tuple[NDArray[np.float64], NDArray[np.float64]]],
        *,
        channels: int,
        senses: bool,
        goes_on: bool,
        lives_samples: int,
    ) -> None:
        """`weights`: of each channel that is predicted, (2, 2) of the readings and (2, lags) of the forces, SI units;
        the others get what is read."""
        lags = max(forces.shape[1] for _, forces in weights.values())
        rows = 2 << max(lags, 1).bit_length()
        self._weights = np.zeros((channels, 2, 2 + lags))
        self._weights[:, 0, 0] = 1.0
        for channel, (readings, forces) in weights.items():
            self._weights[channel, :, :2] = readings
            self._weights[channel, :, 2 : 2 + forces.shape[1]] = forces
        self._forces = np.zeros((rows, 2, schema.MAX_CHANNELS))
        record.address = address_of(record)
        record.lags, record.mask, record.senses = lags, rows - 1, senses
        record.goes_on, record.lives = goes_on, lives_samples
        record.weights, record.forces = self._weights.ctypes.data, self._forces.ctypes.data
        record.predict = predict.address()
