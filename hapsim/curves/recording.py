"""Recordings of force over distance: the strokes that press and those that release."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hapsim.errors import UsageError
from hapsim.scene.curve_file import CurveTable
from hapsim.theory.arrays import Floats
from hapsim.units import Motion, Units, Written

_TURN = 0.1  # of the range: a shorter way back is noise, or a stroke that was not finished
_WHOLE = 0.5  # of the longest stroke: shorter ones do not count
_ONE_SIDED = 0.3  # of the largest force: a mean beyond that is a button's, and its sign is to be that of a resistance
_GIVES = 0.01  # of the largest force, by which releasing exceeds pressing: less is noise
_SHARED = 0.5  # of the range, that both branches have at least


class Branch(NamedTuple):
    """Rows of a recording in which the distance grows, or shrinks."""

    x: Floats
    """Distances, m, as recorded: repeated, and in any order."""
    force: Floats
    """Forces, N, against growing distance."""


class Recording(NamedTuple):
    """Force over distance, as an instrument recorded it.

    Distances and forces count so that pressing takes energy: as a link's curve has them.
    """

    branches: list[Branch]
    """Press and release, or one without a return."""
    motion: Motion
    written: tuple[Written, ...]
    strokes: int
    """Number of strokes that count; 0 if the file has a column for each branch."""
    rows: int
    notes: list[str]
    """Changes of what the file has, in sentences."""

    @property
    def units(self) -> Units:
        """The units of its file."""
        return Units.of([self.motion], self.written)


def recording_of(tables: list[CurveTable]) -> Recording:
    """Returns the recording of a file, or of two: one of each branch. Raises UsageError if it has no branch."""
    first = tables[0]
    if len({table.motion for table in tables}) > 1:
        raise UsageError(f"{tables[1].name}:{tables[1].head}: found another motion than in {first.name}")
    xs = [np.array(x) for table in tables for x in table.of("m")]
    forces = [np.array(force) for table in tables for force in table.of("N")]
    if len(tables) > 1 and len(forces) > 2:
        raise UsageError(f"{tables[1].name}: found two columns of forces, expected one beside another file")
    notes: list[str] = []
    if len(forces) == 1:
        branches, strokes = _split(xs[0], forces[0], notes)
    else:
        branches, strokes = [Branch(xs[0], forces[0]), Branch(xs[-1], forces[1])], 0
    recording = Recording(branches, first.motion, first.written, strokes, sum(len(one.rows) for one in tables), notes)
    return _placed(_resisting(recording))


def _split(x: Floats, force: Floats, notes: list[str]) -> tuple[list[Branch], int]:
    """Returns the branches of one column, and the number of strokes."""
    ends = _turns(x.tolist(), _TURN * float(np.ptp(x)))
    strokes = [(a, b) for a, b in pairwise(ends)]
    longest = max(abs(x[b] - x[a]) for a, b in strokes)
    whole = [(a, b) for a, b in strokes if abs(x[b] - x[a]) >= _WHOLE * longest]
    if few := len(strokes) - len(whole):
        notes.append(f"{few} of {len(strokes)} strokes are shorter than half the longest, and do not count.")
    ways = [[slice(a, b + 1) for a, b in whole if bool(x[b] > x[a]) is up] for up in (True, False)]
    branches = [Branch(*(np.concatenate([of[one] for one in way]) for of in (x, force))) for way in ways if way]
    if len(branches) == 1:
        notes.append("The recording never turns: the curve has one branch, without hysteresis.")
    return branches, len(whole)


def _turns(x: list[float], way: float) -> list[int]:
    """Returns the indices at which the motion turns by more than a way, with those of its ends."""
    low = high = at = 0
    ends: list[int] = []
    rises = True
    for i, value in enumerate(x):
        if not ends:
            low, high = (i if value < x[low] else low), (i if value > x[high] else high)
            if x[high] - x[low] > way:
                rises, at = high > low, max(low, high)
                ends.append(min(low, high))
        elif (value >= x[at]) if rises else (value <= x[at]):
            at = i  # a rest at the end belongs to the way there
        elif abs(value - x[at]) > way:
            ends.append(at)
            rises, at = not rises, i
    return [*ends, at]


def _resisting(recording: Recording) -> Recording:
    """Returns the recording with signs by which pressing takes energy, and a button's force is positive."""
    branches, notes = recording.branches, recording.notes
    force = np.concatenate([one.force for one in branches])
    is_negative = float(force.mean()) < -_ONE_SIDED * float(np.abs(force).max())
    if len(branches) == 1:
        flips = is_negative
        mirrors = False
    else:
        low, high = _shared(branches)
        x = np.linspace(low, high, 501)
        press, release = (_mean_at(one, x) for one in branches)
        gives = float(np.mean(press - release)) < -_GIVES * float(np.abs(force).max())
        flips = gives and is_negative
        mirrors = gives and not is_negative and recording.strokes > 0
        if gives and recording.strokes == 0 and not is_negative:
            branches = branches[::-1]
            notes.append("The second column has more force than the first: it is taken as that of pressing.")
    if flips:
        branches = [Branch(one.x, -one.force) for one in branches]
        notes.append("Forces have the other sign, so that pressing takes energy.")
    if mirrors:
        branches = [Branch(-one.x, one.force) for one in branches][::-1]
        notes.append("Distances have the other sign, so that pressing takes energy.")
    return recording._replace(branches=branches)


def _placed(recording: Recording) -> Recording:
    """Returns the recording with distances from its beginning, unless 0 lies in or near its range."""
    low = min(float(one.x.min()) for one in recording.branches)
    high = max(float(one.x.max()) for one in recording.branches)
    room = 0.1 * (high - low)
    if low - room <= 0.0 <= high + room:
        return recording
    recording.notes.append(f"Distances count from {recording.units(low, 'mm')} of the recording.")
    return recording._replace(branches=[Branch(one.x - low, one.force) for one in recording.branches])


def _shared(branches: list[Branch]) -> tuple[float, float]:
    """Returns the range that all branches have. Raises UsageError if it is short."""
    low, high = max(float(one.x.min()) for one in branches), min(float(one.x.max()) for one in branches)
    if high - low < _SHARED * max(float(np.ptp(one.x)) for one in branches):
        raise UsageError("the branches share less than half of their distances; expected press and release of one way")
    return low, high


def _mean_at(branch: Branch, x: Floats) -> Floats:
    order = np.argsort(branch.x, kind="stable")
    return np.interp(x, branch.x[order], branch.force[order])
