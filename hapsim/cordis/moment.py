"""The scene at one sample: what every module reads, and where it leaves its force."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined
from hapsim.cordis.device_point import DevicePoints, keep


class Moment(NamedTuple):
    """N points at sample n. Positions in m, force in N, shape (N,) each; the arrays are the program's, not copies."""

    position: NDArray[np.float64]
    """x[n]"""
    previous: NDArray[np.float64]
    """x[n-1]"""
    following: NDArray[np.float64]
    """x[n+1], to be written."""
    force: NDArray[np.float64]
    devices: DevicePoints
    velocity: NDArray[np.float64]
    """m/s, what the device senses, one per channel."""


@inlined
def moment_of(program, velocity):
    """The program's moment. Its three rows of positions take turns, so that no sample is ever copied."""
    now, after, before = _turns(program.turn)
    rows = program.rows
    return Moment(rows[now], rows[before], rows[after], program.force, program.devices, velocity)


@inlined
def pass_on(program, moment):
    """The following sample becomes the one at hand; where nothing but the hand moves, it is kept where it was."""
    _pass_on(program.turn, moment)


@inlined
def _turns(turn):
    if turn is None:
        return np.uint64(0), np.uint64(1), np.uint64(2)
    now = turn[0]
    before = now - np.uint64(1) if now > 0 else np.uint64(2)
    return now, now + np.uint64(1) if now < 2 else np.uint64(0), before


@inlined
def _pass_on(turn, moment):
    if turn is None:
        keep(moment.devices, moment.velocity, moment.position, moment.previous)
    else:
        now = turn[0]
        turn[0] = now + np.uint64(1) if now < 2 else np.uint64(0)
