"""Fits mass, friction, stiffness, dry friction and delay of a device to records of its motion under known forces, and
optionally a second mass that hangs on it by a spring and a damper.

The sent forces are known exactly, the positions up to white noise and rounding. So the most likely parameters are those
whose motion is closest to the positions (output error, least squares). In each swing the velocity keeps its sign. Each
begins in a state of its own, which is linear and projected out. The covariance is that of least squares; if the
residual is not white, it comes from the scatter of the swings instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares

from hapsim.holds import HOLDS
from hapsim.measuring.converters import Converters, Floats
from hapsim.measuring.device_motion import Motion, SampledMotion, Swing, sampled_motion
from hapsim.measuring.trace_quality import ROUNDING

Shape = tuple[float, ...]
"""The nonlinear parameters, in sample periods: delay, b0 T/m, k0 T²/m; of a second mass k T²/m, c T/m, m/M."""

_STEP = 1e-5  # of a parameter's scale, for differences
_WHITE = 5.0  # standard deviations of white noise's correlation from row to row
_FEW_SWINGS = 12  # with fewer swings, their scatter shows no covariance
_MARGIN = 4  # rows beyond the longest delay of the search
_SMOOTH = 9  # rows
_LEAST_ROWS = 24
_SINGULAR = 1e-10  # of the largest effect: a parameter with a smaller one cannot be identified
# Bounds of the search, scaled: gain, dry friction, constant force, delay, friction and stiffness.
_LEAST, _MOST = (-np.inf, -np.inf, -np.inf, -1.0, -5.0, -50.0), (np.inf, np.inf, np.inf, np.inf, 1e3, 1e4)
_MOST_OF_HAND = 1e3  # times the initial value
_TRIES = 100


@dataclass(frozen=True)
class Estimate:
    """A value with its standard uncertainty, in the value's unit."""

    value: float
    uncertainty: float


@dataclass(frozen=True)
class HandFit:
    """A second mass (kg) on a spring (N/m) and a damper (N·s/m)."""

    mass: Estimate
    stiffness: Estimate
    damping: Estimate


@dataclass(frozen=True, kw_only=True)
class DeviceFit:
    """The identified parameters, in SI units; the delay in sample periods."""

    mass: Estimate
    friction: Estimate
    stiffness: Estimate
    delay: Estimate
    coulomb: Estimate
    """Dry friction, N."""
    constant_force: Estimate
    """Constant force, N: gravity, or an offset of the force."""
    hand: HandFit | None
    """A second mass that moves with the device; None if one mass explains the motion."""
    samples: int
    """Number of samples of the fit: those in swings."""
    shape: Shape
    residual_counts: float
    """Residual of the positions, counts rms."""
    unexplained: float
    """Share of the motion, without the free one, that the forces do not explain, rms."""
    correlation: float
    """Correlation of the residual from one row to the next; 0 for noise."""
    swings: tuple[Swing, ...] = field(repr=False, compare=False)
    residuals: tuple[Floats, ...] = field(repr=False, compare=False)
    """Residual in each swing, counts."""

    @property
    def is_white(self) -> bool:
        """True if the residual is white noise."""
        return self.correlation * math.sqrt(self.samples) < _WHITE


def fit_device(
    motions: list[Motion],
    swings: list[Swing],
    begins: Iterable[Shape],
    count_m: float,
    rate_hz: float,
    converters: Converters,
    most_delay: float,
) -> DeviceFit | None:
    """Returns the fit, started from the best of `begins`; None if there is too little motion. `count_m`: m per count;
    `most_delay`: sample periods. A parameter that the record does not show has a huge uncertainty."""
    if sum(swing.rows for swing in swings) < _LEAST_ROWS:
        return None
    table = _Table(motions, swings, most_delay, converters)
    begin = table.begin(begins)
    if begin is None:
        return None
    push = max(float(np.max(np.abs(motion.force), initial=0.0)) for motion in motions)
    typical = float(np.median([swing.rows for swing in swings]))
    gain, hand = abs(begin[0]), begin[6:]
    scale = np.array([gain, gain * push, gain * push, 1.0, 1.0 / typical, 1.0 / typical**2, *hand])
    least = np.array([*_LEAST, *(0.0 * hand)])
    most = np.array([*_MOST[:3], most_delay, *_MOST[4:], *(_MOST_OF_HAND + 0.0 * hand)])

    def left(scaled: Floats) -> Floats:
        return table.left(scaled * scale)

    def slopes_at(scaled: Floats) -> Floats:
        return table.slopes(scaled, scale)

    def in_si(scaled: Floats) -> Floats:
        return _in_si(scaled * scale, count_m, 1.0 / rate_hz)

    found, slopes = _least_squares(left, slopes_at, begin / scale, least, most)
    residual = np.zeros(table.inside.shape)
    residual[table.inside] = left(found)
    uncertainty = norm(_slopes(in_si, found) @ _spread(table, residual, slopes), axis=1)
    estimates = [Estimate(*pair) for pair in zip(in_si(found).tolist(), uncertainty.tolist(), strict=True)]
    mass, coulomb, constant, delay, friction, stiffness, *of_hand = estimates
    shape = tuple((found * scale)[3:].tolist())
    return DeviceFit(
        mass=mass,
        friction=friction,
        stiffness=stiffness,
        delay=delay,
        coulomb=coulomb,
        constant_force=constant,
        hand=HandFit(*of_hand) if of_hand else None,
        samples=int(np.count_nonzero(table.inside)),
        shape=shape,
        residual_counts=_rms(table, residual, found.size),
        unexplained=float(norm(residual) / norm(table.columns(shape)[:, 0])),
        correlation=_correlation(table, residual),
        swings=tuple(swings),
        residuals=tuple(row[inside] for row, inside in zip(residual, table.inside, strict=True)),
    )


def sensed_and_fitted(
    motions: list[Motion], fit: DeviceFit, apart: float, count_m: float, rate_hz: float, converters: Converters
) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
    """Returns the swing of each row of the fit (R,), its sensed acceleration, and the fitted one under the forces that
    act `apart` sample periods after it and before it; m/s²."""
    table = _Table(motions, list(fit.swings), math.ceil(fit.delay.value + 1.0), converters)
    gain = 1.0 / (rate_hz**2 * count_m * fit.mass.value)
    values = np.array([gain, gain * fit.coulomb.value, gain * fit.constant_force.value, *fit.shape])
    after, before = (table.accelerations(values, late) * count_m * rate_hz**2 for late in (apart, -apart))
    return np.nonzero(table.inside)[0], table.sensed, after, before


def _least_squares(
    left: Callable[[Floats], Floats],
    slopes_at: Callable[[Floats], Floats],
    begin: Floats,
    least: Floats,
    most: Floats,
) -> tuple[Floats, Floats]:
    """Returns the scaled parameters with the least residual, and the slopes there."""
    begin = np.clip(begin, least + _STEP, most - _STEP)
    to_the_end = {"xtol": 1e-10, "ftol": 1e-12, "gtol": 1e-12, "max_nfev": _TRIES}
    found = least_squares(left, begin, slopes_at, (least, most), **to_the_end).x
    slopes = slopes_at(found)
    refined = found - np.linalg.lstsq(slopes, left(found), rcond=_SINGULAR)[0]
    if np.all((least < refined) & (refined < most)) and norm(left(refined)) < norm(left(found)):
        found = refined
    return found, slopes


def hands_on(delay: float, rate_hz: float) -> list[Shape]:
    """Returns start values for a fit of two masses: modes of 3 to 130 Hz, various dampings, a light to heavy hand."""
    eigens, dampings, ratios = np.geomspace(20.0, 800.0, 10) / rate_hz, (0.05, 0.2, 0.6), (0.1, 0.3, 1.0, 3.0)
    return [
        (delay, 0.0, 0.0, float(eigen**2 / (1.0 + ratio)), float(2.0 * damping * eigen / (1.0 + ratio)), ratio)
        for eigen, damping, ratio in product(eigens, dampings, ratios)
    ]


class _Table:
    """The swings as a table (S, L), padded to the longest."""

    def __init__(self, motions: list[Motion], swings: list[Swing], most_delay: float, converters: Converters) -> None:
        pad = math.ceil(most_delay) + _MARGIN
        # All motions end to end, each between zeros: no force acted before.
        self._force = np.concatenate([np.pad(motion.force, pad) for motion in motions])
        position = np.concatenate([np.pad(motion.position, pad) for motion in motions])
        starts = np.cumsum([pad, *(motion.position.size + 2 * pad for motion in motions)])
        lengths = np.array([[swing.rows] for swing in swings])
        along = np.arange(np.max(lengths))
        self.inside = along < lengths
        first = np.array([[starts[swing.motion] + swing.first] for swing in swings])
        self._index = np.where(self.inside, first + along, pad)
        self._position = position[self._index] * self.inside
        sensed = np.concatenate([np.pad(motion.acceleration, pad) for motion in motions])
        self.sensed = sensed[self._index][self.inside]
        going = np.sign(np.gradient(uniform_filter1d(position, _SMOOTH)))[self._index]
        side = np.array([[swing.side] for swing in swings])
        self._side = np.where(side == 0.0, going, side)
        self._most_delay, self._converters = most_delay, converters

    def columns(self, shape: Shape) -> Floats:
        """Returns (R, 4), row after row: the positions, and those under unit gain, dry friction and constant force. The
        free motion that fits each best is subtracted, swing by swing."""
        motion = self._motion_of(shape)
        columns = np.concatenate([self._position[:, :, None], self._answers(motion)], axis=2) * self.inside[:, :, None]
        free = motion.free(self.inside.shape[1]) * self.inside[:, :, None]
        basis, _ = np.linalg.qr(free / norm(free, axis=1, keepdims=True))
        return np.asarray((columns - basis @ (basis.transpose(0, 2, 1) @ columns))[self.inside])

    def _motion_of(self, shape: Sequence[float]) -> SampledMotion:
        delay, friction, stiffness, *hand = shape
        delay = min(max(delay, -1.0), self._most_delay + 1.0)
        return sampled_motion(friction, stiffness, delay, self._converters, hand)

    def _answers(self, motion: SampledMotion) -> Floats:
        """Returns the motions (S, L, 3) under unit gain, dry friction and constant force, from rest."""
        newest = self._index - motion.whole_delay - 1
        pushed = motion.answer_to([self._force[newest - age] for age in range(len(motion.gains))])
        constant = np.broadcast_to(motion.answer_at_once(np.ones(pushed.shape[1])), pushed.shape)
        return np.stack([pushed, -motion.answer_at_once(self._side), constant], axis=2)

    def accelerations(self, values: Floats, late: float) -> Floats:
        """Returns the accelerations (R,) of the fitted motion, counts per squared sample period, under the force that
        acts `late` sample periods after each sample. `values`: of the fit."""
        gain, motion = values[0], self._motion_of(tuple(values[3:]))
        weights, length, inside = values[:3], self.inside.shape[1], self.inside[:, :, None]
        rest = (self._position - self._answers(motion) @ weights)[:, :, None] * inside
        begin = np.linalg.pinv(motion.free(length) * inside) @ rest
        turning = motion.turning()
        moving = self._answers(turning) @ weights + (turning.free(length) @ begin)[:, :, 0]
        whole = math.floor(delay := values[3] - late)
        acts = next(piece.level for piece in HOLDS[self._converters.hold].pieces(delay - whole) if piece.duration > 0.0)
        force = sum(weight * self._force[self._index - whole - age] for age, weight in enumerate(acts))
        return np.asarray((moving + gain * force)[self.inside])

    def begin(self, begins: Iterable[Shape]) -> Floats | None:
        """Returns the parameters of the shape with the least residual; None if no force explains anything."""
        best, least = None, math.inf
        for shape in begins:
            columns = self.columns(shape)
            size = norm(columns, axis=0)
            size[size == 0.0] = 1.0
            found = np.linalg.lstsq(columns[:, 1:] / size[1:], columns[:, 0], rcond=_SINGULAR)[0] / size[1:]
            left = float(norm(columns[:, 0] - columns[:, 1:] @ found))
            if left < least and found[0] != 0.0:
                best, least = np.concatenate([found, shape]), left
        return best

    def left(self, values: Floats) -> Floats:
        """Returns the positions minus the modelled ones, row after row."""
        return np.asarray(self.columns(tuple(values[3:])) @ np.append(1.0, -values[:3]))

    def slopes(self, scaled: Floats, scale: Floats) -> Floats:
        """Returns the derivatives (R, parameters) of what is left by the scaled parameters. It is linear in the first
        three."""
        weights = np.append(1.0, -scaled[:3] * scale[:3])

        def left(shape: Floats) -> Floats:
            return np.asarray(self.columns(tuple(shape * scale[3:])) @ weights)

        linear = -scale[:3] * self.columns(tuple(scaled[3:] * scale[3:]))[:, 1:]
        return np.column_stack([linear, _slopes(left, scaled[3:])])


def _slopes(of: Callable[[Floats], Floats], at: Floats) -> Floats:
    """Returns the derivatives (rows, parameters), by central differences."""
    return np.column_stack([(of(at + step) - of(at - step)) / (2.0 * _STEP) for step in _STEP * np.eye(at.size)])


def _rms(table: _Table, residual: Floats, parameters: int) -> float:
    states = 2 if parameters == len(_LEAST) else 4  # initial states of each swing
    freedom = np.count_nonzero(table.inside) - states * residual.shape[0] - parameters
    return math.sqrt(float(np.sum(residual**2)) / max(freedom, 1))


def _spread(table: _Table, residual: Floats, slopes: Floats) -> Floats:
    """Returns a square root of the scaled parameters' covariance, so that no variance can become negative."""
    (rows, parameters), swings = slopes.shape, residual.shape[0]
    q, size, axes = np.linalg.svd(slopes, full_matrices=False)
    inverse = axes.T / np.maximum(size, _SINGULAR * size[0])
    spread = np.asarray(inverse * max(_rms(table, residual, parameters), ROUNDING))
    if _correlation(table, residual) * math.sqrt(rows) > _WHITE and swings > _FEW_SWINGS:
        by_swing = np.zeros((swings, parameters))
        np.add.at(by_swing, np.nonzero(table.inside)[0], q * residual[table.inside][:, None])
        scatter = inverse @ by_swing.T * math.sqrt(swings / (swings - parameters))
        spread *= np.maximum(norm(scatter, axis=1) / norm(spread, axis=1), 1.0)[:, None]
    return spread


def _correlation(table: _Table, residual: Floats) -> float:
    """Returns the correlation from row to row, corrected for the projected motions of each swing: 0 for white noise."""
    neighbours = float(np.sum(residual[:, 1:] * residual[:, :-1]))  # it is 0 beyond the end of a swing
    power = float(np.sum(residual**2))
    taken = 2.0 * residual.shape[0] / np.count_nonzero(table.inside)  # each motion removes a slow share
    return neighbours / power + taken if power > 0.0 else 0.0


def _in_si(values: Floats, count_m: float, period: float) -> Floats:
    """Returns mass, dry friction, constant force, delay (samples), friction and stiffness, then a hand's values; SI."""
    gain, coulomb, constant, delay, friction, stiffness, *hand = values
    mass = period**2 / (count_m * gain)
    device = [mass, coulomb / gain, constant / gain, delay, friction * mass / period, stiffness * mass / period**2]
    of_hand = [mass / hand[2], hand[0] * mass / period**2, hand[1] * mass / period] if hand else []
    return np.array(device + of_hand)
