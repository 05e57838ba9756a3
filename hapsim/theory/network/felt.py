"""Springs and dampers that one hand or several feel in a network, and the mass that its masses feel like.

The same quantities are computed in continuous time, M x'' + Z x' + K x = 0 with every link a spring and a damper: the
reference that sampling, hold and delay deform.

Among the loop's eigenmotions, the hands' own are the slowest with nine tenths of the kinetic energy in the hands. If
these carry the hands' movement, only one object M x'' + b x' + k x = 0 has the same motions. With a real basis V of
them, A V = V R, S = log(R)/T and X the hands' rows of V, it is [k b] = -M X S² [X; X S]⁻¹. For one hand without masses
this is the pair of Florens et al., §6.

A hand of stiffness kh, a spring beside the device, shakes the masses that it holds. For the slowest oscillation s a
rigid mass M' = kh/|s|² - m would have the same s, where m is the device's own mass. The same rule in continuous time
separates the part of the coupling: a mass behind a spring feels heavier the faster it is shaken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes, Floats, Indices
from hapsim.theory.network.large_loop import factorised
from hapsim.theory.network.network import Network, acting_links, kinetic_energy
from hapsim.theory.rows import Rows, as_rows, geometry_of, times, unit_rows
from hapsim.theory.sample import energy_of, hand_kicks, hands_of, is_large, loop, mobility, sizes_of


class ContinuousMode(NamedTuple):
    """Eigenmotion of the continuous scene: a conjugate pair, or a real root.

    Attributes:
        root: s in 1/s; of a pair, the one above the real axis.
        participation: (C + M,) each point's share of the kinetic energy, sum 1, device channels first.
    """

    root: complex
    participation: Floats

    @property
    def frequency_hz(self) -> float:
        """Undamped eigenfrequency |s|/(2 pi)."""
        return abs(self.root) / (2.0 * math.pi)

    @property
    def damping_ratio(self) -> float:
        """Damping ratio -Re s/|s|; NaN at rest."""
        return -self.root.real / abs(self.root) if self.root else math.nan


def matrices(network: Network, sparse: bool = False) -> tuple[Rows, Rows, Rows]:
    """Matrices (M, Z, K), each (C + M, C + M): kg, N·s/m, N/m."""
    mass, (stretches, pulls) = np.concatenate([network.channel_mass, network.point_mass]), geometry_of(network, sparse)
    one, others = unit_rows(mass.size, sparse), np.zeros(network.point_mass.size)
    Z, K = (
        pulls.T @ times(of_links, stretches) + times(np.concatenate([own, others]), one)
        for of_links, own in (
            (network.damping, network.channel_friction),
            (network.stiffness, network.channel_stiffness),
        )
    )
    M = times(mass, one)
    if network.mass_coupling is not None:
        M = M + as_rows(np.pad(network.mass_coupling, (0, others.size)), sparse)
    return M, Z, K


def free_motions(network: Network) -> tuple[Floats, Floats]:
    """Returns motions ``begin`` + ``drift`` t, each (C + M, n), of a planar scene that no force changes: those at rest,
    K begin = 0, and those that drift, Z drift + K begin = 0. Each is a pole at 1.

    Rows are rounded themselves, so a null space is that of the singular values below ``_ROUNDED``. K need not be
    symmetric: its left null space decides which motions are braked.
    """
    _, Z, K = matrices(network)
    left, sizes, right = np.linalg.svd(K)
    free = sizes <= _ROUNDED * sizes.max(initial=0.0)
    rests = right[free].T
    _, brakes, turned = np.linalg.svd(left[:, free].T @ Z @ rests)
    drifts = rests @ turned[brakes <= _ROUNDED * np.abs(Z).max(initial=0.0)].T
    return np.hstack([rests, -np.linalg.pinv(K, _ROUNDED) @ Z @ drifts]), np.hstack([0.0 * rests, drifts])


def first_order(network: Network) -> Floats:
    """Matrix (2 C + 2 M, 2 C + 2 M) from positions and velocities to their rates of change, 1/s."""
    M, Z, K = matrices(network)
    size, mass = len(M), np.diag(M)[:, None]
    K, Z = (K / mass, Z / mass) if network.mass_coupling is None else np.linalg.solve(M, np.array([K, Z]))
    return np.block([[np.zeros((size, size)), np.eye(size)], [-K, -Z]])


def continuous_modes(network: Network) -> list[ContinuousMode]:
    """Returns every mode, including those at rest, the slowest to decay first."""
    size = network.channel_mass.size + network.point_mass.size
    if size == 0:
        return []
    roots, vectors = np.linalg.eig(first_order(network))
    energy = kinetic_energy(network, vectors[size:])
    total = energy.sum(axis=0)
    share = np.where(total > 0.0, energy / np.where(total > 0.0, total, 1.0), 1.0 / size)
    modes = [ContinuousMode(complex(roots[i]), share[:, i]) for i in range(roots.size) if roots[i].imag >= 0.0]
    return sorted(modes, key=lambda mode: -mode.root.real)


OWN_SHARE = 0.9
"""Share of a motion's kinetic energy; with more in the hands it is one of their own."""
UNLIKE = 0.1
"""Limit of the difference between the hands' answers to an impulse and those of their pair, rms, of the largest."""
_SMALL = 0.01  # of the largest answer; smaller ones are not compared
_TIMES = 300  # at which answers are compared; a third of them first, to find how long they last
_LONG = 100.0  # time constants in which every answer has become small
_LASTS = 1e-9  # decay in a sample; a motion with less lasts
MEMORY = 1e-7
"""Modulus of a pole; one of less is a memory."""
OF_STEP = 1e-15
"""Share of m/T², and of m/T: a smaller k or b is rounding, and none."""
_RESTS = 1e-12  # radians and nepers in a sample; less is rest
_SAME = 1e-6  # relative difference that rounding alone causes
_ALIKE = 1e-9  # of the largest position: less is rounding
_WORST = 1e12  # condition number of the motions from which a pair is solved
_SHOWN = 0.1  # rms share of the hands' velocity after an impulse in a motion that the hands take part in
_ROUNDED = 1e-13  # of a matrix's largest singular value
_ROUNDING = 1e-13  # of the largest entry of a pair: less is none
_ROUND = 1e-9  # largest relative difference of two directions in which the same is felt
_TURNS = 10.0  # radians of the slowest motion of the hands, or nepers of growth: time over which answers are summed

TOO_LARGE = "the scene is too large"
TOGETHER = "it oscillates together with the parts that it moves"
ANSWERS = "it answers a push otherwise than a spring and a damper would"


class FeltPair(NamedTuple):
    """Stiffness k (n, n), N/m, and damping b (n, n), N·s/m, that n hands feel, with the device's own; NaN if none."""

    k: Floats
    b: Floats
    share: float
    """Smallest share of the hands in the kinetic energy of one of their own motions."""
    others: float
    """Largest difference of a hand's position after an impulse on one hand from the pair's, rms, of the largest
    position; NaN without a pair to compare."""
    frequencies_hz: tuple[float, ...]
    """Frequencies of the motions that the hands take part in, the largest part first."""
    reason: str = ""
    """Reason why there is no pair."""


class _Motions(NamedTuple):
    """Motions (n) of C hands."""

    s: Complexes
    """Logarithm of the pole, (n,)."""
    hands: Complexes
    """Positions, (C, n)."""
    share: Floats
    """Share of the hands in the kinetic energy, (n,)."""
    carried: Complexes
    """Velocity of a hand in each motion, after an impulse on another hand, (C, C, n), m a sample."""
    ways: Complexes
    """Position of the hand then, (C, C, n), m."""
    kicked: Floats
    """Velocities of the hands after these impulses, (C, C), m a sample."""


@np.errstate(all="ignore")
def felt_pair(
    network: Network,
    eigen: tuple[Complexes, Complexes] | None = None,
    most: float = UNLIKE,
    phases: Sequence[float] | None = None,
) -> FeltPair:
    """Returns the pair that the hands of one part of a scene feel, from the loop's motions. ``eigen``: of ``Solution``,
    if known. ``most``: limit of the difference between the answers of hands and pair. ``phases``: those of ``eigen``,
    if they are not those of the network's clocks."""
    hands, sizes = network.channel_mass.size, sizes_of(network)
    if is_large(network):
        return no_pair(hands, TOO_LARGE)
    if eigen is None:
        change = loop(network).change
        if not np.isfinite(change).all():
            return no_pair(hands, "its numbers are out of range")
        eigen = np.linalg.eig(change)
    w, states = eigen
    begin = sizes["position"] + sizes["mass"]
    kept, at, speeds = np.abs(1.0 + w) > MEMORY, states[:hands], states[begin : begin + hands]
    if network.drives:
        at, speeds, _ = hands_of(network, states)
    energy, s = energy_of(network, states[:begin], states), np.log1p(w.astype(complex))
    later = at_one_instant(network, s, phases)
    every = _motions(network, s, states, (at * later, speeds * later), energy, hand_kicks(network))
    carried, ways = ((of / later)[..., kept] for of in (every.carried, every.ways))
    motions = _Motions(every.s[kept], every.hands[:, kept], every.share[kept], carried, ways, every.kicked)
    return _pair(network, motions, most)


def at_one_instant(network: Network, s: Complexes, phases: Sequence[float] | None = None) -> Complexes:
    """Factors (C, n) that bring motions with these logarithms of their poles (n,) from each channel's own tick to the
    instant of phase 0; 1 on one clock. ``phases`` [default: those of the network]."""
    clocks, channels = network.clocks, network.channel_mass.size
    if clocks is None or not (phases := clocks.phases if phases is None else phases):
        return np.ones((channels, 1), complex)
    late = np.array(phases)[list(clocks.port[:channels])]
    return np.where(late[:, None] > 0.0, np.exp(-np.outer(late, s)), 1.0 + 0.0j)


class Tie(NamedTuple):
    """One spring and damper on the reduced mass of two hands, and the motion of both together."""

    k: float
    """N/m."""
    b: float
    """N·s/m; friction of the device included."""
    together_per_s: float
    """Rate of decay of both hands when they move together, s in 1/s: negative."""


def tie_of(network: Network, eigen: tuple[Complexes, Complexes], phases: Sequence[float]) -> Tie:
    """Returns the tie of two hands that nothing else holds, from the eigenvalues of their loop's change at these phases
    and its eigenvectors."""
    w, states = eigen
    s = np.log1p(w.astype(complex))
    kept = np.abs(1.0 + w) > MEMORY
    hands = states[:2] * at_one_instant(network, s, phases)
    return _tie(network, np.asarray(s[kept] * network.rate, complex), hands[:, kept])


def continuous_tie(network: Network) -> Tie | None:
    """Returns the tie in continuous time; None for other hands than two on links between them alone."""
    if network.channel_mass.size != 2 or network.point_mass.size or network.drives:
        return None
    K = matrices(network)[2] / _levers(network)[0]
    if not K.any() or np.abs(K.sum(axis=1)).max() > _ALIKE * np.abs(K).max():
        return None
    roots, states = np.linalg.eig(first_order(network))
    return _tie(network, np.asarray(roots, complex), np.asarray(states[:2], complex))


def _levers(network: Network) -> tuple[Floats, Floats]:
    """Returns the factors (2,) of way and of mass with which a link between two hands is a plain one, those of the
    first 1."""
    links = acting_links(network)
    if network.second is None or not links.size:
        return np.ones(2), np.ones(2)
    way, pull = network.second[links[0]]
    first, _ = network.ends[links[0]]
    ways, weights = np.array([1.0, way]), np.array([1.0, 1.0 / (way * pull)])
    return (ways, weights) if first == 0 else (ways[::-1] / way, weights[::-1] * way * pull)


def _tie(network: Network, s: Complexes, hands: Complexes) -> Tie:
    """Returns the tie from motions s (n,), 1/s, with positions of the hands (2, n): of the four slowest, two with the
    least momentum are between the hands, and the others of both together."""
    ways, weights = _levers(network)
    slowest = np.argsort(np.abs(s), kind="stable")[:4]
    s, hands, mass = s[slowest], ways[:, None] * hands[:, slowest], weights * network.channel_mass
    momentum = np.abs(mass @ hands) ** 2 / (mass.sum() * (mass @ np.abs(hands) ** 2))
    *between, first, second = np.argsort(momentum, kind="stable").tolist()
    reduced = mass.prod() / mass.sum()
    k, b = reduced * np.prod(s[between]).real, -reduced * s[between].sum().real
    return Tie(float(k), float(b), float(min(s[first].real, s[second].real)))


@np.errstate(all="ignore")
def continuous_pair(network: Network, most: float = UNLIKE) -> FeltPair:
    """Returns the pair that the hands would feel in continuous time."""
    if is_large(network):
        return no_pair(network.channel_mass.size, TOO_LARGE)
    hands, size = network.channel_mass.size, network.channel_mass.size + network.point_mass.size
    roots, states = np.linalg.eig(first_order(network))
    kick = network.rate * np.eye(2 * size)[:, size : size + hands]
    s = np.asarray(roots / network.rate, complex)
    moving = states[:hands], states[size : size + hands]
    motions = _motions(network, s, states, moving, kinetic_energy(network, states[:size]), kick)
    return _pair(network, motions, most)


def static_stiffness(network: Network) -> Floats:
    """Static stiffness (C, C), N/m, that steady pushes on the hands meet, the device's own springs included."""
    hands = network.channel_mass.size
    if is_large(network):
        return _sparse_static_stiffness(matrices(network, sparse=True)[2], hands)
    _, _, K = matrices(network)
    follows = np.linalg.lstsq(K[hands:, hands:], K[hands:, :hands], rcond=None)[0]
    met = np.asarray(K[:hands, :hands] - K[:hands, hands:] @ follows)
    if not any(gives := [one.compliance for one in network.drives]):
        return met
    own = np.diag(network.channel_stiffness)
    return np.asarray(own + (met - own) @ np.linalg.inv(np.eye(hands) + np.array(gives)[:, None] * (met - own)))


def _sparse_static_stiffness(K: Rows, hands: int) -> Floats:
    """Returns the static stiffness (hands, hands) from that of all points; NaN if it has no inverse."""
    from scipy.sparse.csgraph import connected_components

    component = connected_components(K, directed=False)[1]
    K = K.tocsr()[reached := np.isin(component, component[:hands])][:, reached].tocsc()  # the rest may be free
    own = K[:hands, :hands].toarray()
    if K.shape[0] == hands:
        return np.asarray(own)
    solve = factorised(K[hands:, hands:])
    return np.asarray(own - K[:hands, hands:] @ solve(K[hands:, :hands].toarray()) if solve else np.nan * own)


@np.errstate(all="ignore")
def drift_damping(network: Network) -> Floats:
    """Damping (C,), N·s/m, that brakes each hand that drifts on after a push, with all that it moves: impulse over way.
    NaN for a hand that a spring brings back."""
    hands, (_, Z, K) = network.channel_mass.size, matrices(network)
    if not (np.isfinite(Z).all() and np.isfinite(K).all()):
        return np.full(hands, math.nan)
    left, sizes, right = np.linalg.svd(K)
    free = sizes <= _ROUNDED * sizes.max(initial=0.0)
    pushed, rests, least = left[:, free], right[free].T, _ROUNDED * np.abs(Z).max(initial=0.0)
    left, brakes, right = np.linalg.svd(pushed.T @ Z @ rests)
    is_braked = brakes > least
    pushed, rests = pushed[:hands] @ left, rests[:hands] @ right.T
    ways = np.sum(rests / np.where(is_braked, brakes, np.inf) * pushed, axis=1)
    goes_on = np.abs(rests[:, ~is_braked]).max(axis=1, initial=0.0) > _SAME
    drifts = np.linalg.norm(rests, axis=1) > _SAME
    return np.where(goes_on, 0.0, np.where(drifts, 1.0 / ways, math.nan))


class Direction(NamedTuple):
    """Direction in the plane with what a hand feels along it: k, N/m, and b, N·s/m. The angle runs from x towards y,
    0 <= angle < pi, rad: a direction and its opposite are the same."""

    angle: float
    k: float
    b: float


def principal(pair_k: Floats, pair_b: Floats) -> tuple[Direction, Direction]:
    """Returns the two principal directions of a felt pair (2, 2) in the plane, at right angles, the stiffest first: the
    eigenvectors of the symmetric part of k, with k and b along each. If k is the same in all directions, they are those
    of b, the most damped first; if b is so too, x and y."""
    k, b = (0.5 * (np.asarray(one, float) + np.transpose(one)) for one in (pair_k, pair_b))
    k, b = (np.where(np.abs(one) > _ROUNDING * np.abs(one).max(), one, 0.0) for one in (k, b))

    def angle(of: Floats) -> float | None:
        """Angle of the largest value of a symmetric matrix; None if it is round."""
        along, across = 0.5 * (of[0, 0] - of[1, 1]), of[0, 1]
        is_round = math.hypot(along, across) <= _ROUND * float(np.abs(of).max())
        return None if is_round else 0.5 * math.atan2(across, along)

    first = next((one for one in (angle(k), angle(b)) if one is not None), 0.0)
    found = []
    for turn in (first, first + 0.5 * math.pi):
        n = np.array([math.cos(turn), math.sin(turn)])
        at = turn % math.pi
        along = (float(n @ one @ n) for one in (k, b))
        least = (_ROUNDING * float(np.abs(one).max()) for one in (k, b))
        found.append(
            Direction(
                at if at < math.pi else 0.0, *(v if abs(v) > m else 0.0 for v, m in zip(along, least, strict=True))
            )
        )
    return found[0], found[1]


def no_pair(
    hands: int, reason: str, share: float = 0.0, others: float = math.nan, at: tuple[float, ...] = ()
) -> FeltPair:
    """Returns a ``FeltPair`` of NaN for this number of hands, with the reason."""
    return FeltPair(np.full((hands, hands), np.nan), np.full((hands, hands), np.nan), share, others, at, reason)


def _motions(
    network: Network, s: Complexes, states: Complexes, moving: Sequence[Complexes], energy: Floats, kick: Floats
) -> _Motions:
    """Returns the motions. ``moving``: the hands' positions and velocities (C, n) in each. ``energy`` (C + M, n): the
    points' kinetic energies. ``kick`` (size, C): the state after an impulse on each hand alone."""
    hands, (at, speeds) = network.channel_mass.size, moving
    kicked = np.eye(hands) if network.mass_coupling is None else mobility(network)
    share = np.nan_to_num(energy[:hands].sum(axis=0) / energy.sum(axis=0))
    try:
        amounts = np.linalg.solve(states, (kick @ kicked).astype(complex))
    except np.linalg.LinAlgError:
        amounts = np.linalg.lstsq(states, (kick @ kicked).astype(complex), rcond=None)[0]
    carried, ways = (of[:, None, :] * amounts.T[None, :, :] for of in (speeds, at))
    return _Motions(s, at, share, carried, ways, kicked)


def _pair(network: Network, motions: _Motions, most: float) -> FeltPair:
    """Returns the pair. ``most``: limit of the difference between the answers of hands and pair, except for one hand
    without masses and for drifts in the plane without friction, whose eigenvectors in the loop coincide."""
    hands, rate, (s, at, share, carried, *_) = network.channel_mass.size, network.rate, motions
    begins, drifts = np.zeros((2, hands, 0))
    if network.rows is not None and not network.point_mass.size:
        begins, drifts = free_motions(network)  # of them the eigenvectors coincide
    theirs = np.flatnonzero(share >= OWN_SHARE)
    theirs = theirs[np.argsort(np.abs(s[theirs]), kind="stable")[: 2 * hands]]
    own = theirs[begins.shape[1] :]
    sums, others = _sums(s, own), math.nan
    alone = (np.abs(carried) ** 2).sum(axis=(0, 1)) * np.diagonal(sums).real
    least = (_SHOWN / 2.0) ** 2 * _squared(carried.reshape(-1, s.size), sums)  # for each of a conjugate pair
    shown = [i for i in np.argsort(-alone) if s[i].imag > 0.0 and alone[i] > least]
    found = tuple(float(abs(s[i]) * rate / (2.0 * np.pi)) for i in shown)
    X, of = at[:, own], s[own] * rate
    if network.mass_coupling is None:
        inertia = network.channel_mass[:, None] * X * of**2
    else:
        inertia = network.mass_matrix @ (X * of**2)
    pairs = (begins, X), (drifts, X * of), (0.0 * drifts, inertia)
    X, moving, inertia = (np.asarray(np.hstack(pair), complex) for pair in pairs)
    both = np.vstack([X, moving])
    alike = np.vstack([X, moving / max(np.abs(of).max(initial=0.0 if own.size else rate), 1e-300)])
    if theirs.size < 2 * hands or any(np.abs(s[own] - one.conj()).min() > _SAME * abs(one) for one in s[own]):
        reason = TOGETHER
    elif (np.abs(np.abs(s[own].imag) - np.pi) < _SAME).any():
        reason = "its own motion changes its direction with every sample"
    elif not np.linalg.cond(alike / np.linalg.norm(alike, axis=0)) < _WORST:
        reason = "two of its own motions coincide"
    else:
        k, b = np.hsplit(-np.linalg.solve(both.T, inertia.T).T.real, 2)
        digit = OF_STEP * np.sqrt(np.outer(network.channel_mass, network.channel_mass)) * rate
        k, b = np.where(np.abs(k) <= digit * rate, 0.0, k), np.where(np.abs(b) <= digit, 0.0, b)
        amounts = np.linalg.solve(both, rate * np.vstack([0.0 * motions.kicked, motions.kicked]))
        of_pair = np.concatenate([np.zeros(begins.shape[1]), s[own]]), X[:, None, :] * amounts.T
        is_alone = (network.point_mass.size + hands == 1 and not network.drives) or drifts.any()
        answers, of_the_pair = motions.ways.swapaxes(0, 1), of_pair[1].swapaxes(0, 1)
        others = 0.0 if is_alone else float(unlike(motions.s, answers, of_pair[0], of_the_pair).max())
        if others <= most:
            return FeltPair(k, b, float(share[theirs].min()), others, found)
        reason = ANSWERS
    return no_pair(hands, reason, float(share[theirs].min(initial=1.0)), others, found)


@np.errstate(all="ignore")
def unlike(s: Complexes, ways: Complexes, of_pair: Complexes, pair_ways: Complexes) -> Floats:
    """Largest difference (N,) of a hand's position after an impulse from the pair's, rms over the samples until all
    positions are small, of the largest one. ``s`` (n,) or (N, n), ``ways`` (N, C, n): motions after each of N impulses;
    the others: those of the pair."""
    decays, growth = -s.real, s.real.max(axis=-1, initial=0.0)
    slowest = np.where(decays > _LASTS, decays, 1.0).min(axis=-1, initial=1.0)
    longest = np.where(growth > _LASTS, _TURNS / growth, _LONG / slowest)
    times, weights = np.geomspace(1.0, longest, _TIMES // 3, axis=-1), (np.arange(_TIMES) + 0.5) / _TIMES
    largest = np.zeros(len(ways))
    for _ in range(2):
        at = np.rint(times)
        each = ((s, ways), (of_pair, pair_ways))
        positions, others = ((of @ np.exp(n[..., :, None] * at[..., None, :])).real for n, of in each)
        sizes = np.abs(positions).max(axis=-2)
        largest = np.maximum(largest, sizes.max(axis=-1))
        end = np.where(sizes > _SMALL * largest[:, None], at, 1.0).max(axis=-1)[:, None]
        times = 1.0 + (2.0 * end - 1.0) * weights**2  # the steps grow, so none is an oscillation's period
    kept = (weights * (at <= end))[:, None]
    means = np.sum((positions - others) ** 2 * kept, axis=-1) / np.sum(kept, axis=-1)
    off = np.nan_to_num(np.sqrt(means.max(axis=-1)) / largest, nan=math.inf, posinf=math.inf)
    return np.where(off < _ALIKE, 0.0, off)


def _sums(s: Complexes, own: Indices) -> Complexes:
    """Sum (n, n) over all samples of the product of one motion and the conjugate of another. If one does not decay, the
    sum covers a few turns of the slowest of the hands' own."""
    both = s[:, None] + s.conj()[None, :]
    if (s.real < 0.0).all():
        return np.asarray(1.0 / -np.expm1(both))
    lasts = _TURNS / max(float(np.abs(s[own]).min(initial=1.0)), _RESTS)
    return np.asarray(np.where(np.abs(both) * lasts < _RESTS, lasts, np.expm1(lasts * both) / np.expm1(both)))


def _squared(amounts: Complexes, sums: Complexes) -> float:
    """Returns the sum of squares of motions (rows, n) over those samples."""
    return float(np.nan_to_num((amounts.conj() @ sums.T) * amounts).sum().real)


_ALONG = 0.3  # of the masses' amplitude; a smaller one of the hand does not shake them
_SWINGS = 1e-9  # relative imaginary part; a motion with less does not oscillate


def felt_mass(network: Network, hand_stiffness: float) -> tuple[float, float]:
    """Returns the mass in kg that the masses in the loop feel like, and the frequency in Hz at which a hand of this
    stiffness (N/m) shakes them. NaN if nothing oscillates, or if the hand hardly moves and the masses oscillate by
    themselves. ``network``: one channel and the masses that it moves; it is not large."""
    held = replace(network, channel_stiffness=np.array([hand_stiffness]))
    change, points, *_ = loop(held)
    w, states = np.linalg.eig(change)
    kept = np.abs(1.0 + w) > MEMORY
    s = np.asarray(network.rate * np.log1p(w[kept].astype(complex)), complex)
    return _of_slowest(held, s, points @ states[:, kept])


def continuous_mass(network: Network, hand_stiffness: float) -> float:
    """Returns the mass in kg that the same masses feel like in continuous time."""
    held = replace(network, channel_stiffness=np.array([hand_stiffness]))
    roots, states = np.linalg.eig(first_order(held))
    return _of_slowest(held, np.asarray(roots, complex), states[: len(states) // 2])[0]


def _of_slowest(network: Network, s: Complexes, moved: Complexes) -> tuple[float, float]:
    swinging = np.flatnonzero(s.imag > _SWINGS * np.abs(s))
    if not swinging.size:
        return math.nan, math.nan
    slowest = swinging[np.argmin(np.abs(s[swinging]))]
    hand, *masses = np.abs(moved[:, slowest])
    together = math.sqrt(float(network.point_mass @ np.square(masses)) / network.point_mass.sum())
    mass = float(network.channel_stiffness[0] / np.abs(s[slowest]) ** 2 - network.channel_mass[0])
    if mass <= 0.0 or hand < _ALONG * together:
        return math.nan, math.nan
    return mass, float(s[slowest].imag) / (2.0 * math.pi)
