"""A recorded branch, smooth, no steeper than can be rendered, and by few points."""

from __future__ import annotations

import math

import numpy as np

from hapsim.curves.recording import Branch, _shared
from hapsim.errors import UsageError
from hapsim.theory.arrays import Floats

_BINS = 1000  # over the range: repeated distances are averaged, and a spline of as many points takes some 0.3 s
_GRID = 801  # points of which those of the curve are chosen
_FEWEST = 8  # that a spline smooths


def smooth(branches: list[Branch]) -> tuple[Floats, list[Floats]]:
    """Returns distances, m, and the forces of each branch there, N: the spline that predicts left-out rows best
    (generalised cross-validation)."""
    low, high = _shared(branches)
    x = np.linspace(low, high, _GRID)
    each = [_spline(one, low, high)(x) for one in branches]
    if len(each) == 2:  # noise alone makes a crossing
        mean, half = 0.5 * (each[0] + each[1]), np.maximum(0.5 * (each[0] - each[1]), 0.0)
        each = [mean + half, mean - half]
    return x, each


def _spline(branch: Branch, low: float, high: float):  # type: ignore[no-untyped-def]
    """Returns a function of distances between these two."""
    from scipy.interpolate import make_smoothing_spline

    within = (branch.x >= low) & (branch.x <= high)
    x, force = (branch.x[within] - low) / (high - low) * _BINS, branch.force[within]
    number = np.minimum(x.astype(int), _BINS - 1)
    rows = np.bincount(number)
    has = rows > 0
    at, mean = (np.bincount(number, of)[has] / rows[has] for of in (x, force))
    if at.size < _FEWEST:
        return lambda of: np.interp((of - low) / (high - low) * _BINS, at, mean)
    with np.errstate(all="ignore"):
        spline = make_smoothing_spline(at, mean, rows[has])
    return lambda of: spline(np.clip((of - low) / (high - low) * _BINS, at[0], at[-1]))


def limited(x: Floats, branches: list[Floats], steepest: float) -> tuple[Floats, list[Floats]]:
    """Returns distances and forces that rise by `steepest` N/m at most and push nowhere harder than before. Beyond both
    ends the branches go on until they reach what they had there."""
    each, step = [], x[1] - x[0]
    for force in branches:
        pushed = np.minimum.accumulate(np.maximum(force, 0.0) - steepest * x) + steepest * x
        pulled = np.maximum.accumulate((np.minimum(force, 0.0) - steepest * x)[::-1])[::-1] + steepest * x
        # Where the force changes its sign, both may rise in one step.
        each.append(np.minimum.accumulate(pushed + pulled - steepest * x) + steepest * x)
    for at, way in ((0, -1.0), (-1, 1.0)):
        lacks = [float(force[at] - made[at]) for force, made in zip(branches, each, strict=True)]
        if (room := max(map(abs, lacks)) / steepest) > step:
            where = 0 if at == 0 else x.size
            x = np.insert(x, where, x[at] + way * room)
            each = [np.insert(made, where, made[at] + lack) for made, lack in zip(each, lacks, strict=True)]
            branches = [np.insert(force, where, force[at]) for force in branches]
    return x, each


def thinned(x: Floats, branches: list[Floats], within: float, narrowest: float) -> list[int]:
    """Returns the indices of the fewest points of these branches between which straight lines stay `within` N of them,
    none nearer to the next than `narrowest` m. Where a branch has its peaks and valleys, there is a point: they are
    what a hand tells apart, and the energy of a flank is that between them."""
    from scipy.signal import find_peaks

    each = [find_peaks(sign * force, prominence=2.0 * within)[0] for force in branches for sign in (1.0, -1.0)]
    kept = np.append(np.unique(np.concatenate(each)), x.size - 1)
    kept = kept[np.concatenate((np.diff(x[kept]) >= narrowest, [True]))]
    needed = np.full(x.size, np.inf)
    needed[0], before = 0.0, np.zeros(x.size, int)
    for i in range(x.size - 1):
        if not math.isfinite(needed[i]):
            continue
        way = x[i + 1 :] - x[i]
        good = way >= min(narrowest, way[-1])
        for force in branches:
            slope = (force[i + 1 :] - force[i]) / way
            least = np.maximum.accumulate(slope - within / way)
            most = np.minimum.accumulate(slope + within / way)
            good &= (slope >= least) & (slope <= most)
        good[kept[np.searchsorted(kept, i, "right")] - i :] = False
        better = good & (needed[i] + 1.0 < needed[i + 1 :])
        needed[i + 1 :][better], before[i + 1 :][better] = needed[i] + 1.0, i
    if not math.isfinite(needed[-1]):
        raise UsageError("no curve of such points stays that close")
    path = [x.size - 1]
    while path[-1]:
        path.append(int(before[path[-1]]))
    return path[::-1]
