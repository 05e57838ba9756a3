"""Modes and poles of a scene: all of them for a small scene, some for a large one."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Complexes, Floats, sort_by_modulus
from hapsim.theory.network.large_loop import sparse_step
from hapsim.theory.network.network import Network, kinetic_energy
from hapsim.theory.network.rest_poles import poles_at_rest
from hapsim.theory.rows import cut, stack, unit_rows
from hapsim.theory.sample import Sample, energy_of, is_large, loop, step_of
from hapsim.theory.schemes import SCHEMES

NO_MOTION = 1e-12  # a pole of smaller modulus is a memory, not a motion
SURELY = 1.0 + 1e-9
"""Growth in a sample above which a motion surely grows: it neither rests nor oscillates with a constant amplitude."""
AT_THE_LIMIT = 1e-12  # a modulus this close to 1 is 1, to rounding
MOST_DENSE = 150  # numbers in a state; above, sparse steps are faster
SAME_AS_REST = 1e-4  # largest error of a double pole at 1 among the eigenvalues


class Mode(NamedTuple):
    """Eigenmotion of the scene: a conjugate pair of poles, or a real pole.

    Attributes:
        pole: in the z-plane; of a pair, the one above the real axis.
        frequency_hz: undamped eigenfrequency |s|/(2 pi) with s = ln(pole)/T. With substeps a motion may turn by more
            than pi in a sample period: s then includes the whole turns.
        damping_ratio: -Re s/|s|; 1 for a real pole that decays, NaN for one that rests (s = 0).
        participation: (C + M,) each point's share of the kinetic energy, sum 1, device channels first.
    """

    pole: complex
    frequency_hz: float
    damping_ratio: float
    participation: Floats


class Solution(NamedTuple):
    """Poles and modes of a scene, as far as they are computed.

    Attributes:
        poles: (n,) by decreasing modulus. modes: the slowest to decay first.
        all: number of poles of the scene, memories included; n if every one was computed.
        method: sentence on which poles were computed and on the others; "" for every one.
        growth: growth in a sample period of a motion that grew, but whose pole was not found; else 0.
        eigen: eigenvalues (n,) of the loop's change and its eigenvectors (n, n), if every pole was computed.
    """

    poles: Complexes
    modes: list[Mode]
    all: int
    method: str = ""
    growth: float = 0.0
    eigen: tuple[Complexes, Complexes] | None = None

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of the computed poles; 0 for a scene without points."""
        return float(np.abs(self.poles).max(initial=self.growth))

    @property
    def is_stable(self) -> bool:
        """True if every motion decays, for the computed poles; False at the limit."""
        return self.spectral_radius < 1.0 - AT_THE_LIMIT


@np.errstate(all="ignore")  # numbers out of range become NaN
def all_modes(network: Network) -> Solution:
    """Returns every pole, memories included, and every motion, from the eigenvalues of the whole loop. If the loop is
    not finite, the poles are NaN and there are no modes."""
    change, points, *_ = loop(network)
    size = len(change)
    if not np.isfinite(change).all():
        return not_finite(size)
    w, states = np.linalg.eig(change)
    poles = settled(network, change, np.asarray(1.0 + w, complex))
    modes = modes_of(network, poles, points @ states, states)
    return Solution(sort_by_modulus(poles), modes, size, eigen=(w, states))


@np.errstate(all="ignore")
def poles_of(network: Network) -> Complexes:
    """Returns every pole, memories included, of a scene that is not large; NaN if the loop is not finite."""
    change = loop(network).change
    if not np.isfinite(change).all():
        return not_finite(len(change)).poles
    return np.asarray(1.0 + np.linalg.eigvals(change), complex)


def not_finite(size: int) -> Solution:
    """Returns the solution of a scene whose numbers are out of range."""
    return Solution(np.full(size, complex(np.nan, np.nan)), [], size)


def settled(network: Network, change: Floats, poles: Complexes) -> Complexes:
    """Returns the poles, 1 + the eigenvalues of the change, without the effects of rounding on verdicts."""
    return snap_to_rest(network, snap_to_circle(change, poles))


@np.errstate(divide="ignore")
def snap_to_circle(change: Floats, poles: Complexes) -> Complexes:
    """Returns the poles; those that rounding may have moved off the unit circle are put back on it.

    Rounding acts like a change E of the matrix by its last digit (LAPACK Users' Guide, §4.8). It moves a pole by E over
    the product of its left and right vectors, of length one. For a double pole these are at right angles: it becomes
    the two poles at p ± d, and the estimate is half of d. Very stiff springs under the midpoint scheme have such a
    double pole at -1: they oscillate at half the rate.
    """
    radius = np.abs(poles)
    if not (radius > 1.0).any():
        return poles
    from scipy.linalg import eig, matrix_balance

    balanced = matrix_balance(change, permute=False)[0]
    size, digit = float(np.linalg.norm(balanced)), float(np.finfo(float).eps)
    # Beyond the reach of rounding for a double pole. For enormous numbers no reach is known, and no pole is on the
    # circle.
    if radius.max() > 1.0 + min(math.sqrt(digit) * size, 1.0):
        return poles
    found, left, right = eig(balanced, left=True)
    reach = 2.0 * digit * size / np.abs((left.conj() * right).sum(axis=0))
    # The same poles, with other rounding: each takes the reach of the nearest.
    beyond = np.flatnonzero(radius > 1.0)
    nearest = np.abs(poles[beyond, None] - 1.0 - found).argmin(axis=1)
    moved = beyond[radius[beyond] - 1.0 <= reach[nearest]]
    on_circle = poles.copy()
    on_circle[moved] /= radius[moved]
    return on_circle


def snap_to_rest(network: Network, poles: Complexes) -> Complexes:
    """Returns the poles with those that are known to be 1 exactly there: the free motions, a double pole each. Rounding
    moves a double pole by the root of its own size, which would change the verdict."""
    poles = poles.copy()
    nearest = np.argsort(np.abs(poles - 1.0), kind="stable")[: poles_at_rest(network)]
    poles[nearest[np.abs(poles[nearest] - 1.0) < SAME_AS_REST]] = 1.0
    return poles


def modes_of(network: Network, poles: Complexes, motions: NDArray, states: NDArray) -> list[Mode]:
    """Returns the modes, the slowest first, of poles with ``motions`` (C + M, n) and whole ``states`` (size, n)."""
    order = np.lexsort((-poles.real, -np.abs(poles)))
    kept = [i for i in order if poles[i].imag >= 0.0 and abs(poles[i]) > NO_MOTION]
    energy, turns = energy_of(network, motions, states), np.zeros(poles.size)
    if network.substeps > 1:
        turned, moving = _steps_of_motions(network, poles, states)
        turns = np.nan_to_num(np.round((turned - np.angle(poles)) / (2.0 * np.pi)))
        energy = np.where(moving.sum(axis=0) > NO_MOTION**2 * energy.sum(axis=0), moving, energy)
    modes = []
    for i in kept:
        pole = complex(poles[i])
        s = network.rate * (cmath.log(pole) + 2j * math.pi * float(turns[i]))  # whole turns added to the pole's angle
        ratio = -s.real / abs(s) if s else math.nan
        modes.append(Mode(pole, abs(s) / (2.0 * math.pi), ratio, energy[:, i] / energy[:, i].sum()))
    return modes


def _steps_of_motions(network: Network, poles: Complexes, states: NDArray) -> tuple[Floats, Floats]:
    """Angle (n,), in radians, by which each motion (size, n) of a scene with substeps turns in a sample period, and its
    energy by point (points, n), in any unit. The angle adds up from step to step, weighted by the energy of each
    point."""
    sparse = is_large(network) or (SCHEMES[network.scheme] is None and len(states) > MOST_DENSE)
    sample = Sample(network, sparse)
    start = sample.start(cut(unit_rows(len(states), sparse), sample.sizes))
    motion = stack([*start.values()]) @ states
    step = sparse_step(sample) if sparse else step_of(sample) + np.eye(len(motion))
    places = cut(np.arange(len(motion))[:, None], sample.step_sizes)
    points = np.concatenate([places["hand"].ravel(), places["mass"].ravel()])
    mass = np.concatenate([network.channel_mass, network.point_mass])[:, None]
    turned, energy, ways = np.zeros(states.shape[1]), np.zeros((mass.size, states.shape[1])), list[NDArray]()
    for _ in range(network.substeps):
        after = step @ motion
        ways = [*ways[:1], *ways[-1:], (after - motion)[points]]  # the first, the last but one, the last
        turned += np.angle((mass * ways[-2:][0].conj() * ways[-1]).sum(axis=0))
        energy += kinetic_energy(network, ways[-1])
        motion = after
    return turned + np.angle((mass * ways[-1].conj() * poles * ways[0]).sum(axis=0)), energy
