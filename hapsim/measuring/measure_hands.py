"""Springs and dampers of several linked hands: each is rung in turn, and what all feel is read from their free motion.

Of the scene nothing is known here but that something holds the hands. Rows of delayed positions of a free motion span
the state of what moves (Ho and Kalman, 1966; Juang and Pappa's eigensystem realisation, 1985): the poles z and how far
each hand goes in each, X. Of these the 2 n motions with most energy, s = ln(z)/T, have one k and b:
M X S² + b X S + k X = 0. Where noise hides all else, least squares go on from there: with 2 µm of noise k and b were
off by 0.3 % in place of 2 %, with 10 µm by 1.5 % in place of 50 % (medians).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple, Unpack

import numpy as np

from hapsim.errors import UsageError
from hapsim.loop.ring import BRIDGED, LATE_FORCE, LIMITED
from hapsim.measuring.converters import Complexes, Floats
from hapsim.measuring.measure import pushes
from hapsim.measuring.measurement_options import Run, RunOptions, require_above_zero, require_device_point
from hapsim.number_format import percent
from hapsim.one_thread import one_thread
from hapsim.recording.trace import Trace
from hapsim.running.run import run_to_end
from hapsim.scene import Scene
from hapsim.scene.load import SceneSource, as_scene

_SECONDS, _RINGS = 4.0, 4
_RUN_UP = 8  # samples after a push, until the force is over


def measure_hands(
    scene: SceneSource,
    *,
    channels: Sequence[int],
    duration: float | None = None,
    push: float | None = None,
    run: Run = run_to_end,
    **options: Unpack[RunOptions],
) -> HandsMeasurement:
    """Rings the hands on these channels, one after the other, and identifies what all of them feel.

    `duration`: seconds for each [default: 4]; `push`: N, the largest force. UsageError where their motion does not show
    as many springs and dampers. The rest as of `measure`.
    """
    scene = as_scene(scene)
    require_above_zero("seconds", duration=duration)
    require_above_zero(scene.units.name("newton"), push=push)
    traces, segments = [], list[Floats]()
    for channel in channels:
        require_device_point(scene, channel)
        seconds = _SECONDS if duration is None else duration
        every = int(seconds * scene.rate) // _RINGS
        excitation = replace(pushes(scene, channel, seconds, push), start=0, every=every, first=False)
        trace = run(scene, duration=seconds, excitation=excitation, **options)
        begins = np.arange(0, trace.sample[-1] if trace.sample.size else 0, every)
        traces.append(trace)
        quiet = excitation.ticks + _RUN_UP + math.ceil(scene.device.delay)
        segments += _free(trace, begins + quiet, begins + every, list(channels))
    mass = np.array([scene.device.masses(scene.channels)[channel] for channel in channels])
    with one_thread():
        return identify_rings(segments, mass, scene.rate, _is_held(scene, channels), tuple(channels), tuple(traces))


def _is_held(scene: Scene, channels: Sequence[int]) -> bool:
    """Whether something holds these hands at a place of rest: a constant of the motion that is none of theirs."""
    reached = {name for name, one in scene.device_points.items() if one.channel in channels}
    links, grounds = [{*one.between} for one in scene.links.values()], scene.grounds.keys()
    for _ in links:
        reached = reached.union(*(ends for ends in links if ends & reached - grounds))
    return bool(reached & grounds) or max(scene.device.stiffnesses(scene.channels)) > 0.0


def _free(trace: Trace, begins: Any, ends: Any, channels: list[int]) -> list[Floats]:
    """(samples, n) m: what was recorded without a gap, a late force or one at its limit, between two pushes."""
    bad = (trace.flags & (LATE_FORCE | BRIDGED | LIMITED)) != 0
    breaks = np.flatnonzero(bad | (np.diff(trace.sample, prepend=trace.sample[:1] - 1) != 1))
    found = []
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        first, last = np.searchsorted(trace.sample, [begin, end]).tolist()
        edges = [first, *breaks[(breaks >= first) & (breaks < last)].tolist(), last]
        found += [trace.position[low + (low != first) : high, channels] for low, high in pairwise(edges)]
    return found


DELAYS = 40  # rows of each hand
_SPANS = (0.4, 0.2)  # of a ring: from the first of these rows to the last; and once more, to compare
_CLEAR = 4.0  # times the noise: a motion
_MOST_ORDER = 60
_CONSTANT = 1e-3  # m beside a motion of 1 m: a row that stays the same
_TRIES = 8  # with as much noise again: how far off the numbers may be
_PAIRED = 1e-6
_BESIDE, _LOPSIDED = 0.1, 0.3  # of the energy; of the largest: more is no springs' and dampers'
_MOST_REFINED = 4  # hands
_MOST_COLUMNS = 3e8  # numbers of a singular value decomposition, rows squared times columns
_ROUNDED = 1e-6  # of the largest: less is not known, for the rounding of forces is no noise of the positions


@dataclass(frozen=True)
class HandsMeasurement:
    """k (n, n) in N/m and b (n, n) in N·s/m of n hands, with standard uncertainties: that of the masses not included.

    Beside the diagonal what one hand feels of another is negative.
    """

    channels: tuple[int, ...]
    k: Floats
    b: Floats
    k_uncertainty: Floats
    b_uncertainty: Floats
    poles: tuple[complex, ...]
    """Of the 2 n motions, z-plane."""
    others: float
    """What other motions had of the energy."""
    samples: int
    traces: tuple[Trace, ...]


class _Rings(NamedTuple):
    """What was seen of n hands ringing: poles (r,), positions (n, r) and energy (r,), the place of rest left out."""

    poles: Complexes
    hands: Complexes
    energy: Floats


def identify_rings(
    segments: list[Floats],
    mass: Floats,
    rate: float,
    is_held: bool,
    channels: tuple[int, ...],
    traces: tuple[Trace, ...],
) -> HandsMeasurement:
    """Of free motions, each (samples, n) m, of n hands of these masses (n,) kg. `is_held`: at a place of rest, which is
    then a constant that is no motion of theirs. UsageError where they do not show as many springs and dampers."""
    rests = _CONSTANT * is_held
    longest = max((len(one) for one in segments), default=0)
    segments = [one for one in segments if 2 * len(one) >= longest > 2 * DELAYS]
    if not segments:
        raise UsageError("too little of the free motion was recorded without a gap: record longer (--duration)")
    before, after, noise = _rows(segments, _SPANS[0], rests)
    rings, n = _rings(before, after, mass.size, noise), mass.size
    own = _own(rings, n)
    k, b = _matrices(rings, own, mass, rate)
    random = np.random.default_rng(0)

    def apart(tried: list[Floats], share: float) -> Floats:
        again = _rings(*_rows(tried, share, rests)[:2], n, noise)
        return np.asarray(_matrices(again, _own(again, n), mass, rate) - np.array([k, b]))

    noisy = ([one + noise * random.standard_normal(one.shape) for one in segments] for _ in range(_TRIES))
    spread = np.sqrt(np.mean([np.square(apart(one, _SPANS[0])) for one in noisy], axis=0))
    # Of a motion that obeys one law neither other rows nor half of the rings, of another size, say something else.
    others = [apart(segments, _SPANS[1])] + [apart(half, _SPANS[0]) for half in _halves(segments)]
    off = np.sqrt(spread**2 + np.square(others).max(axis=0))
    if rings.poles.size == 2 * n and n <= _MOST_REFINED:
        *finer, spread = _refined(segments, mass, rate, is_held, k, b)
        others = [np.array(_refined(half, mass, rate, is_held, *finer)[:2]) - finer for half in _halves(segments)]
        finer_off = np.sqrt(spread**2 + np.square(others).max(axis=0, initial=0.0))
        if finer_off.sum(axis=(1, 2)).prod() < off.sum(axis=(1, 2)).prod():
            (k, b), off = finer, finer_off
    least = _ROUNDED * np.abs([k, b]).max(axis=(1, 2))
    off = np.maximum(off, least[:, None, None])
    beside = 1.0 - float(rings.energy[own].sum() / rings.energy.sum())
    lopsided = float(np.abs(k - k.T).max() / np.abs(k).max(initial=1e-300))
    if beside > _BESIDE or lopsided > _LOPSIDED:
        raise UsageError(
            "the motion is not that of hands on springs and dampers between them: other motions have "
            f"{percent(beside, 2)} of the energy, or a contact opens, or what damps is beyond what swings. `hapsim "
            "measure --impedance` measures what they meet at each frequency"
        )
    samples, poles = sum(map(len, segments)), tuple(rings.poles[own].tolist())
    return HandsMeasurement(channels, k, b, off[0], off[1], poles, max(0.0, beside), samples, traces)


def _halves(segments: list[Floats]) -> list[list[Floats]]:
    """Every second ring, and the others, where there are as many."""
    return [segments[::2], segments[1::2]] if len(segments) > 3 else []


def _rows(segments: list[Floats], share: float, rests: float) -> tuple[Floats, Floats, float]:
    """Positions and, as a last one, a constant (rows, columns), `DELAYS` rows of each apart by the same samples, at
    every sample; the same a sample later; and the noise of a position, m, as the least of their singular values say."""
    span = int(share * min(map(len, segments)))
    delays = np.unique(np.rint(np.concatenate([[0.0], np.geomspace(1.0, span, DELAYS - 1)]))).astype(int).tolist()
    rows = len(delays) * segments[0].shape[1]
    step = math.ceil(sum(map(len, segments)) * rows**2 / _MOST_COLUMNS)
    size = float(max(np.abs(one).max() for one in segments))
    tables: tuple[list[Floats], list[Floats]] = ([], [])
    for one in segments:
        last = len(one) - span - 1
        for table, later in zip(tables, (0, 1), strict=True):
            late = [one[delay + later :][:last:step].T for delay in delays]
            table.append(np.vstack([*late, np.full((1, late[0].shape[1]), rests * size)]))
    before, after = np.hstack(tables[0]), np.hstack(tables[1])
    values = np.linalg.svd(before[:-1], compute_uv=False)
    return before, after, float(np.median(values[len(values) // 2 :])) / np.sqrt(before.shape[1])


def _rings(before: Floats, after: Floats, n: int, noise: float) -> _Rings:
    left, values, right = np.linalg.svd(before, full_matrices=False)
    order = min(int(np.count_nonzero(values > _CLEAR * noise * np.sqrt(before.shape[1]))), _MOST_ORDER)
    left, values, right = left[:, :order], values[:order], right[:order]
    poles, states = np.linalg.eig(left.T @ after @ right.T / values)
    shapes = left @ states
    amounts = np.linalg.solve(states, values[:, None] * right)
    times = (np.abs(amounts) ** 2).sum(axis=1)
    moves = np.abs(shapes[-1]) ** 2 * times <= 0.5 * (before[-1] ** 2).sum()
    energy = (np.abs(shapes[:n]) ** 2).sum(axis=0) * times
    return _Rings(poles[moves].astype(complex), shapes[:n, moves], energy[moves])


def _own(rings: _Rings, n: int) -> Any:
    """Which are the hands' own: those with most energy. UsageError where they are none of springs and dampers."""
    own = np.argsort(-rings.energy)[: 2 * n]
    poles = rings.poles[own]
    whole = len(own) == 2 * n and all(np.abs(poles - one.conjugate()).min() < _PAIRED for one in poles)
    if not whole or (poles.real[np.abs(poles.imag) < _PAIRED] <= 0.0).any():
        raise UsageError(
            f"the motion does not show the {2 * n} decaying swings of {n} hands on springs and dampers clearly: push "
            "harder (--push), or record longer (--duration)"
        )
    return own


def _matrices(rings: _Rings, own: Any, mass: Floats, rate: float) -> tuple[Floats, Floats]:
    hands, s = rings.hands[:, own], rate * np.log(rings.poles[own])
    both = -np.linalg.solve(np.vstack([hands, hands * s]).T, (mass[:, None] * hands * s**2).T).T.real
    return both[:, : mass.size], both[:, mass.size :]


def _refined(
    segments: list[Floats], mass: Floats, rate: float, is_held: bool, k: Floats, b: Floats
) -> tuple[Floats, Floats, Floats]:
    """k, b and their spread (2, n, n), by least squares of the records from a first k and b on, where nothing but the
    hands is seen to move: M x'' + b x' + k x = 0, each ring with a beginning of its own, and where they are held with
    a place of rest."""
    from scipy.optimize import least_squares

    n, length = mass.size, min(map(len, segments))
    data = np.stack([one[:length].ravel() for one in segments], axis=1)
    scale = np.abs([k, b]).max(axis=(1, 2))[:, None, None]
    time, rests = np.arange(length) / rate, np.broadcast_to(np.eye(n)[:, : n * is_held], (length, n, n * is_held))

    def left(numbers: Floats) -> Floats:
        stiffness, damping = numbers.reshape(2, n, n) * scale
        rates = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness / mass[:, None], -damping / mass[:, None]]])
        s, states = np.linalg.eig(rates)
        begun = np.exp(np.outer(time, s))[:, None, :] * states[:n] @ np.linalg.inv(states)
        moves = np.concatenate([begun.real, rests], axis=2).reshape(length * n, -1)
        along = np.linalg.qr(moves)[0]
        return np.asarray((data - along @ (along.T @ data)).ravel())

    size = float(np.sqrt(np.mean(left((np.array([k, b]) / scale).ravel()) ** 2)))
    best = least_squares(lambda numbers: left(numbers) / size, (np.array([k, b]) / scale).ravel())
    free = data.size - 3 * n * len(segments) - 2 * n * n
    covariance = np.linalg.inv(best.jac.T @ best.jac) * 2.0 * best.cost / free
    spread = np.sqrt(np.diag(covariance)).reshape(2, n, n) * scale
    found = best.x.reshape(2, n, n) * scale
    return found[0], found[1], np.asarray(spread)
