"""Real friction that makes a whole scene passive, with masses, strings and several hands: stable in any passive hands.

Colgate and Schenkel, "Passivity of a class of sampled-data systems" (1997). Their sampled wall is here a scene that
answers the positions of C hands by forces H(z), (C, C). Behind a zero-order hold and w + f samples of delay, w whole,
with sigma_n = j (theta + 2 pi n) the images of a motion, the force at image n is

    -T a_n H(z) sum_m v_m/sigma_m,      a_n = (1 - 1/z) z^-w exp(-f sigma_n)/sigma_n

for the velocities v_m (C,) at all images; hands may have all of them at once. The power that the hands receive is
largest in the plane of a and of the conjugates of 1/sigma. With sum |1/sigma_n|² = 1/(4 sin²(theta/2)), sum |a_n|² = 1
and

    g = sum a_n/sigma_n = -(1 - 1/z) z^-w (1 - f + f/z)/(4 sin²(theta/2))

it is the largest eigenvalue of the Hermitian part of -T [[g H, 0], [sqrt(f (1 - f)) H, 0]], (2 C, 2 C): the friction
that theta needs. For a single wall this is the result of ``hand/wall_passivity.py``. No friction suffices if the scene
has a motion that the hands feel and that does not decay while they are held, or if its static stiffness is negative.

The needed friction peaks at the resonances of the held scene. So it is computed on a grid that is dense around each, by
the residues of its poles, and the highest peaks are refined.

With the force law on the board (``board_lines.py``) H reads what its lines carry, and the images fall into N classes
that the board does not tell apart: ``power_of_lines``.

A channel may have a drive (``plant.py``) whose sensor and friction are at the motor and whose motor does not lag. Belt,
handle and hand together are then a passive hand on the motor, so the same friction suffices.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hapsim.holds import HOLDS
from hapsim.theory.arrays import Complexes, Floats, Indices
from hapsim.theory.board_lines import acting_lines, own_lines, power_of_lines, without_lines
from hapsim.theory.interface import delay_and_hold, lag_of
from hapsim.theory.network.crossings import in_blocks, on_circle
from hapsim.theory.network.network import Network
from hapsim.theory.sample import is_large, loop, sizes_of

LASTS = 1e-9  # relative loss in a sample; a motion with less does not decay
_FELT = 1e-9  # of the largest force: a motion with less is not felt
_SAME = 1e-9  # relative error of accurate residues
_POINTS = 400  # of theta, evenly; and for each sample of delay
_SLOW = 60  # of theta near 0, in geometric steps
_WIDTHS = np.array([-30.0, -10.0, -3.0, -1.0, -0.3, 0.0, 0.3, 1.0, 3.0, 10.0, 30.0])  # of a resonance
_SWINGS = 0.3  # a pole of smaller modulus is no resonance
_MOST_EXACT = 100  # numbers of a held scene without accurate residues
_PEAKS, _ZOOMS = 4, 10
_REST = 1e-9  # z - 1 at which the impedance is the static stiffness


class Passivity(NamedTuple):
    """Passivity condition of a scene.

    Attributes:
        friction: N·s/m that each hand needs; infinite if none suffices. For hands with different frictions it is the
            mean, in unchanged proportions.
        frequency_hz: frequency at which it is needed.
        lasting: (C + M,) amplitude of each point in the motion that does not decay; empty if every motion decays.
        pushes_away: whether at rest the scene drives hands on, so that no friction suffices.
    """

    friction: float
    frequency_hz: float
    lasting: Floats = np.zeros(0)
    pushes_away: bool = False


def no_derivation(network: Network) -> str:
    """Reason why the condition is not derived; "" if it is."""
    if network.followers:
        return "the condition is derived for a device that renders forces"
    if network.predictors:
        return "the condition is not derived for a predictor"
    if network.second is not None and (network.second[:, 0] != network.second[:, 1]).any():
        return "the condition is not derived for a link with a gain, which gives or takes energy"
    if network.clocks is not None:
        return "the condition is not derived for hands on several ports"
    if HOLDS[network.hold].has_impulses or network.sampling != "ideal":
        return "the condition is derived only for holds without impulses and ideal sampling"
    if any(damper.senses for damper in network.damper):
        return "the condition is not derived for a damper that senses the device's velocity"
    if network.ahead is not None:
        return "the condition is not derived for a sensed acceleration"
    if any(drive.lag > 0.0 for drive in network.drives):
        return "the condition is not derived for a motor that lags"
    if any(drive.is_elastic and (drive.reads_handle or drive.brakes_handle) for drive in network.drives):
        return "the condition is derived only for a transmission with the sensor and the friction at the motor"
    return "the scene is too large" if is_large(network) else ""


@dataclass(frozen=True, eq=False)
class HeldScene:
    """Scene without its hands: forces from positions. Only for scenes for which ``no_derivation`` returns ""."""

    network: Network

    @cached_property
    def _rows(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Rows of the scene's own state: its change in a sample, from itself and from the hands' positions and last
        steps; and the forces from both."""
        change, _, _, force, *_ = loop(self.network, inputs=True)
        starts, own, given = 0, np.zeros(len(change), bool), np.zeros(len(change), bool)
        for name, size in sizes_of(self.network).items():
            part = slice(starts, starts + size)
            own[part] = name in {"mass", "mass_step", "old_steps", "old_rates"}
            given[part] = name in {"position", "last_step"}
            starts += size
        return change[np.ix_(own, own)], change[np.ix_(own, given)], force[:, own], force[:, given]

    @property
    def is_finite(self) -> bool:
        """False if the scene grows beyond all numbers within a sample."""
        return all(np.isfinite(one).all() for one in self._rows)

    @cached_property
    def _eigen(self) -> tuple[Complexes, Complexes, Complexes]:
        """Eigenvalues w of the change in a sample, eigenvectors, and the parts of the hands' inputs in each."""
        own, driven, *_ = self._rows
        w, states = np.linalg.eig(own)
        amounts = np.linalg.lstsq(states, driven.astype(complex), rcond=None)[0]
        return w.astype(complex), states.astype(complex), amounts

    @property
    def poles(self) -> Complexes:
        """Poles (n,) of the scene while its hands are held."""
        return np.asarray(1.0 + self._eigen[0])

    def forces(self, w: Complexes) -> Complexes:
        """Forces (n, C, C) that pull the hands back at z = 1 + w, for 1 m z^n of each alone; NaN if not computed."""
        return self._by_residues(w) if self._has_residues else self._by_solving(w)

    @cached_property
    def _has_residues(self) -> bool:
        w = on_circle(np.array([0.01, 0.4, 1.7, 3.0]))
        exact = self._by_solving(w, len(self._rows[0]))
        return bool(np.abs(self._by_residues(w) - exact).max(initial=0.0) <= _SAME * np.abs(exact).max(initial=0.0))

    def _by_residues(self, w: Complexes) -> Complexes:
        at, states, amounts = self._eigen
        given = self._given(w)
        moved = (amounts @ given) / (w[:, None] - at)[..., None]
        return np.asarray(-(self._rows[3] @ given + (self._rows[2] @ states) @ moved))

    def _by_solving(self, w: Complexes, most: int = _MOST_EXACT) -> Complexes:
        own, driven, felt, at_once = self._rows
        given, size = self._given(w), len(own)
        found = np.full((w.size, len(felt), len(felt)), np.nan, dtype=complex)
        for part in in_blocks(w.size if size <= most else 0, size):
            moved = np.linalg.solve(w[part, None, None] * np.eye(size) - own, driven @ given[part])
            found[part] = -(at_once @ given[part] + felt @ moved)
        return found

    def _given(self, w: Complexes) -> Complexes:
        """Positions and last steps of the hands, (n, 2 C, C)."""
        one = np.eye(self.network.channel_mass.size)
        return np.concatenate([np.ones(w.size)[:, None, None] * one, (w / (1.0 + w))[:, None, None] * one], axis=1)

    @cached_property
    def largest(self) -> float:
        """Largest force at some frequencies, N/m; far smaller ones are rounding."""
        return float(np.abs(self.forces(on_circle(np.array([0.1, 1.0, 2.0, 3.0])))).max(initial=0.0))

    def lasting(self) -> int | None:
        """Index of the fastest growing of ``poles`` that does not decay and is felt; None if there is none."""
        at, states, amounts = self._eigen
        felt = np.linalg.norm(self._rows[2] @ states, axis=0) * np.linalg.norm(amounts, axis=1)
        lasts = np.flatnonzero((np.abs(1.0 + at) > 1.0 - LASTS) & (felt > _FELT * self.largest))
        return int(lasts[np.argmax(np.abs(1.0 + at[lasts]))]) if lasts.size else None

    def moved(self, pole: int) -> Floats:
        """Amplitude of each point, (C + M,), in the motion of one of ``poles``."""
        masses = np.abs(self._eigen[1][: self.network.point_mass.size, pole])
        return np.concatenate([np.zeros(self.network.channel_mass.size), masses])

    @cached_property
    def angles(self) -> Floats:
        """Grid of theta, from slow to half the rate, dense around each resonance."""
        z = self.poles[np.abs(self.poles) > _SWINGS]
        width = np.maximum(np.abs(1.0 - np.abs(z)), LASTS)
        about = np.abs(np.angle(z))[:, None] + width[:, None] * _WIDTHS
        count = math.ceil(_POINTS * (1.0 + self.network.delay))
        grid = np.linspace(math.pi / count, math.pi, count)
        every = np.concatenate([np.geomspace(1e-6, 0.1, _SLOW), grid, about.ravel()])
        return np.unique(np.clip(every, 1e-7, math.pi))

    def driving_impedance(self, theta: Floats, channel: int) -> Complexes:
        """Impedance (n,), N·s/m, at theta, of a hand on this channel, which moves at no image; the others are free.
        Behind a transmission it is that of the motor alone: there the loop may give energy."""
        network, one = self.network, np.eye(self.network.channel_mass.size)
        s = np.asarray(1j * theta[:, None] * network.rate, complex)
        device = np.asarray(
            network.channel_mass * s + network.channel_friction + network.channel_stiffness / s, complex
        )
        for c, drive in enumerate(network.drives):
            if drive.is_elastic:
                belt, handle = self._behind(s[:, 0], c)
                device[:, c] = device[:, c] - handle + (_in_series(belt, handle) if c != channel else 0.0)
        coupling = 0.0 if network.mass_coupling is None else s[:, :, None] * network.mass_coupling
        delay = network.delay if network.board is None else without_lines(network).delay
        through = delay_and_hold(theta, delay, network.hold, network.sampling)
        rendered = self.forces(on_circle(theta)) * (through / s[:, 0])[:, None, None]
        if network.board is not None:
            rendered = rendered + acting_lines(network, theta) / s[:, :, None]
        whole = device[:, None] * one + rendered + coupling
        return np.asarray(1.0 / np.linalg.inv(whole)[:, channel, channel])

    def handle_impedance(self, theta: Floats, channel: int) -> Complexes:
        """Impedance (n,), N·s/m, of the same hand behind its transmission, if it has one."""
        at_motor = self.driving_impedance(theta, channel)
        if not self.network.drives or not self.network.drives[channel].is_elastic:
            return at_motor
        belt, handle = self._behind(np.asarray(1j * theta * self.network.rate, complex), channel)
        return np.asarray(handle + _in_series(belt, at_motor))

    def _behind(self, s: Complexes, channel: int) -> tuple[Complexes, Complexes]:
        """Impedances (n,), N·s/m, of a channel's transmission and of its handle, with the own spring, at s (n,)."""
        network, drive = self.network, self.network.drives[channel]
        mass, spring = network.channel_mass[channel] - drive.motor_mass, network.channel_stiffness[channel]
        return drive.damping + drive.stiffness / s, mass * s + spring / s


def _in_series(one: Complexes, other: Complexes) -> Complexes:
    return np.asarray(one * other / (one + other))


@np.errstate(all="ignore")
def passivity_of(scene: HeldScene) -> Passivity:
    """Returns the friction that a scene needs; NaN if not computed."""
    network = scene.network
    if not scene.is_finite:
        return Passivity(math.nan, math.nan)
    own = network.channel_friction
    mean = float(own.mean())
    weight = np.sqrt(own / mean) if (own > 0.0).all() else np.ones(own.size)
    lasts = scene.lasting()
    if lasts is not None:
        hertz = abs(float(np.angle(scene.poles[lasts]))) * network.rate / (2.0 * np.pi)
        return Passivity(math.inf, hertz, scene.moved(lasts))

    rest = scene.forces(np.array([_REST + 0j]))[0].real
    if network.board is not None:
        k, b = own_lines(network)
        rest = rest + np.diag(k + b * network.rate * _REST)
    if np.linalg.eigvalsh(0.5 * (rest + rest.T))[0] < -_FELT * scene.largest:
        return Passivity(math.inf, 0.0, pushes_away=True)

    def needed(theta: Floats) -> Floats:
        """Returns the damping that a passive loop needs at angles of the unit circle."""
        forces = scene.forces(on_circle(theta))
        if network.board is not None:
            power = power_of_lines(network, theta, -forces)
            return _largest(power / np.tile(np.outer(weight, weight), (network.board.steps,) * 2))
        return _needed(network, theta, forces / np.outer(weight, weight))

    theta, found = highest(needed, scene.angles)
    return Passivity(found, theta * network.rate / (2.0 * np.pi))


def _needed(network: Network, theta: Floats, forces: Complexes) -> Floats:
    """Needed friction (n,), N·s/m, at theta."""
    lag, w, at_once = lag_of(network.delay, network.hold), on_circle(theta), -forces / network.rate
    g = -w * lag.read(1.0 / (1.0 + w)) / (4.0 * np.sin(0.5 * theta) ** 2)
    matrix = g[:, None, None] * at_once
    if (unread := lag.unread(theta)).any():
        between = np.sqrt(unread)[:, None, None] * at_once
        matrix = np.block([[matrix, np.zeros_like(matrix)], [between, np.zeros_like(matrix)]])
    return _largest(matrix)


def _largest(matrix: Complexes) -> Floats:
    """Largest eigenvalue (n,) of the Hermitian part of matrices (n, m, m); NaN where they are not finite."""
    hermitian = 0.5 * (matrix + np.conj(np.swapaxes(matrix, 1, 2)))
    found = np.full(len(matrix), np.nan)
    good = np.isfinite(hermitian).all(axis=(1, 2))
    found[good] = np.linalg.eigvalsh(hermitian[good])[:, -1]
    return found


def peaks_of(values: Floats) -> Indices:
    """Places of the peaks of values (n,), the highest first; ends count."""
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    peaks = np.flatnonzero((values >= padded[:-2]) & (values > padded[2:]))
    return np.asarray(peaks[np.argsort(-values[peaks], kind="stable")])


def highest(values: Callable[[Floats], Floats], theta: Floats) -> tuple[float, float]:
    """Returns (theta, value) of the maximum of a function on a grid and between its points; NaN if a value is NaN."""
    found = values(theta)
    if np.isnan(found).any():
        return math.nan, math.nan
    peaks = peaks_of(found)[:_PEAKS]
    best = float(theta[peaks[0]]), float(found[peaks[0]])
    for peak in peaks:
        low, high = theta[max(peak - 1, 0)], theta[min(peak + 1, theta.size - 1)]
        for _ in range(_ZOOMS):
            at = np.linspace(low, high, 9)
            here = values(at)
            top = int(np.argmax(here))
            low, high = at[max(top - 1, 0)], at[min(top + 1, 8)]
            if here[top] > best[1]:
                best = float(at[top]), float(here[top])
    return best
