"""Factors of one link's stiffness, or damping, at which a pole of the loop crosses the unit circle.

The change is of rank one. With s u v' added to the change A of a sample, a pole stands at z if s g(z) = 1, where g(z) =
v'(z - M)^-1 u and M = 1 + A. On the circle s is real if g(z) = g(1/z). Since

    (z - M)^-1 - (1/z - M)^-1 = (1/z - z) ((z - M)(1/z - M))^-1,      (z - M)(1/z - M) = A² + y M,

with y = 2 - z - 1/z, which is 4 sin²(angle/2) on the circle, the crossings are the zeros of h(y) = v'(A² + y M)^-1 u
between 0 and 4, and z = 1 and z = -1. With P = A² + y0 M and G = P^-1 M the zeros are those y for which -1/(y - y0) is
an eigenvalue of G - P^-1 u v'G/h(y0): as many as the state has numbers, in real arithmetic, and slow ones to all their
digits. There s = 1/g.

For a few links of a large scene the circle is sampled, and a sign change of Im s refined. The least factor above 1 is
the margin of a stable loop. Each place costs one factorisation of a sparse matrix.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from hapsim.one_thread import one_thread
from hapsim.theory.arrays import Complexes, Floats, Indices
from hapsim.theory.network.large_loop import PIVOTS, factorised
from hapsim.theory.network.network import Network
from hapsim.theory.rows import Rows, cut, geometry_of, times, unit_rows
from hapsim.theory.sample import loop, sizes_of

OUTSIDE = 1e-12  # radius of the circle minus 1: poles that rest on 1, or never lose energy, lie inside
REAL = 1e-6  # of |y|: a smaller imaginary part is rounding, or two crossings that nearly meet
SHIFTS = (-0.011, -0.037, -0.13, -0.41)
AT_ONCE = 4_000_000  # complex numbers in memory


def in_blocks(count: int, size: int) -> Iterator[slice]:
    """Yields slices of `count` places, short enough that a system of this size for each place fits into memory."""
    step = max(1, AT_ONCE // max(1, size) ** 2)
    yield from (slice(start, start + step) for start in range(0, count, step))


class LinkChanges(NamedTuple):
    """Changes of links: a stiffness or damping that is multiplied by 1 + s adds s ``pushed`` ``read``' to ``change``.
    ``pushed`` is (size, L), ``read`` (L, size), for stiffness and for damping."""

    change: Rows
    pushed: Rows
    read: tuple[Rows, Rows]


def link_changes(network: Network, sparse: bool = False) -> LinkChanges:
    """Returns the changes for a scene whose points CORDIS's scheme moves once a sample."""
    change, _, push, _, (stretch, rate), _ = loop(network, inputs=True, sparse=sparse)
    read = times(-network.stiffness, stretch), times(-network.damping * network.rate, rate)
    return LinkChanges(change, push @ geometry_of(network, sparse)[1].T, read)


def on_circle(angle: Floats, outside: float = 0.0) -> Complexes:
    """Returns w = z - 1, to all its digits, at these angles on a circle of radius 1 + ``outside``."""
    return np.asarray(outside * np.exp(1j * angle) - 2.0 * np.sin(0.5 * angle) ** 2 + 1j * np.sin(angle))


class Crossings:
    """Crossings of a loop; the parts that all links share are computed once."""

    def __init__(self, links: LinkChanges) -> None:
        self._links = links
        one = np.eye(len(self._links.change))
        step = (self._links.change - OUTSIDE * one) / (1.0 + OUTSIDE)
        matrix = one + step
        self._shift = _far_from_poles(step)
        shifted = step @ step + self._shift * matrix
        self._reached, self._common = 0.0 * self._links.pushed, matrix
        with suppress(np.linalg.LinAlgError):  # numbers too far apart: all factors found are tested anyway
            self._common = np.linalg.solve(shifted, matrix)
            self._reached = np.linalg.solve(shifted, self._links.pushed)

    @np.errstate(all="ignore")
    def factors(self, link: int, quantity: int) -> Floats:
        """Returns the positive factors of the link's stiffness (0) or damping (1), ascending, at which a pole crosses
        the circle; also some at which one only touches it."""
        u, v, reached = self._links.pushed[:, link], self._links.read[quantity][link], self._reached[:, link]
        at_shift = float(v @ reached)
        angles = np.array([0.0, np.pi])
        if at_shift != 0.0:
            change = np.outer(reached, v @ self._common / at_shift)
            y = self._shift - 1.0 / np.linalg.eigvals(self._common - change)
            real = (np.abs(y.imag) <= REAL * np.abs(y)) & (y.real > 0.0) & (y.real < 4.0)
            angles = np.append(angles, 2.0 * np.arcsin(0.5 * np.sqrt(y.real[real])))
        w, one = on_circle(angles, OUTSIDE)[:, None, None], np.eye(u.size)
        states = [_solved(w[part] * one - self._links.change, u) for part in in_blocks(w.size, u.size)]
        factors = 1.0 + (1.0 / (np.concatenate(states) @ v)).real
        return np.sort(factors[np.isfinite(factors) & (factors > 0.0)])


@np.errstate(all="ignore")  # a pole at 0 is infinitely far
def _far_from_poles(step: Floats) -> float:
    """Returns a y below 0 that is far from every pole."""
    w = np.linalg.eigvals(step).astype(complex)
    y = np.nan_to_num(-(w**2) / (1.0 + w), nan=np.inf)
    return max(SHIFTS, key=lambda shift: float(np.abs(y / shift - 1.0).min(initial=1.0)))


def _solved(matrices: Complexes, u: Floats) -> Complexes:
    """Solutions (n, size); NaN where a matrix has no inverse."""
    try:
        return np.asarray(np.linalg.solve(matrices, u[:, None] + 0j))[..., 0]
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full((1, u.size), np.nan, dtype=complex)
        return np.concatenate([_solved(one[None], u) for one in matrices])


WORK = 1.2e7  # points times places on the circle: some seconds
FEWEST, MOST = 400, 2500  # places
TURN = 0.7  # logarithm of the largest factor between the changes at two places, in size and in angle
CLOSE = 1e-9  # radians: smallest distance of two places
RESTS = 1e-9  # a pole this close to the circle is on it
NEARBY = (0.0, 1.0, 3.0)  # widths of a resonance at which its surroundings are sampled
FAR = 2.0  # limit of the refined crossings, as a multiple of the nearest one's distance from 1


def margins_along_circle(network: Network, links: Indices, poles: Complexes) -> tuple[Floats, str]:
    """Returns the factors of stiffness and damping of a stable scene, (links, 2), and a phrase on the sampling."""
    matrix = _PoleChanges(network)
    points = network.channel_mass.size + network.point_mass.size
    most = int(min(MOST, max(FEWEST, WORK / points)))
    with one_thread(), np.errstate(all="ignore"):
        angles = _angles_about(poles, most // 2)
        changes = matrix.at(angles, links)
        while angles.size < most:
            turn = np.abs(np.log(changes[:, :, 1:] / changes[:, :, :-1]))
            turn = np.nan_to_num(turn, nan=0.0, posinf=0.0).max(axis=(0, 1), initial=0.0)
            fast = np.flatnonzero((turn > TURN) & (np.diff(angles) > CLOSE))
            if not fast.size:
                break
            fast = fast[np.argsort(-turn[fast], kind="stable")][: most - angles.size]
            more = 0.5 * (angles[fast] + angles[fast + 1])
            order = np.argsort(np.append(angles, more))
            changes = np.concatenate([changes, matrix.at(more, links)], axis=2)[:, :, order]
            angles = np.append(angles, more)[order]
        factors = np.array(
            [
                [_margin(matrix, link, of, angles, changes[of, i]) for of in (0, 1)]
                for i, link in enumerate(links.tolist())
            ]
        )
    coarse = ", too coarse for the scene's resonances: a true margin may be nearer to 1" if angles.size >= most else ""
    return factors, f"the circle was sampled at {angles.size} angles{coarse}"


class _PoleChanges:
    """Relative changes of a link's stiffness, and of its damping, that place a pole at a given z. A mass's last step is
    1 - 1/z times its position. CORDIS's scheme has two equations for a mass; that of the step implies both."""

    def __init__(self, network: Network) -> None:
        change, self._pushed, self._read = link_changes(network, sparse=True)
        parts = cut(np.arange(change.shape[0]), sizes_of(network))
        self._mass, self._step = parts["mass"], parts["mass_step"]
        self._kept = np.setdiff1d(np.arange(change.shape[0]), self._step)
        is_mass = np.isin(self._kept, self._mass)
        self._rows = self._kept.copy()
        self._rows[is_mass] = self._step
        one, rows = unit_rows(self._kept.size, True), change[self._rows]
        self._constant, self._turning = rows[:, self._kept], rows[:, self._step] @ one[is_mass]
        self._of_rest, self._of_masses = one.multiply(~is_mass[:, None]), one.multiply(is_mass[:, None])

    def at(self, angles: Floats, links: Indices) -> Complexes:
        """Changes (2, links, n) at these angles."""
        pushed, read = self._pushed[:, links].toarray() + 0j, [rows[links].toarray().T for rows in self._read]
        found = np.full((2, links.size, angles.size), np.nan, dtype=complex)
        states = np.empty_like(pushed)
        for n, w in enumerate(on_circle(angles, OUTSIDE).tolist()):
            turn = w / (1.0 + w)
            left = w * (self._of_rest + turn * self._of_masses) - self._constant - turn * self._turning
            if (solve := factorised(left, **PIVOTS)) is not None:
                states[self._kept] = solve(pushed[self._rows])
                states[self._step] = turn * states[self._mass]
                found[:, :, n] = [1.0 / (rows * states).sum(axis=0) for rows in read]
        return found


def _angles_about(poles: Complexes, most: int) -> Floats:
    """Angles from 0 to pi: evenly, slow ones by decades, and around each known pole by its distance from the circle."""
    shown = poles[(poles.imag >= 0.0) & (np.abs(poles) > 0.3)]
    slow = np.abs(shown - 1.0)
    least = max(1e-12, 0.01 * float(slow[slow > 1e-7].min(initial=1.0)))
    spread = np.concatenate([np.geomspace(least, 1.0, most // 6), np.linspace(0.0, math.pi, most // 6)])
    shown = shown[np.argsort(-np.abs(shown), kind="stable")][: most // 10]
    width = np.maximum(np.abs(1.0 - np.abs(shown)), RESTS)[:, None]
    close = np.abs(np.angle(shown))[:, None] + width * np.array([-NEARBY[2], -NEARBY[1], *NEARBY])
    angles = np.concatenate([spread, close.ravel(), math.pi - np.geomspace(1e-6, 0.1, 20)])
    return np.unique(angles[(angles >= 0.0) & (angles <= math.pi)])


def _margin(matrix: _PoleChanges, link: int, quantity: int, angles: Floats, change: Complexes) -> float:
    """Returns the least factor above 1 at which the change of a link's quantity is real; ``change``: at the angles."""
    from scipy.optimize import brentq

    if not np.isfinite(change[1:-1]).all():
        return math.inf  # the quantity is 0

    def at(angle: float) -> complex:
        return complex(matrix.at(np.array([angle]), np.array([link]))[quantity, 0, 0])

    a, b = change[1:-2], change[2:-1]  # at 0 and pi themselves it is real
    place = np.flatnonzero((a.imag < 0.0) != (b.imag < 0.0))
    a, b = 1.0 / a[place], 1.0 / b[place]
    about = 1.0 / (a.real + (b.real - a.real) * a.imag / (a.imag - b.imag))
    least = min((float(end.real) for end in change[[0, -1]] if end.real > 0.0), default=math.inf)
    for i in np.argsort(about, kind="stable").tolist():
        if about[i] > FAR * least:
            break
        if about[i] > 0.0:
            left, right = angles[1 + place[i]], angles[2 + place[i]]
            found = at(brentq(lambda angle: at(angle).imag, left, right, xtol=1e-15 * right, rtol=1e-13))
            least = min(least, found.real if found.real > 0.0 else math.inf)
    return 1.0 + least
