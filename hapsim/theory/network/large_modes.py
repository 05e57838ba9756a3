"""Some of the poles of a large scene, by shift-inverted Arnoldi iterations on its sparse transition.

No dense matrix of the state's size is ever formed (``large_loop.py``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.one_thread import one_thread
from hapsim.theory.arrays import Bools, Complexes, Floats, sort_by_modulus
from hapsim.theory.interface import damper_transfer
from hapsim.theory.network.impedance import device_forces
from hapsim.theory.network.large_loop import LiftedTransition, Transition, sparse_transition
from hapsim.theory.network.modes import NO_MOTION, SAME_AS_REST, Solution, all_modes, modes_of, not_finite
from hapsim.theory.network.network import Network, acting_links, damping_links, is_centred, part_of
from hapsim.theory.network.rest_poles import poles_at_rest
from hapsim.theory.rows import stretches_of
from hapsim.theory.sample import is_large
from hapsim.theory.schemes import SCHEMES

OFFSET_FROM_ONE = 1e-6  # distance of a shift from 1, where a free motion's pole would make it singular
OFFSET_FROM_POLE = 1e-7  # distance of a shift from a pole that was found
APPROACHES = 6
LOWEST = 24  # poles of a scene with substeps
EDGE = 1.05  # if a bound of the fastest motion is this close to it, the bound is the shift
ROW = 0.1  # a pole further from the shift is another one
SAME = 1e-9  # tolerance for one pole from two searches
RESIDUAL = 1e-8  # residual of a pole and its motion, relative to the motion
STATE_STEPS = 6e8  # limit of the search for a motion that grows: steps times numbers in the state,
MOST_STEPS = 200_000  # and steps
STEPS_PER_BLOCK = 16  # steps between two measurements of the motion's size
LEAST_GROWTH = 1.6  # growth of a motion in the last quarter; a free mass drifts by 4/3
MOST_HANDS = 16
REFINEMENTS = 5
SLOPE_OVER = 1e-4  # of z - 1: step of the difference quotient
NEAR = 1e-5  # a pole that would move further keeps its first value
REAL = 1e-14  # a smaller imaginary part is rounding
ROUNDING = float(np.finfo(float).eps)


class PoleSearch(NamedTuple):
    """Search for the ``most`` poles nearest to ``shift``; ``where``: its description. ``start``: initial motion of the
    first points, for a pole near the shift; None: search from the shift itself."""

    shift: complex
    most: int
    where: str
    start: Floats | None = None


def solve(network: Network) -> Solution:
    """Returns the poles and modes: all of them, or the important ones of a large scene.

    Raises:
        NotWorkedOutError: the scene is large, and its scheme's matrix is not sparse.
    """
    if not is_large(network):
        return all_modes(network)
    with one_thread():
        return _some_modes(network)


@np.errstate(all="ignore")  # numbers out of range become NaN
def _some_modes(network: Network) -> Solution:
    """Returns the poles that the searches find, each with its motion; ``method`` describes them."""
    matrix = sparse_transition(network)
    if not matrix.is_finite:
        return not_finite(matrix.size)
    searches = [(search, *_nearest_poles(matrix, search)) for search in _searches(network)]
    steps = int(min(MOST_STEPS, STATE_STEPS / matrix.work))
    *grown, growth = _growing_poles(matrix, steps)
    # A random motion must exceed all the others before its end.
    least_seen = max(4.0 * math.log(LEAST_GROWTH), math.log(matrix.size) / 1.5) / steps
    places = [search.where for search, poles, _ in searches if poles.size]
    found = [*(one[1:] for one in searches), tuple(grown)]
    if isinstance(matrix, LiftedTransition):
        found.append(_lowest_poles(matrix))
        places.append("the masses' own poles of lowest pitch")
    poles, states = np.concatenate([one for one, _ in found]), np.hstack([states for _, states in found])
    motions = matrix.points @ states
    every, kept = _distinct_poles(network, refined(network, poles, motions), motions)
    both = sort_by_modulus(np.concatenate([every, every[every.imag > 0.0].conj()]))
    others = f"no other motion was seen that grows by more than {least_seen:.1g} of itself per sample period"
    if grown[0].size or growth:
        others = "and those that grow" if grown[0].size else "a random motion grew, but its pole was not found"
    listed = " and to ".join(filter(None, [", to ".join(places[:-1]), *places[-1:]]))
    sentence = f"{both.size} of {matrix.size} poles were worked out: those nearest to {listed}; {others}"
    return Solution(both, modes_of(network, every, motions[:, kept], states[:, kept]), matrix.size, sentence, growth)


def _searches(network: Network) -> Iterator[PoleSearch]:
    # Counted in substeps, motions of every pitch approach any place of the plane: each search takes few of them.
    few = network.substeps > 1
    yield PoleSearch(1.0 + OFFSET_FROM_ONE, 4 if few else 32, "1")
    if not few:
        yield PoleSearch(-1.0 - OFFSET_FROM_ONE, 8, "-1")
    top = _highest_motion(network)
    if top is not None:
        yield PoleSearch(top[0], 2 if few else 16, "about the highest of the masses' own poles", top[1])
    hands = [_single_hand_pole(network, channel) for channel in range(min(network.channel_mass.size, MOST_HANDS))]
    for hand in sorted({complex(np.round(hand, 6)) for hand in hands}, key=abs):
        yield PoleSearch(
            hand,
            2 if few else 12,
            "the hand's own pole" if len(hands) == 1 else "the hands' own poles",
            np.ones(len(hands)),
        )


def _nearest_poles(matrix: Transition, search: PoleSearch) -> tuple[Complexes, NDArray]:
    """Poles nearest to the shift that converged, of pairs the upper, and their motions (N, n)."""
    from scipy.sparse import linalg

    size = matrix.size
    shift = search.shift if search.shift.imag else search.shift.real
    if search.start is not None:
        shift = _shift_near_pole(matrix, search.shift, search.start)
    solve = matrix.inverse(shift)
    if solve is None:
        return np.zeros(0, complex), np.zeros((size, 0))
    inverse = linalg.LinearOperator((size, size), solve, dtype=type(shift))
    # A crowd of aliases converges slowly; an isolated pole converges fast.
    values, motions = _largest_eigenvalues(inverse, search.most, 4 if isinstance(matrix, LiftedTransition) else 40)
    return _converged(matrix, shift + 1.0 / values, motions)


def _shift_near_pole(matrix: Transition, near: complex, start: Floats) -> complex:
    """Returns a shift close to a pole near this one, by inverse iterations and then Rayleigh's. If poles stand in a row
    and the shift is outside it, all of them are equally far away. From a place in the row their distances differ, and
    the search converges fast."""
    motion = np.zeros(matrix.size, complex)
    motion[: start.size] = start
    pole = near
    for step in range(APPROACHES):
        solve = matrix.inverse(pole)
        if solve is None:
            break
        for _ in range(3 if step == 0 else 1):
            motion = solve(motion)
            motion /= np.linalg.norm(motion)
        pole = complex(np.vdot(motion, matrix @ motion))
    return (pole if abs(pole - near) < ROW else near) + OFFSET_FROM_POLE


def _lowest_poles(matrix: LiftedTransition) -> tuple[Complexes, NDArray]:
    """Poles and motions of the lowest pitch, wherever a whole sample period places them in the plane. The search starts
    from a step with the hands held still; inverse iterations follow each pole to the scene with moving hands."""
    poles, held = _nearest_poles(matrix.held, PoleSearch(1.0 + OFFSET_FROM_ONE, LOWEST, ""))
    once = np.unique(np.round(poles, 9), return_index=True)[1]  # both of a pair were found
    found = [_follow_pole(matrix, complex(poles[i]) ** matrix.steps, held[:, i]) for i in once]
    motions = np.array([motion for _, motion in found]).reshape(-1, matrix.size).T
    poles = np.array([pole for pole, _ in found], complex)
    return _converged(matrix, np.where(np.abs(poles.imag) < REAL, poles.real, poles), motions)


def _follow_pole(matrix: LiftedTransition, pole: complex, held: NDArray) -> tuple[complex, NDArray]:
    motion = matrix.placed(held).astype(complex)
    for _ in range(APPROACHES):
        motion /= np.linalg.norm(motion)
        moved = matrix @ motion
        quotient = complex(np.vdot(motion, moved))
        if np.linalg.norm(moved - quotient * motion) < 0.1 * RESIDUAL:
            return quotient, motion
        solve = matrix.inverse(pole + OFFSET_FROM_POLE)
        if solve is None:
            break
        motion = solve(motion)
        pole = complex(np.vdot(motion, matrix @ motion) / np.vdot(motion, motion))
    return pole, motion


def _growing_poles(matrix: Transition, samples: int) -> tuple[Complexes, NDArray, float]:
    """Poles of the largest modulus and their motions, if a random motion grows by more than a free one would. The third
    value is its growth in a sample period if no growing pole was found, else 0."""
    from scipy.sparse import linalg

    none = np.zeros(0, complex), np.zeros((matrix.size, 0))
    motion = np.random.default_rng(1).standard_normal(matrix.size)
    blocks = samples // STEPS_PER_BLOCK
    logarithm = np.zeros(blocks + 1)
    power, steps = matrix.power(STEPS_PER_BLOCK)
    for n in range(blocks):
        for _ in range(STEPS_PER_BLOCK // steps):
            motion = power @ motion
        size = float(np.linalg.norm(motion))
        if not 0.0 < size < np.inf:
            return *none, size
        motion /= size
        logarithm[n + 1] = logarithm[n] + math.log(size)
    # Peaks are compared, because the size of a slow motion oscillates.
    quarter = blocks // 4
    last = float(logarithm[-quarter:].max() - logarithm[-2 * quarter : -quarter].max())
    if last < math.log(LEAST_GROWTH):
        return *none, 0.0
    step = linalg.LinearOperator((matrix.size, matrix.size), matrix.__matmul__, dtype=float)
    poles, motions = _converged(matrix, *_largest_eigenvalues(step, 8, 200, motion))
    found = bool((np.abs(poles) > 1.0).any())
    return poles, motions, 0.0 if found else math.exp(last / (quarter * STEPS_PER_BLOCK))


def _largest_eigenvalues(operator: Any, count: int, iterations: int, start: Any = None) -> tuple[Complexes, NDArray]:
    """Eigenvalues of the largest modulus that converged, and their vectors."""
    from scipy.sparse import linalg

    size = operator.shape[0]
    if count > size - 2:  # few masses behind a long delay
        poles, motions = np.linalg.eig(np.zeros((0, 0)) if size == 0 else operator @ np.eye(size))
        return poles + 0j, motions + 0j
    start = np.random.default_rng(0).standard_normal(size) if start is None else start
    try:
        return linalg.eigs(operator, k=count, v0=start.astype(operator.dtype), tol=1e-13, maxiter=iterations)
    except linalg.ArpackNoConvergence as unfinished:
        return unfinished.eigenvalues, unfinished.eigenvectors
    except linalg.ArpackError:
        return np.zeros(0, complex), np.zeros((size, 0), complex)


def _converged(matrix: Transition, poles: Complexes, motions: NDArray) -> tuple[Complexes, NDArray]:
    """Returns the poles that really multiply their motions, of pairs the upper."""
    lower = poles.imag < 0.0
    poles, motions = np.where(lower, poles.conj(), poles), np.where(lower, motions.conj(), motions)
    residual = np.linalg.norm(matrix @ motions - motions * poles, axis=0)
    good = (residual < RESIDUAL * np.linalg.norm(motions, axis=0)) & (np.abs(poles) > NO_MOTION)
    return poles[good], motions[:, good]


def _distinct_poles(network: Network, poles: Complexes, motions: NDArray) -> tuple[Complexes, list[int]]:
    """Returns the poles, and their indices, without those of an earlier search; equal separate parts of a scene count
    once. Poles that are known to be 1 are repeated as often as they occur: the searches find only some, and
    approximately."""
    known, rests = poles_at_rest(network), at_rest(network, poles, motions, SAME_AS_REST)
    resting = np.flatnonzero(rests) if known else np.zeros(0, np.intp)
    kept = np.resize(resting, known if resting.size else 0).tolist()
    first = len(kept)
    seen = np.zeros(0, complex)
    for i, pole in enumerate(poles):
        if i not in resting and not (np.abs(seen - pole) < SAME * max(1.0, abs(pole))).any():
            kept.append(i)
            seen = poles[kept[first:]]
    return np.concatenate([np.ones(first, complex), seen]), kept


def _single_hand_pole(network: Network, channel: int) -> complex:
    """Slowest pole, on or above the real axis, of a channel whose neighbours are held still."""
    still = replace(network, ends=np.where(network.ends == channel, channel, -1), scheme="cordis", outside=())
    alone = part_of(still, np.array([channel]))
    if is_large(alone):
        return 1.0 + 2.0 * OFFSET_FROM_ONE
    pole = all_modes(alone).poles[0]
    return complex(pole.real, abs(pole.imag)) * (1.0 + OFFSET_FROM_ONE)


def _highest_motion(network: Network) -> tuple[complex, Floats | None] | None:
    """Shift near the fastest motion of the simulated masses on their springs, with the device held still, and that
    motion (C + M,); None for the motion if the shift is above all of them."""
    from scipy.sparse import coo_matrix, linalg

    channels, count = network.channel_mass.size, network.point_mass.size
    links = np.flatnonzero((network.ends >= channels).any(axis=1))
    if count < 2 or not links.size:
        return None
    mass = network.ends[links] - channels
    link, end = np.nonzero(mass >= 0)
    share = np.array([1.0, -1.0])[end] / np.sqrt(network.point_mass[mass[link, end]])
    stretch = coo_matrix((share, (link, mass[link, end])), (links.size, count)).tocsr()
    springs = stretch.T.multiply(network.stiffness[links]) @ stretch
    start = np.random.default_rng(2).standard_normal(count)
    try:
        motion = linalg.eigsh(springs, k=1, which="LA", v0=start, tol=1e-3)[1][:, 0]
    except linalg.ArpackError:
        return None
    stretched = (stretch @ motion) ** 2
    rate = network.rate * network.substeps
    kappa = float(network.stiffness[links] @ stretched) / rate**2
    beta = float(network.damping[links] @ stretched) / rate
    # No motion is faster than one in which neighbours move against each other with equal amplitudes.
    bound = float(abs(springs).sum(axis=1).max()) / rate**2 * (1.0 + OFFSET_FROM_ONE)
    is_near_edge = bound < EDGE * kappa
    if is_near_edge:
        kappa, beta = bound, beta * bound / kappa
    scheme = SCHEMES[network.scheme]
    # z² - (2 - kappa - beta) z + 1 - beta = 0: the centred mass on its spring and its backward damper
    step = np.array([[2.0 - kappa - beta, beta - 1.0], [1.0, 0.0]])
    if scheme is not None:
        step = np.eye(2) + scheme.changed(np.array([[0.0, 1.0], [-kappa, -beta]]), np.eye(2), np.zeros((2, 2)))
    poles = np.linalg.eigvals(step)
    pole = complex(poles[np.argmin(poles.real)]) ** network.substeps
    shift = complex(pole.real, abs(pole.imag)) * (1.0 + OFFSET_FROM_ONE)
    return shift, None if is_near_edge else np.concatenate([np.zeros(channels), motion / np.sqrt(network.point_mass)])


def refined(network: Network, poles: Complexes, motions: NDArray) -> Complexes:
    """Returns the poles (n,) moved to the zeros of x' D(z) x; ``motions`` (points, n): approximate motions of the
    poles.

    A motion x z^n of the points satisfies D(z) x = 0. D consists of the masses' m/T² (z - 2 + 1/z), of the channels'
    forces over the positions that they read, and for each link of K + (B/T) v(z) at its two ends, where v is its
    damper's velocity over the position. D is symmetric if no velocity comes from the device. Then x' D(z) x is zero at
    a z whose error is of the order of the square of the error of x (Rayleigh's quotient). Iterations find the mean of
    two poles with almost equal motions, those of a slow oscillation near 1, well and their difference badly. They move
    such a pole off the circle, by the root of rounding and more.
    """
    if not is_centred(network) or any(network.damper[link].senses for link in damping_links(network).tolist()):
        return poles
    channels, squares = network.channel_mass.size, motions**2
    stretches = (stretches_of(network, True) @ motions) ** 2
    of_springs, of_masses = network.stiffness @ stretches, network.rate**2 * network.point_mass @ squares[channels:]
    number = {damper: [i for i, one in enumerate(network.damper) if one == damper] for damper in set(network.damper)}
    of_dampers = {damper: network.rate * network.damping[at] @ stretches[at] for damper, at in number.items()}

    def form(w: Complexes) -> Complexes:
        """Returns the quadratic form of each motion at w = z - 1."""
        z = 1.0 + w
        dampers = sum((of * damper_transfer(damper, z, w) for damper, of in of_dampers.items()), 0.0 * w)
        device = (squares[:channels].T * device_forces(network, w)).sum(axis=1)
        return np.asarray(of_springs + of_masses * w * w / z + dampers + device)

    w = poles - 1.0
    with np.errstate(all="ignore"):
        for _ in range(REFINEMENTS):
            aside = SLOPE_OVER * w
            w = w - form(w) * 2.0 * aside / (form(w + aside) - form(w - aside))
    return np.where(np.abs(1.0 + w - poles) < NEAR, 1.0 + w, poles)


def at_rest(network: Network, poles: Complexes, motions: NDArray, same: float) -> Bools:
    """Flags (n,): poles within ``same`` of 1 whose motions, (points, n), stretch nothing and are not a brake's."""
    mass = np.concatenate([network.channel_mass, network.point_mass])
    inertia = mass @ np.abs(motions) ** 2 * network.rate
    links = acting_links(network)
    stretch = np.abs(stretches_of(network, True)[links] @ motions) ** 2
    own = np.abs(motions[: network.channel_mass.size]) ** 2
    stiffness = network.stiffness[links] @ stretch + network.channel_stiffness @ own
    damping = (network.damping[links] @ stretch + network.channel_friction @ own) / inertia
    w = poles - 1.0
    rests = (damping**2 < ROUNDING) | (np.abs(w) <= np.abs(w + damping))  # z = 1, not 1 - damping
    result: Bools = (np.abs(stiffness) < ROUNDING * inertia * network.rate) & (np.abs(w) < same) & rests
    return result
