"""The lines of `law: board` in an exchange: found after the scene has moved, guarded, sent, and kept for the guards.

A line is F, k, b and the bounds `low` and `high` of a channel, at first as the scene's links give it
(`cordis/board_line.py`). An excitation moves F and the bounds. The force limit narrows the bounds; F itself is the
line's value at the reported position, and may lie beyond them. What lowers a force multiplies the whole line
(`scale_line` of buffers.py); the slew limit (guards/line_slew.py) keeps it near the one before.

**The force of a sample**, for guards, records and measurements, is

    clip(F + k (x_n - (x_j + x_j+1) / 2) - b (x_j+1 - x_j) / T)

for the sample from x_j to x_j+1 in which the line that answers x_n acts: of a line without damping it is exactly the
force that does the work of the line's potential. The guards find it in FORCE_HISTORY, where a held force stands under
`law: host`. The energy guard's columns have a damping that is less by k (1/2 + board_delay) T/N: the board's own hold
and delay give that much energy at least.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description
from firmware_protocol.lines import LARGEST_BOUND, line_counts, pack_line
from hapsim.compiling import helper
from hapsim.compiling.native import address_of, record_at
from hapsim.cordis.board_line import LAW, find_line, set_hands_of_law
from hapsim.cordis.substep_loop import SCENE_SLOT
from hapsim.loop.buffers import clip
from hapsim.loop.force_history import (
    COLUMNS,
    FORCE_HISTORY,
    IN_ALL,
    IN_TIME,
    OF_SCENE,
    acting_force,
    advance,
    forces_at,
    history_at,
    keep_column,
    keep_in_time,
    set_history,
)
from hapsim.loop.hooks import Hook, Stage, hook, io_at, tick_at
from hapsim.scene import Scene

_EACH = (schema.MAX_CHANNELS,)
_SCALES = ("stiffness_scale", "damping_scale", "largest_stiffness", "largest_damping")  # of `Lines`
NUMBERS = 5  # of a line: its value at position 0, k, b, low, high

BOARD_LAW = np.dtype(
    [
        ("slot", np.uint64),  # address of the SCENE_SLOT
        ("law", LAW),
        ("rate", np.float64),  # Hz,
        ("step_rate", np.float64),  # and of the program's steps
        ("lag", np.float64),  # s, by which the board's force is behind its position
        ("lead", np.float64),  # samples from a position until its line acts,
        ("until", np.float64),  # and until it has ended
        ("reach", np.float64, _EACH),  # m, by which the force limit moves the hand until then
        *((name, np.float64, _EACH) for name in _SCALES),
        ("device_limit", np.float64, _EACH),  # N
        ("most", np.int64, _EACH),  # counts of the bounds, within the scene's limit
        ("saturated", np.int64),  # samples in which k or b was more than the device takes
        ("past", FORCE_HISTORY, (NUMBERS,)),  # the lines that acted
    ],
    align=True,
)

_own_at, _slot_at = record_at(BOARD_LAW), record_at(SCENE_SLOT)


@hook
def find_lines(own, tick):
    """Finds the line of every hand, once the scene has moved."""
    own, tick = _own_at(own), tick_at(tick)
    io, slot, law = io_at(tick.io), _slot_at(own.slot), own.law
    law.programs[0], law.programs[1] = slot.program, slot.next
    law.weights[1] = slot.weight if slot.next != 0 else 0.0
    law.weights[0] = 1.0 - law.weights[1]
    for j in range(np.uint64(2 if slot.next != 0 else 1)):
        set_hands_of_law(law, j, io.measured, io.before, tick.gap, slot.substeps)
    for c in range(np.uint64(io.channels)):
        way = (io.measured[c] - io.before[c]) / tick.gap
        find_line(law, c, io.measured[c], way, own.lead, abs(way) * own.until + own.reach[c])
        io.asked[c], io.stiffness[c], io.damping[c] = law.line[0], law.line[1], law.line[2] / own.step_rate
        io.low[c], io.high[c] = law.line[3], law.line[4]
        if not math.isfinite(io.stiffness[c] + io.damping[c]):
            io.asked[c] = math.nan
    return 0


@hook
def begin_lines(own, tick):
    """Adds the excitation, and narrows the bounds to the force limit. What the guards then lower and shape is the force
    at the reported position and speed."""
    own, tick = _own_at(own), tick_at(tick)
    io = io_at(tick.io)
    for c in range(np.uint64(io.channels)):
        limit, speed = io.force_limit[c], (io.measured[c] - io.before[c]) * own.rate / tick.gap
        io.line_force[c] = io.asked[c] + io.excitation[c]
        io.low[c] = clip(io.low[c] + io.excitation[c], limit)
        io.high[c] = clip(io.high[c] + io.excitation[c], limit)
        force = min(max(io.line_force[c] - io.damping[c] * speed, io.low[c]), io.high[c])
        if tick.withheld == 0:
            io.force_counts[c] = np.int64(np.rint(force / io.force_scale[c]))
    return 0


@hook
def write_lines(own, tick):
    """Writes the guarded lines in counts, as they are sent."""
    own, tick = _own_at(own), tick_at(tick)
    io, fits = io_at(tick.io), True
    for c in range(np.uint64(io.channels)):
        scales = own.stiffness_scale[c], own.damping_scale[c], own.largest_stiffness[c], own.largest_damping[c]
        k, b, low, high, fit = line_counts(
            io.stiffness[c], io.damping[c], io.low[c], io.high[c], scales, own.device_limit[c]
        )
        most, word = own.most[c], np.uint64(io.channels) + np.uint64(2) * c
        first, second = pack_line(k, b, max(low, -most), min(high, most))
        io.force_counts[word], io.force_counts[word + np.uint64(1)] = first, second
        if tick.withheld:
            io.force_counts[word] = io.force_counts[word + np.uint64(1)] = 0
        else:
            counts = np.rint(io.line_force[c] / io.force_scale[c])
            io.force_counts[c] = np.int64(clip(counts, 2147483647.0))
        fits = fits and fit
    own.saturated += not fits
    return 0


@hook
def keep_lines(own, tick):
    """Keeps the lines of the last `gap` samples, and writes the forces with which they acted into the FORCE_HISTORY."""
    own, tick = _own_at(own), tick_at(tick)
    io, history = io_at(tick.io), history_at(tick.history)
    forces, gap = forces_at(history.forces, (history.mask + 1) * COLUMNS), tick.gap
    for c in range(io.channels):
        e = io.excitation[c]
        _keep_line(own, tick, c, e, IN_TIME)
        _keep_line(own, tick, c, e, OF_SCENE)
        _keep_line(own, tick, c, 0.0, IN_ALL)
    for i in range(NUMBERS):
        advance(own.past[i], tick)
    for before in range(gap if history.begun else 0):
        for c in range(np.uint64(io.channels)):
            way = (io.measured[c] - io.before[c]) / gap
            middle = io.measured[c] - (before + 0.5) * way
            for column in (OF_SCENE, IN_ALL, IN_TIME):
                row = (history.newest + gap - before) & history.mask
                at = np.uint64(row * COLUMNS + column) + c
                lag = 0.0 if column == IN_ALL else own.lag
                forces[at] = _acting_line(own, column + np.int64(c), before, middle, way * own.rate, lag)
    advance(history, tick)
    for c in range(io.channels):
        io.acted[c] = acting_force(history, IN_ALL + c, 0)
    return 0


@helper
def _keep_line(own, tick, c, excitation, column):
    """Keeps the line of channel c, less an excitation, in one of the three columns of the history."""
    io = io_at(tick.io)
    at_zero, limit = io.line_force[c] - excitation + io.stiffness[c] * io.measured[c], io.force_limit[c]
    low, high = clip(io.low[c] - excitation, limit), clip(io.high[c] - excitation, limit)
    numbers = at_zero, io.stiffness[c], io.damping[c], low, high
    for i in range(NUMBERS):
        past = own.past[i]
        forces = forces_at(past.forces, (past.mask + 1) * COLUMNS)
        if column == IN_TIME:
            keep_in_time(past, forces, c, numbers[i], tick.gap)
        else:
            keep_column(past, forces, column + c, 0.0 if tick.withheld else numbers[i], tick)


@helper
def _acting_line(own, column, before, position, speed, lag):
    """Returns the force of the line that acted `before` samples before the last complete one, N, with a damping that is
    less by k `lag`."""
    force = acting_force(own.past[0], column, before) - acting_force(own.past[1], column, before) * position
    low, high = acting_force(own.past[3], column, before), acting_force(own.past[4], column, before)
    if low < force < high:
        stiffness, damping = acting_force(own.past[1], column, before), acting_force(own.past[2], column, before)
        force -= (damping - stiffness * lag) * speed
    return min(max(force, low), high)


def board_hooks(loop: Any, scene: Scene, description: Description, fastest: float) -> tuple[list[Hook], list[Hook]]:
    """Fills the BOARD_LAW of a LOOP. Returns its hooks before and behind those of the guards; the last one keeps the
    LOOP's history. `scene`: with the delay of its wire; `fastest`: motion of a hand, m/s. The device follows lines as
    the scene says."""
    board, lines, channels, own = (
        scene.device.board(scene.rate),
        description.lines,
        description.channels,
        loop.board_law,
    )
    assert board is not None
    assert lines is not None
    delay, own.rate, own.step_rate = scene.device.delay, scene.rate, scene.step_rate
    own.slot, own.law.fastest_way = address_of(loop.slot), fastest / scene.step_rate
    own.lag = (0.5 + board.delay) / (board.steps * scene.rate)
    own.lead, own.until = delay + board.delay / board.steps, delay + 2.0
    masses, used = np.array([least for least, _ in scene.device.mass_spans(scene.channels)]), slice(scene.channels)
    limit = np.minimum(description.force_limit, scene.device.force_limit)
    own.reach[used] = 0.5 * limit[used] / masses * (own.until / scene.rate) ** 2
    for name in _SCALES:
        own[name][:channels] = getattr(lines, name)
    own.device_limit[:channels] = description.force_limit
    own.most[:channels] = np.floor(limit / description.force_limit * LARGEST_BOUND * (1.0 + 1e-12))
    kept = [set_history(one, delay=delay, keeps_last_force=True) for one in own.past]
    kept += [set_history(loop.history, delay=-1.0, keeps_last_force=True)]
    last = [Hook(Stage.SHAPE, write_lines, own), Hook(Stage.KEEP, keep_lines, own, kept)]
    return [Hook(Stage.ADD, find_lines, own), Hook(Stage.LOWER, begin_lines, own)], last
