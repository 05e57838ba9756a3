"""The predictor: the scene gets the expected state of the mass when its force will act, not the measured position.

An observer advances its state from sample to sample by the forces that acted, and corrects it by the measurement
(`hapsim.theory.correction`). The forces are those that were sent: clipped, rounded and with every push. If the device
reports one as late, the one before acted. An excitation that measures an impedance counts as the hand's push: the
predictor does not know it, and observes it.

It keeps its forces itself, unlike the guards (force_history.py): it needs them before the scene moves, and uses the
device's own count of late samples. The observer's numbers come from a table, so that they change with the scene and
with an estimate of the mass.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import entry, helper
from hapsim.compiling.native import array_at, record_at
from hapsim.cordis.tick import tick
from hapsim.loop.hooks import call_hooks, hook, io_at, tick_at

POSITION, VELOCITY, PUSH, STATES = 0, 1, 2, 3

PREDICTOR = np.dtype(
    [
        ("adaptive", np.uint64),  # address of an ADAPTIVE; 0: no mass is estimated
        ("lags", np.int64),  # count of past forces in use
        ("readings", np.int64),  # 2: the velocity is read too
        ("keeps_last_force", np.int64),  # 1: the device keeps a force until the next one comes,
        ("lives", np.int64),  # at most for this many samples
        ("width", np.int64),  # numbers of a channel (running/correction_setup.py)
        ("numbers", np.uint64),  # address of (channels, width): the numbers now
        ("table", np.uint64),  # of (channels, rows, width): for masses in equal ratios, or one row
        ("before", np.uint64),  # of the table before it, during a fade
        ("posted", np.uint64),  # of the next table; 0: none
        ("posted_samples", np.int64),
        ("samples", np.int64),  # of the fade
        ("left", np.int64),  # of these
        ("rows", np.int64),
        ("forces", np.uint64),  # address of (rows, 2, MAX_CHANNELS): N, of the last samples, known and in all
        ("mask", np.int64),  # rows - 1, and rows is a power of two
        ("newest", np.int64),  # the row of the last sample
        ("begun", np.int64),  # samples read, up to 2
        ("sent", np.float64, (2, schema.MAX_CHANNELS)),  # N, with the sample before the last, known and in all
        ("state", np.float64, (schema.MAX_CHANNELS, STATES)),  # m, m/s and N: of the last sample
        ("expected", np.float64, (schema.MAX_CHANNELS, 2)),  # m and m/s: this sample's measurement, as predicted
    ],
    align=True,
)

_predictor_at, _doubles_at = record_at(PREDICTOR), array_at(np.float64)
_ROW = 2 * schema.MAX_CHANNELS
IN_ALL = schema.MAX_CHANNELS


@hook
def predict(predictor, tick):
    """Replaces the measured state by the expected one."""
    predictor, tick = _predictor_at(predictor), tick_at(tick)
    io = io_at(tick.io)
    take_posted(predictor)
    if predictor.left > 0:
        predictor.left -= 1
        for c in range(io.channels):
            set_numbers(predictor, c, 0.0)
    observe(predictor, io, tick.gap, tick.late, tick.age)
    look_ahead(predictor, io)
    return 0


@helper
def observe(predictor, io, gap, late, age):
    """Advances the state of every channel to this sample, and corrects it by the measurement. `gap`: samples since the
    last one. `late`: the last force did not act in time. `age`: samples since the position that the acting force
    answers."""
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * _ROW)
    numbers = _doubles_at(predictor.numbers, schema.MAX_CHANNELS * predictor.width)
    if predictor.begun:
        for sample in range(gap):
            _keep_forces(predictor, io, forces, sample, late and gap == 1, age)
            for c in range(io.channels):
                _advance(predictor, forces, numbers, c)
        _keep_sent(predictor, io)
    for c in range(io.channels):
        _correct(predictor, numbers, c, io.measured[c], io.velocity[c], gap)
    predictor.begun = min(predictor.begun + 1, 2)


@helper
def _keep_sent(predictor, io):
    for c in range(io.channels):
        predictor.sent[0, c], predictor.sent[1, c] = _sent(io, c)


@hook
def look_ahead_by_sensors(predictor, tick):
    """Moves position and velocity ahead of the sensed motion. A channel's numbers are the time, s, and the weights of
    the forces of the last samples in what is added to the acceleration, 1/kg: it may be older than the newest force."""
    predictor, tick = _predictor_at(predictor), tick_at(tick)
    io = io_at(tick.io)
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * _ROW)
    numbers = _doubles_at(predictor.numbers, schema.MAX_CHANNELS * predictor.width)
    if predictor.begun and predictor.lags > 0:
        for sample in range(tick.gap):
            _keep_forces(predictor, io, forces, sample, tick.late and tick.gap == 1, tick.age)
        _keep_sent(predictor, io)
    predictor.begun = 1
    for c in range(io.channels):
        first, a = c * predictor.width, io.acceleration[c]
        ahead = numbers[first]
        for lag in range(predictor.lags):
            a += numbers[first + 1 + lag] * forces[((predictor.newest - lag) & predictor.mask) * _ROW + IN_ALL + c]
        io.measured[c] += ahead * (io.velocity[c] + 0.5 * ahead * a)
        io.velocity[c] += ahead * a
    return 0


@helper
def _sent(io, c):
    in_all = io.force_counts[c] * io.force_scale[c]
    return in_all - io.as_hand[c], in_all


@helper
def _keep_forces(predictor, io, forces, sample, late, age):
    """Keeps the force that acted in a sample, counted from the last one. Instead of a late force the one before acted:
    the device kept it, or it was late itself on a wire that takes a sample longer."""
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
    """Returns the product of a row of numbers with state and forces."""
    state = predictor.state[c]
    total = numbers[first] * state[POSITION] + numbers[first + 1] * state[VELOCITY] + numbers[first + 2] * state[PUSH]
    for lag in range(predictor.lags):
        total += numbers[first + STATES + lag] * forces[((predictor.newest - lag) & predictor.mask) * _ROW + c]
    return total


@helper
def _advance(predictor, forces, numbers, c):
    """Advances the state by a sample."""
    first, row = c * predictor.width, STATES + predictor.lags
    x = _sum(predictor, forces, numbers, first, c)
    v = _sum(predictor, forces, numbers, first + row, c)
    for reading in range(predictor.readings):
        predictor.expected[c, reading] = _sum(predictor, forces, numbers, first + (2 + reading) * row, c)
    predictor.state[c, POSITION], predictor.state[c, VELOCITY] = x, v


@helper
def _correct(predictor, numbers, c, position, velocity, gap):
    """Corrects the state by the measurement; after lost positions with velocity and push gains of the longer period."""
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
    """Replaces position and velocity by those expected at the instant at which the force will act."""
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
    """Begins a fade to the posted table, unless another fade is under way. Returns whether it began."""
    if predictor.posted == 0 or predictor.left != 0:
        return False
    predictor.before, predictor.table = predictor.table, predictor.posted
    predictor.samples = predictor.left = predictor.posted_samples
    predictor.posted = np.uint64(0)
    return True


@helper
def set_numbers(predictor, c, at):
    """Sets a channel's numbers by interpolation at row `at` of the table, and between two tables during a fade."""
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


@entry
def corrected_ticks(loop, program, measured, samples):
    """Runs ticks of a program behind the predictor of a LOOP, without a device, for timing. `program`: PROGRAM.
    `measured`: (rows, channels) m, the hands' positions, repeated."""
    io = loop.io
    for n in range(samples):
        row = n % measured.shape[0]
        for c in range(io.channels):
            io.measured[c] = measured[row, c]
        call_hooks(loop.hooks.before_scene, loop.tick)
        tick(program, io.measured, io.velocity, io.asked)
        call_hooks(loop.hooks.after_scene, loop.tick)
