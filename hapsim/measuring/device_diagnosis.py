"""Diagnosis of a device: why its model does not fit, or why it cannot be identified, each cause in a sentence.

A smoothed balance of forces shows the misfit over position, velocity, or near the reversals. The equation of motion is
multiplied by a window psi and integrated by parts. psi and its first two derivatives vanish at both ends, so the
equation holds for positions instead of accelerations (Shinbrot's modulating functions, 1957):

    m <psi'', x> - b0 <psi', x> + k0 <psi, x> + Fc side <psi, 1> - F0 <psi, 1> = <psi, F>
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from hapsim.errors import DeviceError, GuardError, RunError, UsageError
from hapsim.measuring.converters import Converters, Floats
from hapsim.measuring.device_fit import DeviceFit
from hapsim.measuring.device_motion import Bounds, Motion
from hapsim.measuring.trace_quality import ROUNDING
from hapsim.number_format import share_in_percent
from hapsim.units import Units

WRONG_SIGN = (
    "motor and position disagree in sign: a force to one side moves the device to the other. Swap the motor's two "
    "wires, or reverse the encoder if the position falls when the hand moves the positive way"
)

BINS = 12
LOUD = 2.0  # times the noise at rest and the rounding
_WINDOW = Polynomial([1.0, 0.0, -1.0]) ** 3  # (1 - s²)³ for s from -1 to 1
_LEAST_WIDTH, _LEAST_WINDOWS = 8, 20
_LEAST_SHARE = 0.3  # of the missing force's variance: with less it depends on nothing in particular
_QUIET = 0.25  # of the force: noise that hides nothing
_LAW = 8  # positions and forces of a linear law of four masses
_AGES = range(1, _LAW + 1)
_LINEAR = 1.5  # times the noise: two masses without play leave up to 1.2
_DELAY_STEP = 0.1  # sample periods: a difference of the delay
_SLOW = 1e-4  # periods per sample: so slow that hold, delay and sampling act as a delay alone


@dataclass(frozen=True)
class ForceResidual:
    """The force that the model lacks, in windows of at most a third of a swing. Arrays (R,), SI units."""

    motion: NDArray[np.int64]  # index of the run in the record
    row: NDArray[np.int64]  # row of that run at the middle of the window
    position: Floats  # m from the home position
    velocity: Floats
    in_swing: Floats  # fraction of the swing that has passed, from 0 at one reversal to 1 at the next
    force: Floats  # N, the part that no parameters of the model explain
    modelled: Floats  # (R, 6) forces per unit of each parameter, the last of the delay
    noise: float  # N rms, the part of it that noise and rounding of the positions cause
    typical_force: float  # N rms, as sent


def force_residual(
    motions: list[Motion], fit: DeviceFit, noise_counts: float, count_m: float, rate_hz: float, converters: Converters
) -> ForceResidual:
    """Returns the force that a fit lacks, in windows as short as the noise allows. `noise_counts`: noise of the
    position at rest, rms; `count_m`: m per count."""
    rows = [swing.rows for swing in fit.swings]
    width = max(_LEAST_WIDTH, min(int(np.median(rows)) // 3, sum(rows) // _LEAST_WINDOWS))
    noise = math.hypot(noise_counts, ROUNDING) * count_m
    slow = converters.response(np.array([_SLOW]), 1.0, fit.delay.value)
    late = float(-np.angle(slow[0]) / (2.0 * np.pi * _SLOW))
    found = _in_windows(motions, fit, noise, count_m, rate_hz, late, width)
    while width >= 2 * _LEAST_WIDTH:
        width //= 2
        finer = _in_windows(motions, fit, noise, count_m, rate_hz, late, width)
        if not finer.noise < _QUIET * _rms(finer.force):
            break
        found = finer
    return found


def _in_windows(
    motions: list[Motion], fit: DeviceFit, noise: float, count_m: float, rate_hz: float, late: float, width: int
) -> ForceResidual:
    """Returns the missing force in half-overlapping windows of `width` rows within the swings. `noise`: of a position,
    m rms; `late`: rows from a force to the middle of its effect."""
    windows = [
        (swing.motion, begin, swing.side, (begin + width // 2 - swing.first) / swing.rows)
        for swing in fit.swings
        for begin in range(swing.first, swing.last - width + 1, max(1, width // 2))
    ]
    motion, begin, side, in_swing = np.array(windows).reshape(-1, 4).T
    at = list(zip(motion.astype(int), begin.astype(int), strict=True))

    def weighted(signals: list[Floats], kernels: Floats, before: int = 0) -> Floats:
        """Returns the weighted sums (R, kernels) of each window, from `before` rows before it."""
        length = kernels.shape[1]
        padded = [np.pad(signal, (before, 0)) for signal in signals]
        return np.array([kernels @ padded[i][j : j + length] for i, j in at]).reshape(-1, kernels.shape[0])

    def force(late: float) -> Floats:
        """Returns the mean force (R,) in each window, N; it is zero before the record."""
        before = math.ceil(late) + 1
        rows = np.arange(width + before) - before + late - 0.5 * (width - 1)
        weights = _WINDOW(np.clip(2.0 * rows / width, -1.0, 1.0))
        return weighted([one.force for one in motions], weights[None, :] / np.sum(weights), before)[:, 0]

    kernels = _kernels(width)
    moved = count_m * weighted([one.position for one in motions], kernels)
    # The residual is the motion of the device under the missing force alone.
    left = [np.zeros_like(one.position) for one in motions]
    for swing, error in zip(fit.swings, fit.residuals, strict=True):
        left[swing.motion][swing.first : swing.last] = error
    inertia = fit.mass.value * rate_hz**2
    lacking = weighted(left, kernels) @ [inertia, fit.friction.value * rate_hz, fit.stiffness.value] * count_m
    sent = force(late)
    modelled = np.column_stack([moved, side, -np.ones_like(side), force(late + _DELAY_STEP) - sent])
    return ForceResidual(
        motion=motion.astype(np.int64),
        row=begin.astype(np.int64) + width // 2,
        position=moved[:, 2],
        velocity=moved[:, 1] * rate_hz,
        in_swing=in_swing,
        force=_unexplained(modelled, lacking),
        modelled=modelled,
        noise=float(np.linalg.norm(kernels[0])) * noise * inertia,
        typical_force=_rms(sent),
    )


def _kernels(width: int) -> Floats:
    """Returns the kernels (3, width) for the acceleration, velocity (per sample period) and mean of positions."""
    half = 0.5 * width
    at = (np.arange(width) - 0.5 * (width - 1)) / half
    window, first, second = (p(at) for p in (_WINDOW, _WINDOW.deriv(), _WINDOW.deriv(2)))
    # The sums of the derivatives vanish exactly, so that the origin of the positions does not matter.
    first, second = first - np.mean(first), second - np.mean(second)
    second *= 2.0 / float(second @ (at * half) ** 2)
    first /= float(first @ (at * half))
    return np.stack([second, first, window / np.sum(window)])


def _unexplained(explaining: Floats, force: Floats) -> Floats:
    """Returns the part of `force` that no combination of the columns explains."""
    size = np.linalg.norm(explaining, axis=0)
    q, _ = np.linalg.qr(explaining[:, size > 0.0] / size[size > 0.0])
    return np.asarray(force - q @ (q.T @ force))


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.mean(values**2)))


def misfit_of(fit: DeviceFit, lacking: ForceResidual, motions: list[Motion], noise_counts: float, units: Units) -> str:
    """Returns sentences about the misfit of the model; "" if only noise and rounding remain. `noise_counts`: noise of
    the position at rest, rms."""
    expected = math.hypot(noise_counts, ROUNDING)
    if fit.is_white and fit.residual_counts < LOUD * expected:
        return ""
    law = "No linear law explains it: motor and handle have play, or a hand or another force moves the device"
    if error_of_law(motions, expected) < _LINEAR:
        law = "A linear law explains it: a belt between motor and handle, a hand, or another slow force"
    return (
        f"the model does not fit: its residual is {fit.residual_counts:.3g} counts rms, but rounding and noise explain "
        f"only {expected:.2g}. The missing force ({units(_rms(lacking.force), 'N', '.2g')} rms; the pushes have "
        f"{units(lacking.typical_force, 'N', '.2g')} rms) {_misfit_pattern(lacking, units)}. {law}. "
        "`hapsim identify --transmission` finds a belt and play."
    )


def error_of_law(motions: list[Motion], noise: float) -> float:
    """Returns the errors of the linear law that predicts the next position best, from those before it, the forces and
    the side of a dry friction, relative to those that `noise` of a position, counts rms, makes in it. Near 1 for masses
    on springs."""
    columns, found = list[Floats](), list[Floats]()
    for one, (first, last) in ((motion, rows) for motion in motions for rows in motion.known):
        moved, side = one.position[first:last], np.sign(np.gradient(one.position[first:last]))
        late = [signal[_LAW - age : moved.size - age] for signal in (moved, one.force[first:last]) for age in _AGES]
        columns.append(np.stack([*late, side[_LAW - 1 : -1], np.ones(moved.size - _LAW)], axis=1))
        found.append(moved[_LAW:])
    table = np.concatenate(columns)
    size = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    law = np.linalg.lstsq(table / size, np.concatenate(found), rcond=None)[0] / size
    noisy = noise * math.sqrt(1.0 + float(np.sum(law[:_LAW] ** 2)))
    return _rms(np.concatenate(found) - table @ law) / noisy


def _misfit_pattern(lacking: ForceResidual, units: Units) -> str:
    at_position, position = _explained_share(lacking, lacking.position, 1.0)
    at_velocity, velocity = _explained_share(lacking, lacking.velocity, 1.0)
    # A force that the model lacks changes its sign where the motion reverses.
    in_swing, moment = _explained_share(lacking, lacking.in_swing, np.sign(lacking.velocity))
    best = max(at_position, at_velocity, in_swing)
    if not best > _LEAST_SHARE:
        return "depends on neither position, velocity nor reversals"
    part = share_in_percent(best)
    if best == at_position:
        return f"depends on the position ({part} of its variance) and is largest at {units(position, 'mm', '+.2g')}"
    if best == at_velocity:
        return f"depends on the velocity ({part} of its variance), largest at {units(velocity, 'mm/s', '+.2g')}"
    where = "near the reversals" if abs(moment - 0.5) > 0.25 else "in the middle between two reversals"
    return f"is largest {where} ({part} of its variance)"


def binned(along: Floats, force: Floats) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Returns the bin of each value, and the means of `along` and `force` in each. Bins have equally many values."""
    edges = np.quantile(along, np.linspace(0.0, 1.0, BINS + 1))
    number = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, BINS - 1)
    counts = np.maximum(np.bincount(number, minlength=BINS), 1)
    middles, means = (np.bincount(number, one, minlength=BINS) / counts for one in (along, force))
    return number, middles, means


def _explained_share(lacking: ForceResidual, along: Floats, sign: float | Floats) -> tuple[float, float]:
    """Returns the share of the missing force's variance that bins of `along` explain, and the bin where it is largest.
    The share excludes noise, chance, and the part that other parameters of the model would explain."""
    force, rows = lacking.force, lacking.force.size
    if rows < 4 * BINS:
        return 0.0, 0.0
    number, middles, means = binned(along, force * sign)
    bins = np.eye(BINS)[number] * np.reshape(sign, (-1, 1))
    columns = np.column_stack([lacking.modelled, bins])
    left = float(np.sum(_unexplained(columns, force) ** 2)) / (rows - columns.shape[1])
    total = float(np.sum(force**2)) / (rows - lacking.modelled.shape[1])
    beyond = total - lacking.noise**2
    worst = float(middles[np.argmax(np.abs(means))])
    return (min((total - left) / beyond, 1.0) if beyond > 0.0 else 0.0), worst


UNSURE = 0.3  # relative uncertainty of the mass that is too large to report it
_UNEXPLAINED, _UNEXPLAINED_WRONG_WAY = 0.5, 0.001  # of the motion, rms: a larger share has another cause than the force
_ENOUGH_TRAVEL = 0.25  # of the travel
_CLEAR_MOTION = 300.0  # times noise and rounding: a motion that they do not hide
_MORE_TRAVEL = (1.5, 10.0)  # times the travel: the range of a suggested one


class PushedRun(NamedTuple):
    """The push of a run, and the motion of the device under it."""

    force: float  # N
    peak_m: float  # from the home position
    bounds: Bounds
    noise_m: float  # rms, at rest
    count_m: float
    units: Units

    @property
    def floor(self) -> float:
        """Noise and rounding of the position, m rms."""
        return math.hypot(self.noise_m, ROUNDING * self.count_m)

    def is_loud(self, fit: DeviceFit) -> bool:
        """Returns True if the residual of the fit exceeds noise and rounding."""
        return fit.residual_counts * self.count_m > LOUD * self.floor


def fit_error(fit: DeviceFit | None, pushed: PushedRun) -> UsageError | RunError | None:
    """Returns the error that rules this fit out, or None."""
    if fit is not None and (error := polarity_error(fit, pushed) or _other_force_error(fit, pushed)):
        return error
    unsure = math.inf if fit is None else abs(fit.mass.uncertainty / fit.mass.value)
    if unsure < UNSURE:
        return None
    force, moved, allowed, units = pushed.force, pushed.peak_m, pushed.bounds.travel, pushed.units
    if moved < _ENOUGH_TRAVEL * allowed:
        return UsageError(
            f"a push of {units(force, 'N', '.3g')} moved the device by {units(moved, 'µm', '.3g')}, too little to "
            "identify anything: it is held, stuck by dry friction, much heavier than declared, or its motor does not "
            "push. Let it move freely, or allow more force with --push"
        )
    if unsure > 1.0 and moved > _CLEAR_MOTION * pushed.floor:
        return UsageError(
            f"a push of {units(force, 'N', '.3g')} moved the device by {units(moved, 'mm', '.3g')}, but in jerks or "
            "only sometimes: dry friction holds it, it swings too fast on a spring of its own, or the record is too "
            "short. Allow more with --push and --travel"
        )
    least, most = (factor * allowed for factor in _MORE_TRAVEL)
    travel = min(max(2.0 * unsure / UNSURE * allowed, least), most)
    what, size = ("noise", pushed.noise_m) if pushed.noise_m > pushed.count_m else ("counts", pushed.count_m)
    return UsageError(
        f"nothing was identified: the motion within {units(allowed, 'mm', 'g')} to either side is lost in the "
        f"position's {what} of {units(size, 'µm', '.3g')}. Allow more travel: try --travel {travel:.2g} "
        f"({units.si.name('m')})"
    )


def travel_error(fit: DeviceFit | None, pushed: PushedRun) -> RunError:
    """Returns the error of a device that moved farther than it may."""
    found, units = fit_error(fit, pushed), pushed.units
    if isinstance(found, RunError):
        return found
    return GuardError(
        f"a push of {units(pushed.force, 'N', '.3g')} moved the device by {units(pushed.peak_m, 'mm', '.3g')} from its "
        f"start, beyond the allowed {units(pushed.bounds.travel, 'mm', 'g')}: the measurement ended. The device may "
        "have broken away from dry friction, be much lighter than declared, oscillate on its own spring, or be moved "
        "by a hand or another force. --travel allows more"
    )


def polarity_error(fit: DeviceFit | None, pushed: PushedRun) -> GuardError | None:
    """Returns the error of a device that the force moves the wrong way, or None."""
    if fit is None or not fit.mass.value + fit.mass.uncertainty / UNSURE < 0.0:
        return None
    if pushed.is_loud(fit) and fit.unexplained > _UNEXPLAINED_WRONG_WAY:
        return None
    return GuardError(WRONG_SIGN)


def _other_force_error(fit: DeviceFit, pushed: PushedRun) -> DeviceError | None:
    if not pushed.is_loud(fit) or not (fit.unexplained > _UNEXPLAINED or fit.mass.value < 0.0):
        return None
    share = max(1.0 - fit.unexplained**2, 0.0)
    return DeviceError(
        f"the device does not follow the pushes: they explain {share_in_percent(share)} of its motion. A hand or "
        "another force moves it, or two channels are swapped, so that the pushed one is not the measured one. Let it "
        "move freely, and try again"
    )
