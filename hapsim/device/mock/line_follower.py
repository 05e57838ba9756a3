"""The mock's own force law, compiled: it follows the host's lines at its local rate (PROTOCOL.md, section 6.1).

A sample has `steps` local periods. In each the mock measures, computes a force in counts, and moves by the force that
was computed `delay` periods before: exactly, because that force is level.
"""

from __future__ import annotations

from typing import Any

from numba import types

from firmware_protocol import schema
from firmware_protocol.lines import bound_in_force_counts, line_force, unpack_line
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import native
from hapsim.device.mock.motion import move
from hapsim.device.mock.record import KEPT_REPORTS, mock_at
from hapsim.device.mock.sampler import noise, to_counts


@native(types.void, types.uint64)
def _begin(mock):
    """Begins without a line, at rest where the first position was measured."""
    mock = mock_at(mock)
    follower = mock.follower
    for c in range(mock.channels):
        for row in range(mock.depth):
            _end(follower.lines[row, c])
        for i in range(follower.window):
            follower.past[i, c] = mock.counts[c]


@native(types.int64, types.uint64)
def _take(mock):
    """Takes the lines of a FORCE for the current sample. Returns 0, and counts an error of form, if a low is above its
    high."""
    mock = mock_at(mock)
    follower, counts, n = mock.follower, mock.decoder.counts, mock.board.n
    for c in range(mock.channels):
        _, _, low, high = unpack_line(*_words(mock, c))
        if low > high:
            mock.decoder.form_errors += 1
            return 0
    age = (n - mock.decoder.number) % schema.SAMPLE_MODULUS
    for c in range(mock.channels):
        line = follower.lines[n % mock.depth, c]
        stiffness, damping, low, high = unpack_line(*_words(mock, c))
        line.force = counts[c]
        line.stiffness = _within(mock, stiffness, -follower.largest[c, 0], follower.largest[c, 0])
        line.damping = _within(mock, damping, 0, follower.largest[c, 1])
        line.low = bound_in_force_counts(low, follower.limit[c])
        line.high = bound_in_force_counts(high, follower.limit[c])
        line.position = mock.counts[c] if age == 0 else follower.reports[(n - age) % KEPT_REPORTS, c]
    return 1


@native(types.void, types.uint64, types.float64, types.float64)
def _advance(mock, acts, h):  # noqa: ARG001  no host paces a device with lines, so forces act through the sample
    """Moves the bodies through a sample of `h` seconds."""
    mock = mock_at(mock)
    follower, n = mock.follower, mock.board.n
    for c in range(mock.channels):
        if mock.board.accepted != n:
            _hold(mock, c, n)
        follower.reports[n % KEPT_REPORTS, c] = mock.counts[c]
        for step in range(follower.steps):
            mock.bodies[c].slope = 0.0
            force = _follow(mock, c, n * follower.steps + step, step) * mock.force_scale[c]
            move(mock.called.move, mock.bodies[c], force, h / follower.steps)


@helper
def _follow(mock, c, at, step):
    """Measures in local period `at` since arming, the `step`th of its sample; returns the force that acts, counts."""
    follower, converter = mock.follower, mock.converters[c]
    x = mock.counts[c]
    if step > 0:
        x, _ = to_counts(mock.bodies[c].position + noise(converter, converter.noise), converter.quantum)
    line = follower.lines[(at - follower.late) // follower.steps % mock.depth, c]
    past, shifts = at % follower.window, (follower.shifts[c, 0], follower.shifts[c, 1])
    ahead, moved = x - line.position, x - follower.past[past, c]
    follower.past[past, c] = x
    slots = follower.delay + 1
    force = line_force(line.force, line.stiffness, line.damping, line.low, line.high, ahead, moved, shifts)
    follower.under_way[(at + follower.delay) % slots, c] = force
    if abs(force) >= follower.limit[c]:
        mock.registers[schema.REG_LIMITED] += 1
    return follower.under_way[at % slots, c]


@helper
def _hold(mock, c, n):
    """Continues the line before in a sample without a FORCE, until its time to live ends. A negative stiffness ends."""
    line, before = mock.follower.lines[n % mock.depth, c], mock.follower.lines[(n - 1) % mock.depth, c]
    if n > mock.board.expires:
        _end(line)
        return
    line.force, line.position, line.damping = before.force, before.position, before.damping
    line.low, line.high, line.stiffness = before.low, before.high, max(before.stiffness, 0)


@inlined
def _end(line):
    line.force = line.stiffness = line.damping = line.low = line.high = line.position = 0


@inlined
def _words(mock, c):
    at = mock.channels + 2 * c
    return mock.decoder.counts[at], mock.decoder.counts[at + 1]


@inlined
def _within(mock, count, least, most):
    if least <= count <= most:
        return count
    mock.registers[schema.REG_LIMITED] += 1
    return most if count > most else least


FUNCTIONS = {"begin_following": _begin, "take_followed": _take, "advance_following": _advance}
"""Functions by their names in CALLED."""


def follow_lines(mock: Any) -> None:
    """Lets a MOCK with a description of lines follow them when it is armed so."""
    for name, function in FUNCTIONS.items():
        mock.called[name] = function.address()
