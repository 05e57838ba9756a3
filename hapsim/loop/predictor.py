"""The predictor: the scene gets the state in which its force will find the mass, not the position that was read.

An observer leads its state from sample to sample by the forces that acted, and corrects it by what is read
(`hapsim.theory.correction`). The forces are those that left, clipped, rounded and with every push; where the device
reports one as late, the one that went on. An excitation that measures an impedance plays the hand, of which no
predictor knows: it is left out, and found as the hand's push is.

The observer's numbers come as a table, so that they change with the scene and with an estimate of the mass. A scene
without a predictor never compiles this: its address is 0 then.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from hapsim.compiling import entry, helper
from hapsim.compiling.memory_fence import fence
from hapsim.compiling.native import address_of, array_at, function_at, native, record_at
from hapsim.cordis.tick import tick
from hapsim.loop.buffers import IO_BUFFER

POSITION, VELOCITY, PUSH, STATES = 0, 1, 2, 3

PREDICTOR = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("predict", np.uint64),  # and of what predicts; 0: the scene gets what was read
        ("add", np.uint64),  # and of what is added to the scene's force; 0: nothing
        ("adaptive", np.uint64),  # address of an ADAPTIVE, for these two
        ("lags", np.int64),  # so many past forces count
        ("readings", np.int64),  # 2: the velocity is read too
        ("keeps_last_force", np.int64),  # 1: the device keeps a force until the next one comes,
        ("lives", np.int64),  # for so many samples at most
        ("width", np.int64),  # numbers of a channel, as `numbers_of` orders them
        ("numbers", np.uint64),  # address of (channels, width): as they are now
        ("table", np.uint64),  # of (channels, rows, width): for masses in equal ratios, or one row
        ("before", np.uint64),  # of the one before it, while one follows the other
        ("posted", np.uint64),  # of one that shall follow; 0: none
        ("posted_samples", np.int64),
        ("samples", np.int64),  # in so many
        ("left", np.int64),  # samples until the one before is left
        ("rows", np.int64),
        ("forces", np.uint64),  # address of (rows, 2, MAX_CHANNELS): N, of the last samples, known and in all
        ("mask", np.int64),  # rows - 1, and rows is a power of two
        ("newest", np.int64),  # the row of the last sample
        ("begun", np.int64),  # samples read, up to 2
        ("sent", np.float64, (2, schema.MAX_CHANNELS)),  # N, with the sample before the last, known and in all
        ("state", np.float64, (schema.MAX_CHANNELS, STATES)),  # m, m/s and N: of the last sample
        ("expected", np.float64, (schema.MAX_CHANNELS, 2)),  # m and m/s: what is read now, by what was known before
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
    take_posted(predictor)
    if predictor.left > 0:
        predictor.left -= 1
        for c in range(io.channels):
            set_numbers(predictor, c, 0.0)
    observe(predictor, io, gap, late, age)
    look_ahead(predictor, io)


@helper
def observe(predictor, io, gap, late, age):
    """Leads the state of every channel to this sample, and corrects it by what was read."""
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * _ROW)
    numbers = _doubles_at(predictor.numbers, schema.MAX_CHANNELS * predictor.width)
    if predictor.begun:
        for sample in range(gap):
            _keep_forces(predictor, io, forces, sample, late and gap == 1, age)
            for c in range(io.channels):
                _lead(predictor, forces, numbers, c)
        for c in range(io.channels):
            predictor.sent[0, c], predictor.sent[1, c] = _sent(io, c)
    for c in range(io.channels):
        _correct(predictor, numbers, c, io.measured[c], io.velocity[c], gap)
    predictor.begun = min(predictor.begun + 1, 2)


@helper
def _sent(io, c):
    in_all = io.force_counts[c] * io.force_scale[c]
    return in_all - io.as_hand[c], in_all


@helper
def _keep_forces(predictor, io, forces, sample, late, age):
    """The force that acted of the sample that is so many after the last. Instead of one that was late the one before it
    did: it went on, or, on a wire that takes a sample longer, was late itself."""
    before = predictor.newest * _ROW
    predictor.newest = (predictor.newest + 1) & predictor.mask
    row = predictor.newest * _ROW
    acts = (predictor.keeps_last_force and age <= predictor.lives) or (sample == 0 and not late)
    for c in range(io.channels):
        known, in_all = _sent(io, c)
        if sample > 0:
            known, in_all = forces[before + c], forces[before + IN_ALL + c]
        elif late:
            known, in_all = predictor.sent[0, c], predictor.sent[1, c]
        forces[row + c] = known if acts else 0.0
        forces[row + IN_ALL + c] = in_all if acts else 0.0


@helper
def _sum(predictor, forces, numbers, first, c):
    """A row of numbers times state and forces."""
    state = predictor.state[c]
    total = numbers[first] * state[POSITION] + numbers[first + 1] * state[VELOCITY] + numbers[first + 2] * state[PUSH]
    for lag in range(predictor.lags):
        total += numbers[first + STATES + lag] * forces[((predictor.newest - lag) & predictor.mask) * _ROW + c]
    return total


@helper
def _lead(predictor, forces, numbers, c):
    """A sample further, by the forces that acted."""
    first, row = c * predictor.width, STATES + predictor.lags
    x = _sum(predictor, forces, numbers, first, c)
    v = _sum(predictor, forces, numbers, first + row, c)
    for reading in range(predictor.readings):
        predictor.expected[c, reading] = _sum(predictor, forces, numbers, first + (2 + reading) * row, c)
    predictor.state[c, POSITION], predictor.state[c, VELOCITY] = x, v


@helper
def _correct(predictor, numbers, c, position, velocity, gap):
    """What is read less often tells as much of the position, but the rest over a longer time: its gains are those of
    that sample period."""
    state, senses = predictor.state[c], predictor.readings == 2
    if predictor.begun == 0:
        state[POSITION], state[VELOCITY], state[PUSH] = position, velocity if senses else 0.0, 0.0
        return
    off = position - predictor.expected[c, 0]
    off_velocity = velocity - predictor.expected[c, 1] if senses else 0.0
    first = c * predictor.width + (4 + predictor.readings) * (STATES + predictor.lags)
    if predictor.begun == 1:
        first += STATES * predictor.readings
    share = 1.0
    for i in range(STATES - (predictor.begun == 1)):
        at = first + i * predictor.readings
        state[i] += share * numbers[at] * off
        if senses:
            state[i] += share * numbers[at + 1] * off_velocity
        if i > 0 or not senses:
            share /= gap


@helper
def look_ahead(predictor, io):
    """Puts position and velocity at the instant when the force will act in place of what was read."""
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * _ROW)
    numbers = _doubles_at(predictor.numbers, schema.MAX_CHANNELS * predictor.width)
    row = STATES + predictor.lags
    for c in range(io.channels):
        if predictor.readings == 1:
            io.velocity_before[c] = io.velocity[c]
        ahead = c * predictor.width + (2 + predictor.readings) * row
        io.measured[c] = _sum(predictor, forces, numbers, ahead, c)
        io.velocity[c] = _sum(predictor, forces, numbers, ahead + row, c)


@helper
def take_posted(predictor):
    """Begins to follow another table, once the last has taken its place: whether it does."""
    if predictor.posted == 0 or predictor.left != 0:
        return False
    predictor.before, predictor.table = predictor.table, predictor.posted
    predictor.samples = predictor.left = predictor.posted_samples
    fence()
    predictor.posted = np.uint64(0)
    return True


@helper
def set_numbers(predictor, c, at):
    """From the table: `at`, between two rows, and, while one table follows another, between the two tables."""
    width, rows = predictor.width, predictor.rows
    size = schema.MAX_CHANNELS * rows * width
    table, before = _doubles_at(predictor.table, size), _doubles_at(predictor.before, size)
    numbers = _doubles_at(predictor.numbers, schema.MAX_CHANNELS * width)
    s = 1.0 - predictor.left / predictor.samples
    newer = s * s * (3.0 - 2.0 * s)
    row = max(min(np.int64(at), rows - 2), 0)
    share, first = at - row, (c * rows + row) * width
    further = first + (width if rows > 1 else 0)
    for i in range(width):
        value = table[first + i] + share * (table[further + i] - table[first + i])
        if newer < 1.0:
            older = before[first + i] + share * (before[further + i] - before[first + i])
            value = older + newer * (value - older)
        numbers[c * width + i] = value


Table = NDArray[np.float64]


class PredictorMemory:
    """Fills a PREDICTOR, and keeps what it points to."""

    def __init__(
        self,
        record: Any,
        tables: Mapping[int, Table],
        *,
        lags: int,
        readings: int,
        keeps_last_force: bool,
        lives_samples: int,
    ) -> None:
        """`tables`: of each channel that is predicted, (R, width): for R masses, or one, what `numbers_of` makes, and
        what else the force is made of. The other channels get what is read."""
        history = 2 << max(lags, 1).bit_length()
        self._record = record
        self._forces = np.zeros((history, 2, schema.MAX_CHANNELS))
        record.address = address_of(record)
        record.lags, record.mask, record.readings = lags, history - 1, readings
        record.keeps_last_force, record.lives = keeps_last_force, lives_samples
        record.rows = max(len(table) for table in tables.values())
        record.width = next(iter(tables.values())).shape[1]
        self._tables = [self._table(tables)]
        self._numbers = np.ascontiguousarray(self._tables[0][:, 0])
        record.numbers, record.forces = self._numbers.ctypes.data, self._forces.ctypes.data
        record.table = record.before = self._tables[0].ctypes.data
        record.samples = 1
        record.predict = predict.address()

    def follow(self, tables: Mapping[int, Table], samples: int) -> None:
        """Other tables for the same channels, over so many samples, once the last have taken their place."""
        self._tables = [*self._tables[-8:], self._table(tables)]
        post_table(self._record, self._tables[-1].ctypes.data, max(samples, 1))

    def _table(self, tables: Mapping[int, Table]) -> Table:
        rows, width, readings = int(self._record.rows), int(self._record.width), int(self._record.readings)
        row = STATES + int(self._record.lags)
        whole = np.zeros((schema.MAX_CHANNELS, rows, width))
        whole[..., (2 + readings) * row] = whole[..., (4 + readings) * row] = 1.0  # the position that was read
        for channel, table in tables.items():
            whole[channel] = table
        return whole


def numbers_of(step: Table, reading: Table, gains: Table, first: Table, ahead: Table, lags: int) -> Table:
    """(width,): of a `StatePredictor`, the rows of step, reading and ahead for so many forces, then both gains."""
    rows = np.vstack([step, reading, ahead])
    padded = np.pad(rows, ((0, 0), (0, STATES + lags - rows.shape[1])))
    return np.concatenate([padded.ravel(), gains.ravel(), first.ravel()])


@entry
def post_table(predictor, table, samples):
    """`PredictorMemory.follow`, compiled."""
    predictor.posted_samples = samples
    fence()
    predictor.posted = np.uint64(table)


_CONTROL = np.dtype([("time_to_live", np.int64)])  # what a correction reads of the loop's
_OFFLINE = np.dtype([("predictor", PREDICTOR), ("io", IO_BUFFER), ("control", _CONTROL)], align=True)


class CorrectedTicks:
    """A program behind a predictor, without a device: to time its ticks. The correction fills `record`."""

    def __init__(self, program: Any, channels: int) -> None:
        """`program`: a Program."""
        self._program = program
        self.record: Any = new_record(_OFFLINE)
        self.record.io.address = address_of(self.record.io)
        self.record.io.channels = channels

    def ticks(self, measured: NDArray[np.float64], samples: int) -> None:
        """So many samples, each with the next of the hands' positions (rows, channels), in m, over and over."""
        _ticks(self.record.predictor, self.record.io, self._program.record, measured, samples)


@entry
def _ticks(predictor, io, program, measured, samples):
    for n in range(samples):
        row = n % measured.shape[0]
        for c in range(io.channels):
            io.measured[c] = measured[row, c]
        call_predict(predictor.predict, (predictor.address, io.address, 1, 0, 1))
        tick(program, io.measured, io.velocity, io.asked)
        if predictor.add != 0:
            call_add(predictor.add, (predictor.address, io.address))
