"""measure_hands: pushes each of several linked hands, and identifies their springs and dampers from the free motion.

The scene is used only to know if something holds the hands. Rows of delayed positions of a free motion span its state
(Ho and Kalman, 1966; Juang and Pappa's eigensystem realisation, 1985). They give the poles z and the amplitudes X of
the hands. The 2 n motions with most energy, s = ln(z)/T, determine k and b: M X S² + b X S + k X = 0. If noise hides
all other motions, least squares refine them: with 2 µm of noise the median error of k and b is 0.3 % instead of 2 %,
with 10 µm 1.5 % instead of 50 %.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any, NamedTuple, Unpack

import numpy as np
from scipy.optimize import least_squares

from hapsim.errors import UsageError
from hapsim.loop.ring import BRIDGED, LATE_FORCE, LIMITED
from hapsim.measuring.converters import Complexes, Floats
from hapsim.measuring.measurement_options import Run, RunOptions, require_pushable
from hapsim.measuring.pushes import pushes
from hapsim.number_format import percent
from hapsim.one_thread import one_thread
from hapsim.recording.trace import Trace
from hapsim.running.motors import as_limited
from hapsim.running.run import run_to_end
from hapsim.running.session_options import Excitation
from hapsim.scene import Scene
from hapsim.scene.input_states import with_mock_inputs_on
from hapsim.scene.load import SceneSource, as_scene
from hapsim.scene.scaled_links import energy_weights
from hapsim.theory.network.felt import principal

SECONDS = 4.0
"""Length of the record for each hand, s."""
_PUSHES = 4
_RUN_UP = 8  # samples, and as many for each of the delay, in which the poles that are no hand's decay after a push


def measure_hands(
    scene: SceneSource,
    *,
    channels: Sequence[int],
    duration: float | None = None,
    push: float | None = None,
    run: Run = run_to_end,
    **options: Unpack[RunOptions],
) -> HandsMeasurement:
    """Pushes the hands on these channels, one after the other, and identifies the springs and dampers that they feel.

    `duration`: seconds for each hand [default: 4]; `push`: largest force, N. Raises UsageError if the motion does not
    show as many springs and dampers. The rest is as for `measure`.
    """
    scene = with_mock_inputs_on(as_scene(scene))
    scene.require_impedance("`measure_hands` finds stiffness and damping; `measure` finds mass and damping")
    scene.require_line("`measure` takes both coordinates of a hand together")
    require_pushable(scene, channels, duration, push)
    if len({scene.device.motions(scene.channels)[channel] for channel in channels}) > 1:
        raise UsageError("found linear and rotary hands, expected hands of one motion; measure each by its --channel")
    scene, run = as_limited(scene, channels, push, run, options)
    traces, segments = [], list[Floats]()
    for number, channel in enumerate(channels):
        seconds = SECONDS if duration is None else duration
        excitation = repeated_pushes(scene, channel, seconds, push)
        trace = run(with_noise(scene, number), duration=seconds, excitation=excitation)
        traces.append(trace)
        segments += free_motions(trace, excitation, scene.device.delay, list(channels))
    with one_thread():
        return identify_free_motions(
            segments,
            mass_of(scene, channels),
            scene.rate,
            _is_held(scene, channels),
            tuple(channels),
            tuple(traces),
            _weights(scene, channels),
        )


def repeated_pushes(scene: Scene, channel: int, seconds: float, push: float | None) -> Excitation:
    """Returns the pushes of a hand in a record of this length. `push`: the largest force, N; None: as for `measure`."""
    every = int(seconds * scene.rate) // _PUSHES
    return replace(pushes(scene, channel, seconds, push), start=0, every=every, first=False)


def _weights(scene: Scene, channels: Sequence[int]) -> Floats:
    """Returns the factor (n,) of each hand's force with which stiffness is symmetric in spite of a link with a gain."""
    of_hands = energy_weights(scene)
    return np.array([of_hands.get(scene.hand_on(channel), 1.0) for channel in channels])


def with_noise(scene: Scene, number: int) -> Scene:
    """Returns the scene with other noise of its mocks for each number. A mock draws the same at each arming, so that
    the errors of two runs might cancel; those of a device do not."""

    def reseeded(mock: Any) -> Any:
        return mock and mock.model_copy(update={"seed": (mock.seed + number) % 2**32})

    mocks = {name: reseeded(one) for name, one in scene.mocks.items()}
    return scene.model_copy(update={"mock": reseeded(scene.mock), "mocks": mocks})


def mass_of(scene: Scene, channels: Sequence[int]) -> Floats:
    """Returns the mass matrix (n, n) of the hands on these channels, kg."""
    rows = scene.device.mass_matrix(scene.channels)
    whole = np.diag(scene.device.masses(scene.channels)) if rows is None else np.array(rows)
    return whole[np.ix_(channels, channels)]


def _is_held(scene: Scene, channels: Sequence[int]) -> bool:
    """Returns True if something holds these hands at a place of rest, which adds a constant to their motion."""
    hands = {name for name, one in scene.device_points.items() if one.channel in channels}
    held = linked_to(scene, hands) & scene.grounds.keys()
    return bool(held) or max(scene.device.stiffnesses(scene.channels)) > 0.0


def linked_to(scene: Scene, points: set[str]) -> set[str]:
    """Returns the modules that a chain of links joins to these, with the grounds at its ends."""
    links = [{end.partition(".")[0] for end in one.between} for one in scene.links.values()]
    for _ in links:
        points = points.union(*(ends for ends in links if ends & points - scene.grounds.keys()))
    return points


def free_motions(trace: Trace, pushed: Excitation, delay: float, channels: list[int], start: int = 0) -> list[Floats]:
    """Returns the free motions between two pushes from sample `start` on, each (samples, n) in m, without gaps, late or
    limited forces, once the loop's other motions are over."""
    begins = np.arange(start, trace.sample[-1] if trace.sample.size else start, pushed.every)
    ends, begins = begins + pushed.every, begins + pushed.ticks + _RUN_UP * (1 + math.ceil(delay))
    bad = (trace.flags & (LATE_FORCE | BRIDGED | LIMITED)) != 0
    breaks = np.flatnonzero(bad | (np.diff(trace.sample, prepend=trace.sample[:1] - 1) != 1))
    found = []
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        first, last = np.searchsorted(trace.sample, [begin, end]).tolist()
        edges = [first, *breaks[(breaks >= first) & (breaks < last)].tolist(), last]
        found += [trace.position[low + (low != first) : high, channels] for low, high in pairwise(edges)]
    return found


DELAYS = 40  # rows of each hand
_SPANS = (0.4, 0.2)  # of a free motion: from the first of these rows to the last; and a second span, to compare
_CLEAR = 4.0  # times the noise: the least size of a motion
_MOST_ORDER = 60
_CONSTANT = 1e-3  # m, for a motion of 1 m: the value of the constant row
_TRIES = 8  # fits with added noise, for the uncertainty
_PAIRED = 1e-6
_MOST_OTHER, _MOST_ASYMMETRY = 0.1, 0.3  # of the energy; of the largest k: limits for springs and dampers
_MOST_REFINED = 4  # hands
_MOST_COLUMNS = 1e8  # numbers of a singular value decomposition, rows squared times columns
_ROUNDED = 1e-6  # of the largest: the least uncertainty, because the rounding of forces is no noise of the positions


class MeasuredDirection(NamedTuple):
    """k in N/m and b in N·s/m along a principal direction, with standard uncertainties; `angle`: from x to y, rad."""

    angle: float
    k: float
    b: float
    k_uncertainty: float
    b_uncertainty: float

    @property
    def angle_deg(self) -> float:
        """The angle in degrees."""
        return math.degrees(self.angle)


@dataclass(frozen=True)
class HandsMeasurement:
    """k (n, n) in N/m and b (n, n) in N·s/m of n hands, with standard uncertainties without that of the masses.

    Off the diagonal are the couplings between hands; they are negative.
    """

    channels: tuple[int, ...]
    k: Floats
    b: Floats
    k_uncertainty: Floats
    b_uncertainty: Floats
    poles: tuple[complex, ...]
    """Poles of the 2 n motions, z-plane."""
    others: float
    """Share of the energy in other motions."""
    samples: int
    traces: tuple[Trace, ...]
    at_m: tuple[float, float] | None = None
    """Place of a hand in the plane, whose coordinates are the channels."""

    @property
    def principal(self) -> list[MeasuredDirection]:
        """The two principal directions of a hand in the plane, the stiffest first."""
        found = []
        for one in principal(self.k, self.b):
            n = np.array([math.cos(one.angle), math.sin(one.angle)])
            unsure = (float(np.linalg.norm(np.outer(n, n) * each)) for each in (self.k_uncertainty, self.b_uncertainty))
            found.append(MeasuredDirection(*one, *unsure))
        return found


class _Modes(NamedTuple):
    """The modes of n hands: poles (r,), amplitudes (n, r) and energy (r,), without the constant of the rest."""

    poles: Complexes
    hands: Complexes
    energy: Floats

    def others(self, own: Any) -> float:
        """Returns the share of the energy in the modes beside these."""
        return max(0.0, 1.0 - float(self.energy[own].sum() / self.energy.sum()))


def _not_of_springs(others: float) -> str:
    return (
        "the motion is not that of hands linked by springs and dampers: other motions, as of simulated masses, have "
        f"{percent(others, 2)} of the energy, or a contact opens, or a damper acts beyond a moving mass. `hapsim "
        "measure --impedance` measures the impedance at each frequency"
    )


def identify_free_motions(
    segments: list[Floats],
    mass: Floats,
    rate: float,
    is_held: bool,
    channels: tuple[int, ...],
    traces: tuple[Trace, ...],
    weights: Floats | float = 1.0,
    floor: float = 0.0,
) -> HandsMeasurement:
    """Identifies k and b from free motions, each (samples, n) m, of n hands of this mass (n, n) kg. `is_held`: if they
    have a place of rest. `weights`: (n,) of the hands' forces, with which k should be symmetric. `floor`: m,
    smaller motions count as noise. Raises UsageError if the motions do not show as many springs and dampers."""
    rests = _CONSTANT * is_held
    longest = max((len(one) for one in segments), default=0)
    segments = [one for one in segments if 2 * len(one) >= longest > 2 * DELAYS]
    if not segments:
        raise UsageError("too little of the free motion was recorded without a gap: record longer (--duration)")
    n, rows = len(mass), _rows(segments, _SPANS[0], rests)
    noise = _noise(rows[0])
    modes = _modes(*rows, n, max(noise, floor))
    own = _hand_modes(modes, n)
    k, b = _matrices(modes, own, mass, rate)
    random = np.random.default_rng(0)

    def deviation(tried: list[Floats], share: float) -> Floats:
        again = _modes(*_rows(tried, share, rests), n, max(noise, floor))
        return np.asarray(_matrices(again, _hand_modes(again, n), mass, rate) - np.array([k, b]))

    noisy = ([one + noise * random.standard_normal(one.shape) for one in segments] for _ in range(_TRIES))
    spread = np.sqrt(np.mean([np.square(deviation(one, _SPANS[0])) for one in noisy], axis=0))
    # If the motion obeys one law, other rows, or half of the free motions, give the same result.
    compared = [deviation(segments, _SPANS[1])] + [deviation(half, _SPANS[0]) for half in _halves(segments)]
    off = np.sqrt(spread**2 + np.square(compared).max(axis=0))
    if modes.poles.size == 2 * n and n <= _MOST_REFINED:
        *finer, spread = _refined(segments, mass, rate, is_held, k, b)
        compared = [np.array(_refined(half, mass, rate, is_held, *finer)[:2]) - finer for half in _halves(segments)]
        finer_off = np.sqrt(spread**2 + np.square(compared).max(axis=0, initial=0.0))
        if finer_off.sum(axis=(1, 2)).prod() < off.sum(axis=(1, 2)).prod():
            (k, b), off = finer, finer_off
    off = np.maximum(off, _ROUNDED * np.abs([k, b]).max(axis=(1, 2))[:, None, None])
    others = modes.others(own)
    weighted = np.array(weights, float).reshape(-1, 1) * k
    asymmetry = float(np.abs(weighted - weighted.T).max() / np.abs(weighted).max(initial=1e-300))
    if others > _MOST_OTHER or asymmetry > _MOST_ASYMMETRY:
        raise UsageError(_not_of_springs(others))
    samples, poles = sum(map(len, segments)), tuple(modes.poles[own].tolist())
    return HandsMeasurement(channels, k, b, off[0], off[1], poles, others, samples, traces)


def _halves(segments: list[Floats]) -> list[list[Floats]]:
    """Returns every second pair of free motions, and the others, for two ways to pair them. The signs of pushes
    alternate: in a pair, errors of a force that bends with the square of the way cancel. With fewer than four pushes on
    each coordinate, which a half might then lack, it returns every second motion, and the others; nothing of three."""
    if len(segments) < 4 * segments[0].shape[1]:
        return [segments[::2], segments[1::2]] if len(segments) > 3 else []
    ways = product((0, 1), (0, 1))
    return [[one for i, one in enumerate(segments, first) if i // 2 % 2 == half] for first, half in ways]


def _rows(segments: list[Floats], share: float, rests: float) -> tuple[Floats, Floats]:
    """Returns a table of delayed positions (rows, columns), and the same one sample later.

    Each hand has `DELAYS` rows; the last row is constant."""
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
    return np.hstack(tables[0]), np.hstack(tables[1])


def _noise(before: Floats) -> float:
    """Returns the noise of a position in a table of delayed ones, m, from the least of its singular values."""
    values = np.linalg.svd(before[:-1], compute_uv=False)
    return float(np.median(values[len(values) // 2 :])) / math.sqrt(before.shape[1])


def _modes(before: Floats, after: Floats, n: int, noise: float) -> _Modes:
    left, values, right = np.linalg.svd(before, full_matrices=False)
    order = min(int(np.count_nonzero(values > _CLEAR * noise * np.sqrt(before.shape[1]))), _MOST_ORDER)
    left, values, right = left[:, :order], values[:order], right[:order]
    poles, states = np.linalg.eig(left.T @ after @ right.T / values)
    shapes = left @ states
    times = (np.abs(np.linalg.solve(states, np.diag(values))) ** 2).sum(axis=1)  # the rows of `right` are orthonormal
    moves = np.abs(shapes[-1]) ** 2 * times <= 0.5 * (before[-1] ** 2).sum()
    energy = (np.abs(shapes[:n]) ** 2).sum(axis=0) * times
    return _Modes(poles[moves].astype(complex), shapes[:n, moves], energy[moves])


def _hand_modes(modes: _Modes, n: int) -> Any:
    """Returns the indices of the modes with most energy. Raises UsageError if they are not of springs and dampers."""
    own = np.argsort(-modes.energy)[: 2 * n]
    poles = modes.poles[own]
    whole = len(own) == 2 * n and all(np.abs(poles - one.conjugate()).min() < _PAIRED for one in poles)
    if not whole or (poles.real[np.abs(poles.imag) < _PAIRED] <= 0.0).any():
        others = modes.others(own) if len(own) else 0.0
        raise UsageError(
            _not_of_springs(others)
            if others > _MOST_OTHER
            else f"the motion does not show clearly the {2 * n} decaying modes of {n} springs and dampers: push "
            "harder (--push), or record longer (--duration)"
        )
    return own


def _matrices(modes: _Modes, own: Any, mass: Floats, rate: float) -> tuple[Floats, Floats]:
    hands, s = modes.hands[:, own], rate * np.log(modes.poles[own])
    both = -np.linalg.solve(np.vstack([hands, hands * s]).T, (mass @ (hands * s**2)).T).T.real
    return both[:, : len(mass)], both[:, len(mass) :]


def _refined(
    segments: list[Floats], mass: Floats, rate: float, is_held: bool, k: Floats, b: Floats
) -> tuple[Floats, Floats, Floats]:
    """Returns k, b and their spread (2, n, n), by least squares from a first k and b, if only the hands move.

    M x'' + b x' + k x = 0. Each free motion has its own initial state and, if the hands are held, a place of rest."""
    n, length = len(mass), min(map(len, segments))
    data = np.stack([one[:length].ravel() for one in segments], axis=1)
    scale = np.abs([k, b]).max(axis=(1, 2))[:, None, None]
    inverse_mass = np.linalg.inv(mass)
    time, rests = np.arange(length) / rate, np.broadcast_to(np.eye(n)[:, : n * is_held], (length, n, n * is_held))

    def left(numbers: Floats) -> Floats:
        """Returns what free motions of this stiffness and damping leave of the data."""
        stiffness, damping = numbers.reshape(2, n, n) * scale
        rates = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse_mass @ stiffness, -inverse_mass @ damping]])
        s, states = np.linalg.eig(rates)
        begun = np.exp(np.outer(time, s))[:, None, :] * states[:n] @ np.linalg.inv(states)
        moves = np.concatenate([begun.real, rests], axis=2).reshape(length * n, -1)
        along = np.linalg.qr(moves)[0]
        return np.asarray((data - along @ (along.T @ data)).ravel())

    size = float(np.sqrt(np.mean(left((np.array([k, b]) / scale).ravel()) ** 2)))
    best = least_squares(lambda numbers: left(numbers) / size, (np.array([k, b]) / scale).ravel())
    free = data.size - 3 * n * len(segments) - 2 * n * n
    inverse = np.linalg.inv(best.jac.T @ best.jac)
    # Noise that passes the loop shakes the hands at their own frequencies, in each free motion otherwise.
    each = np.einsum("ijk,ij->jk", best.jac.reshape(*data.shape, -1), best.fun.reshape(data.shape)) @ inverse
    variance = np.maximum(np.diag(inverse) * 2.0 * best.cost / free, np.square(each).sum(axis=0))
    spread = np.sqrt(variance).reshape(2, n, n) * scale
    found = best.x.reshape(2, n, n) * scale
    return found[0], found[1], np.asarray(spread)
