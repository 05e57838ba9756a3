"""The gain margins of a large scene's few links: the unit circle is sampled, and a sign change refined.

At a place on the circle a link's stiffness, or damping, has to change by a certain complex part s of itself for a pole
to be there, s v'(z - M)^-1 u = 1 (``crossings.py``): a pole crosses where that is real. Of a loop that is stable as it
stands the least factor above 1 among the crossings is the margin. Each place costs one factorisation of a sparse
matrix.
"""

from __future__ import annotations

import math

import numpy as np

from hapsim.one_thread import one_thread
from hapsim.theory.arrays import Complexes, Floats, Indices
from hapsim.theory.network.crossings import OUTSIDE, link_changes, on_circle
from hapsim.theory.network.large_loop import PIVOTS, factorised
from hapsim.theory.network.network import Network
from hapsim.theory.rows import cut, unit_rows
from hapsim.theory.sample import sizes_of

WORK = 1.2e7  # points times places on the circle: some seconds
FEWEST, MOST = 400, 2500  # places
TURN = 0.7  # between two places a change differs by less than a factor exp of it, in size and in angle
CLOSE = 1e-9  # radians: places are not taken closer together
RESTS = 1e-9  # a pole this close to the circle is on it
NEARBY = (0.0, 1.0, 3.0)  # widths of a resonance at which its surroundings are sampled
FAR = 2.0  # crossings are refined up to this multiple of the nearest one's distance from 1


def margins_along_circle(network: Network, links: Indices, poles: Complexes) -> tuple[Floats, str]:
    """(links, 2): the factors of stiffness and damping of a stable scene, and in words how they were found."""
    matrix = _Changes(network)
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
    coarse = ", coarser than the scene's resonances: a true margin may be nearer to 1" if angles.size >= most else ""
    return factors, f"the circle was sampled at {angles.size} angles{coarse}"


class _Changes:
    """By what part of itself a link's stiffness, and its damping, has to grow for a pole to be at a place.

    A mass's last step is 1 - 1/z times its place: of the two equations that CORDIS's scheme has of it that of the step
    says both.
    """

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
        """(2, links, n)"""
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
    """From 0 to pi: evenly, slow ones by decades, and about each known pole as far as it is from the circle."""
    shown = poles[(poles.imag >= 0.0) & (np.abs(poles) > 0.3)]
    slow = np.abs(shown - 1.0)
    least = max(1e-12, 0.01 * float(slow[slow > 1e-7].min(initial=1.0)))
    spread = np.concatenate([np.geomspace(least, 1.0, most // 6), np.linspace(0.0, math.pi, most // 6)])
    shown = shown[np.argsort(-np.abs(shown), kind="stable")][: most // 10]
    width = np.maximum(np.abs(1.0 - np.abs(shown)), RESTS)[:, None]
    close = np.abs(np.angle(shown))[:, None] + width * np.array([-NEARBY[2], -NEARBY[1], *NEARBY])
    angles = np.concatenate([spread, close.ravel(), math.pi - np.geomspace(1e-6, 0.1, 20)])
    return np.unique(angles[(angles >= 0.0) & (angles <= math.pi)])


def _margin(matrix: _Changes, link: int, quantity: int, angles: Floats, change: Complexes) -> float:
    """The least factor above 1 at which the change of a link's quantity is real; ``change``: at the angles."""
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
