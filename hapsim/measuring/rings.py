"""The springs and dampers of several hands, out of records of their free motion, and of nothing else.

Rows of delayed positions of a free motion span the state of what moves (Ho and Kalman, 1966; Juang and Pappa's
eigensystem realisation, 1985): the poles z and how far each hand goes in each, X. Of these the 2 n motions with most
energy, s = ln(z)/T, have one k and b: M X S² + b X S + k X = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hapsim.errors import UsageError
from hapsim.measuring.converters import Complexes, Floats
from hapsim.recording.trace import Trace

DELAYS = 40  # rows of each hand
_SPANS = (0.4, 0.2)  # of a ring: from the first of these rows to the last; and once more, to compare
_CLEAR = 4.0  # times the noise: a motion
_MOST_ORDER = 60
_CONSTANT = 1e-3  # m beside a motion of 1 m: a row that stays the same
_TRIES = 8  # with as much noise again: how far off the numbers may be
_PAIRED = 1e-6
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
    tries = []
    for span in (*_TRIES * _SPANS[:1], _SPANS[1]):
        rough = [one + (span == _SPANS[0]) * noise * random.standard_normal(one.shape) for one in segments]
        again = _rings(*_rows(rough, span, rests)[:2], n, noise)
        tries.append(_matrices(again, _own(again, n), mass, rate) - np.array([k, b]))
    off = np.hypot(np.sqrt(np.mean(np.square(tries[:-1]), axis=0)), tries[-1])
    least = _ROUNDED * np.abs([k, b]).max(axis=(1, 2))
    off = np.maximum(off, least[:, None, None])
    others = 1.0 - float(rings.energy[own].sum() / rings.energy.sum())
    samples = sum(map(len, segments))
    poles = tuple(rings.poles[own].tolist())
    return HandsMeasurement(channels, k, b, off[0], off[1], poles, max(0.0, others), samples, traces)


def _rows(segments: list[Floats], share: float, rests: float) -> tuple[Floats, Floats, float]:
    """Positions and, as a last one, a constant (rows, columns), `DELAYS` rows of each apart by the same samples, at
    every sample; the same a sample later; and the noise of a position, m, as the least of their singular values say."""
    span = int(share * min(map(len, segments)))
    delays = np.unique(np.rint(np.concatenate([[0.0], np.geomspace(1.0, span, DELAYS - 1)]))).astype(int).tolist()
    size = float(max(np.abs(one).max() for one in segments))
    tables: tuple[list[Floats], list[Floats]] = ([], [])
    for one in segments:
        last = len(one) - span - 1
        for table, later in zip(tables, (0, 1), strict=True):
            rows = [one[delay + later :][:last].T for delay in delays]
            table.append(np.vstack([*rows, np.full((1, last), rests * size)]))
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
