"""The string: equal masses in a row, moved in one pass over contiguous memory.

Each mass is the one of `mass.py`, each link the one of `damper_backward.py`. With the sum of neighbours
s[i] = x[i-1] + x[i+1], and a = T²/m K, b = T²/m B/T, e = T²/m (friction)/T, their recurrences together are

    x[n+1] = (2 - 2 (a + b) - e) x[n] + (a + b) s[n] - (1 - 2 b - e) x[n-1] - b s[n-1]

A string stands in memory between two borders. The border of an end that is held stays where it is; that of a free end
follows its neighbour, so that the link to it is never stretched. Forces of other links reach only the masses that they
hold: those are moved once more, and no other mass is asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import fused, inlined
from hapsim.cordis.acting import moves, settles
from hapsim.cordis.kind import Column, Frame, Kind
from hapsim.cordis.mass import mobility_of
from hapsim.scene import Scene, String

_LANES = np.uint64(16)  # masses that the compiler moves at once


class Rows(NamedTuple):
    """S strings: where their left border is, how many masses each has, and which ends are free (S, 2)."""

    border: NDArray[np.uint64]
    masses: NDArray[np.uint64]
    free: NDArray[np.bool_]


class Held(NamedTuple):
    """The H masses of a structure that links hold, by number, and their T²/m in m/N."""

    point: NDArray[np.uint32]
    mobility: Column


class Strings(NamedTuple):
    """S strings: T²/m in m/N; K, B/T and friction/T in N/m; shape (S,)."""

    rows: Rows
    mobility: Column
    stiffness: Column
    damping_per_sample: Column
    friction_per_sample: Column
    held: Held | None


def _select(scene: Scene) -> Mapping[str, String]:
    return {name: one for name, one in scene.modules.items() if isinstance(one, String) and not one.bending}


def live_string(strings: Sequence[String], rate: float) -> list[list[float]]:
    """K, and what it and its friction do in a sample, in N/m."""
    return [
        [one.stiffness for one in strings],
        [one.damping * rate for one in strings],
        [one.friction * rate for one in strings],
    ]


def rows_of(strings: Mapping[str, String], frame: Frame) -> Rows:
    """Where these strings stand."""
    return Rows(
        np.array([frame.number[f"{name}.0"] - 1 for name in strings], np.uint64),
        np.array([one.masses for one in strings.values()], np.uint64),
        np.array([[end == "free" for end in one.ends] for one in strings.values()]),
    )


def held_of(points: Mapping[str, float], frame: Frame) -> Held | None:
    """Those of the points, by name and mass in kg, that a link holds; None where none does."""
    held = {frame.number[name]: mass for name, mass in points.items() if frame.number[name] in frame.touched}
    if not held:
        return None
    return Held(np.array(list(held), np.uint32), mobility_of(list(held.values()), frame))


def _build(strings: Mapping[str, String], columns: Sequence[Column], frame: Frame) -> Strings:
    masses = {f"{name}.{place}": one.mass for name, one in strings.items() for place in one.places()}
    mobility = mobility_of([one.mass for one in strings.values()], frame)
    stiffness, damping, friction = columns
    return Strings(rows_of(strings, frame), mobility, stiffness, damping, friction, held_of(masses, frame))


def string_layout(string: String) -> tuple[Sequence[int], int]:
    """A border, the masses, a border."""
    return range(1, string.masses + 1), string.masses + 2


STRING = Kind(
    _select,
    _build,
    live_string,
    string_layout,
    name="strings",
    compiled_as="a stencil over contiguous memory; only the masses that links hold are asked for a force",
)


@settles(Strings)
@inlined
def settle_strings(strings, moment):
    """Before the first tick: a free end's border follows its neighbour."""
    for s in range(strings.rows.border.size):
        free_ends(strings.rows, s, moment.previous)


@moves(Strings)
@inlined
def advance_strings(strings, moment):
    """Moves every string by one sample."""
    rows = strings.rows
    for s in range(rows.border.size):
        free_ends(rows, s, moment.position)
        first, size = rows.border[s], rows.masses[s] + np.uint64(2)
        _advance(
            moment.position[first : first + size],
            moment.previous[first : first + size],
            moment.following[first : first + size],
            strings.mobility[s] * strings.stiffness[s],
            strings.mobility[s] * strings.damping_per_sample[s],
            strings.mobility[s] * strings.friction_per_sample[s],
        )
    push_held(strings.held, moment)


@inlined
def free_ends(rows, s, position):
    """The border of a free end goes where its neighbour is."""
    left, right = rows.border[s], rows.border[s] + rows.masses[s] + np.uint64(1)
    if rows.free[s, 0]:
        position[left] = position[left + np.uint64(1)]
    if rows.free[s, 1]:
        position[right] = position[right - np.uint64(1)]


@inlined
def push_held(held, moment):
    """Adds to the motion of each mass that links hold what their force on it does, and forgets the force."""
    if held is None:
        return
    for h in range(held.point.size):
        p = held.point[h]
        moment.following[p] += held.mobility[h] * moment.force[p]
        moment.force[p] = 0.0


@inlined
def _advance(x, before, after, a, b, e):
    """One string with its borders: `a`, `b`, `e` as above.

    The loop is left to the compiler to do many masses at once. What does not fill its last round is done by going over
    some masses a second time, which changes nothing: a sample is never worked out from itself.
    """
    real = x.dtype.type
    sum_now, now = a + b, real(2) - real(2) * (a + b) - e
    sum_before, old = b, real(1) - real(2) * b - e
    masses = np.uint64(x.size - 2)
    if masses < _LANES:
        for i in range(masses):
            _move(x, before, after, i, now, sum_now, old, sum_before)
        return
    for i in range(masses & ~(_LANES - np.uint64(1))):
        _move(x, before, after, i, now, sum_now, old, sum_before)
    rest = masses & (_LANES - np.uint64(1))
    if rest > np.uint64(8):
        for i in range(np.uint64(16)):
            _move(x, before, after, masses - np.uint64(16) + i, now, sum_now, old, sum_before)
    elif rest > np.uint64(4):
        for i in range(np.uint64(8)):
            _move(x, before, after, masses - np.uint64(8) + i, now, sum_now, old, sum_before)
    elif rest > np.uint64(0):
        for i in range(np.uint64(4)):
            _move(x, before, after, masses - np.uint64(4) + i, now, sum_now, old, sum_before)


@fused
def _move(x, before, after, i, now, sum_now, old, sum_before):
    """Mass i, whose left neighbour stands at i, and itself at i + 1."""
    here, right = i + np.uint64(1), i + np.uint64(2)
    after[here] = (
        now * x[here] + sum_now * (x[i] + x[right]) - old * before[here] - sum_before * (before[i] + before[right])
    )
