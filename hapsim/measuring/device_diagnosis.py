"""Where the model of a device does not fit, and why a device cannot be identified: each cause in a sentence.

Where it does not fit, with the position, the velocity or at the reversals, a smoothed balance of forces shows.
Multiplied by a window psi that vanishes at both ends, with its first two derivatives, and integrated by parts, the
equation of motion holds for positions instead of accelerations (Shinbrot's modulating functions, 1957):

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
from hapsim.units import Units

BINS = 12
LOUD = 2.0  # times the noise at rest and the rounding
_WINDOW = Polynomial([1.0, 0.0, -1.0]) ** 3  # (1 - s²)³ for s from -1 to 1
_LEAST_WIDTH, _LEAST_WINDOWS = 8, 20
_LEAST_SHARE = 0.3  # of the variance of the force that is lacking: with less it goes with nothing in particular
_QUIET = 0.25  # of the force: noise that hides nothing
_LATER = 0.1  # sample periods: a difference of the delay
_SLOW = 1e-4  # periods per sample: a motion that shows hold, delay and sampling as a delay alone


@dataclass(frozen=True)
class ForceResidual:
    """What force the model lacks, and where, in windows of a third of a swing. Arrays (R,), SI units."""

    motion: NDArray[np.int64]  # which run of the record
    row: NDArray[np.int64]  # of that run, at the middle of the window
    position: Floats  # m from where the device was found
    velocity: Floats
    in_swing: Floats  # share of its swing that has passed, 0 at one reversal to 1 at the next
    force: Floats  # N that acted beside the modelled ones, whatever the model's parameters
    modelled: Floats  # (R, 6) forces that the parameters are factors of, the last by the delay
    noise: float  # N rms that noise and rounding of the positions make of it
    typical_force: float  # N rms that was sent


def force_residual(
    motions: list[Motion], fit: DeviceFit, noise_counts: float, count_m: float, rate_hz: float, converters: Converters
) -> ForceResidual:
    """Of the swings of a fit, in windows as short as noise allows, a third of a swing at most. `noise_counts`: of a
    position of the device at rest, rms; `count_m`: m per count."""
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
    """In windows of `width` rows, half overlapping, inside of the swings. `noise`: m rms of a position; `late`: rows
    from a force to the middle of what it does."""
    windows = [
        (swing.motion, begin, swing.side, (begin + width // 2 - swing.first) / swing.rows)
        for swing in fit.swings
        for begin in range(swing.first, swing.last - width + 1, max(1, width // 2))
    ]
    motion, begin, side, in_swing = np.array(windows).reshape(-1, 4).T
    at = list(zip(motion.astype(int), begin.astype(int), strict=True))

    def weighted(signals: list[Floats], kernels: Floats, before: int = 0) -> Floats:
        """(R, kernels): each window's weighted sums, from `before` rows before it on."""
        length = kernels.shape[1]
        padded = [np.pad(signal, (before, 0)) for signal in signals]
        return np.array([kernels @ padded[i][j : j + length] for i, j in at]).reshape(-1, kernels.shape[0])

    def force(late: float) -> Floats:
        """(R,) N: the mean force in each window; before a record none acted."""
        before = math.ceil(late) + 1
        rows = np.arange(width + before) - before + late - 0.5 * (width - 1)
        weights = _WINDOW(np.clip(2.0 * rows / width, -1.0, 1.0))
        return weighted([one.force for one in motions], weights[None, :] / np.sum(weights), before)[:, 0]

    kernels = _kernels(width)
    moved = count_m * weighted([one.position for one in motions], kernels)
    # The residual moves like the device under the lacking force, and under no other.
    left = [np.zeros_like(one.position) for one in motions]
    for swing, error in zip(fit.swings, fit.residuals, strict=True):
        left[swing.motion][swing.first : swing.last] = error
    inertia = fit.mass.value * rate_hz**2
    lacking = weighted(left, kernels) @ [inertia, fit.friction.value * rate_hz, fit.stiffness.value] * count_m
    sent = force(late)
    modelled = np.column_stack([moved, side, -np.ones_like(side), force(late + _LATER) - sent])
    return ForceResidual(
        motion=motion.astype(np.int64),
        row=begin.astype(np.int64) + width // 2,
        position=moved[:, 2],
        velocity=moved[:, 1] * rate_hz,
        in_swing=in_swing,
        force=_beside(modelled, lacking),
        modelled=modelled,
        noise=float(np.linalg.norm(kernels[0])) * noise * inertia,
        typical_force=_rms(sent),
    )


def _kernels(width: int) -> Floats:
    """(3, width): by what `width` positions become their acceleration, velocity (in sample periods) and mean."""
    half = 0.5 * width
    at = (np.arange(width) - 0.5 * (width - 1)) / half
    window, first, second = (p(at) for p in (_WINDOW, _WINDOW.deriv(), _WINDOW.deriv(2)))
    # The sums of the derivatives vanish exactly, so that a position may be counted from anywhere.
    first, second = first - np.mean(first), second - np.mean(second)
    second *= 2.0 / float(second @ (at * half) ** 2)
    first /= float(first @ (at * half))
    return np.stack([second, first, window / np.sum(window)])


def _beside(explaining: Floats, force: Floats) -> Floats:
    """What no combination of the columns explains."""
    size = np.linalg.norm(explaining, axis=0)
    q, _ = np.linalg.qr(explaining[:, size > 0.0] / size[size > 0.0])
    return np.asarray(force - q @ (q.T @ force))


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.mean(values**2)))


def misfit_of(fit: DeviceFit, lacking: ForceResidual, noise_counts: float, units: Units) -> str:
    """In a sentence, where the model does not fit; "" where only noise and rounding remain. `noise_counts`: of a
    position of the device at rest, rms."""
    expected = math.hypot(noise_counts, ROUNDING)
    if fit.is_white and fit.residual_counts < LOUD * expected:
        return ""
    return (
        f"the model does not fit: it leaves {fit.residual_counts:.3g} counts rms of the positions, where rounding and "
        f"noise explain {expected:.2g}. The force that it lacks, {units(_rms(lacking.force), 'N', '.2g')} rms beside "
        f"pushes of {units(lacking.typical_force, 'N', '.2g')} rms, {_where(lacking, units)}."
    )


def _where(lacking: ForceResidual, units: Units) -> str:
    at_position, position = _explained(lacking, lacking.position, 1.0)
    at_velocity, velocity = _explained(lacking, lacking.velocity, 1.0)
    # A force that the model lacks changes its sign where the motion reverses.
    in_swing, moment = _explained(lacking, lacking.in_swing, np.sign(lacking.velocity))
    best = max(at_position, at_velocity, in_swing)
    if not best > _LEAST_SHARE:
        return "goes with neither position nor velocity nor reversals: a hand that moves by itself, or another force"
    if best == at_position:
        return f"goes with the position ({best:.0%} of it), and is largest at {units(position, 'mm', '+.2g')}"
    if best == at_velocity:
        return f"goes with the velocity ({best:.0%} of it), and is largest at {units(velocity, 'mm/s', '+.2g')}"
    where = "near the reversals" if abs(moment - 0.5) > 0.25 else "in the middle between two reversals"
    return f"is largest {where} ({best:.0%} of it)"


def binned(along: Floats, force: Floats) -> tuple[NDArray[np.int64], Floats, Floats]:
    """(the bin of each, the mean of `along` and of `force` in each): bins of equally many values."""
    edges = np.quantile(along, np.linspace(0.0, 1.0, BINS + 1))
    number = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, BINS - 1)
    counts = np.maximum(np.bincount(number, minlength=BINS), 1)
    middles, means = (np.bincount(number, one, minlength=BINS) / counts for one in (along, force))
    return number, middles, means


def _explained(lacking: ForceResidual, along: Floats, sign: float | Floats) -> tuple[float, float]:
    """(share of the force's variance, beyond that of noise, that a force by bins of `along` explains, beyond chance and
    beyond what other parameters of the model would; where it is largest)."""
    force, rows = lacking.force, lacking.force.size
    if rows < 4 * BINS:
        return 0.0, 0.0
    number, middles, means = binned(along, force * sign)
    bins = np.eye(BINS)[number] * np.reshape(sign, (-1, 1))
    columns = np.column_stack([lacking.modelled, bins])
    left = float(np.sum(_beside(columns, force) ** 2)) / (rows - columns.shape[1])
    total = float(np.sum(force**2)) / (rows - lacking.modelled.shape[1])
    beyond = total - lacking.noise**2
    worst = float(middles[np.argmax(np.abs(means))])
    return (min((total - left) / beyond, 1.0) if beyond > 0.0 else 0.0), worst


_UNSURE = 0.3  # of the mass: its uncertainty, beyond which nothing is said of it
_UNEXPLAINED, _UNEXPLAINED_INVERTED = 0.5, 0.001  # of the motion, rms: more is not of the force
_ENOUGH = 0.25  # of the travel
_MANY = 300.0  # times noise and rounding: a motion that they do not hide
_MORE_TRAVEL = (1.5, 10.0)  # times the travel, where more of it would do


class Pushed(NamedTuple):
    """How a run pushed the device, and how far it moved."""

    force: float  # N
    peak_m: float  # from where it was found
    bounds: Bounds
    noise_m: float  # rms, at rest
    count_m: float
    units: Units

    @property
    def floor(self) -> float:
        """m rms, of noise and rounding."""
        return math.hypot(self.noise_m, ROUNDING * self.count_m)

    def is_loud(self, fit: DeviceFit) -> bool:
        """Whether the fit leaves more than noise and rounding."""
        return fit.residual_counts * self.count_m > LOUD * self.floor


def why_not(fit: DeviceFit | None, pushed: Pushed) -> UsageError | RunError | None:
    """Why this fit is none to go on from; None where it is one."""
    if fit is not None and (error := inverted(fit, pushed) or _moved_by_another(fit, pushed)):
        return error
    unsure = math.inf if fit is None else abs(fit.mass.uncertainty / fit.mass.value)
    if unsure < _UNSURE:
        return None
    force, moved, allowed, units = pushed.force, pushed.peak_m, pushed.bounds.travel, pushed.units
    if moved < _ENOUGH * allowed:
        return UsageError(
            f"pushed with {units(force, 'N', '.3g')} the device moved by {units(moved, 'µm', '.3g')}, which is too "
            "little to identify "
            "anything: it is held, stuck by dry friction, much heavier than declared, or its motor does not push. Let "
            "it move freely, or allow more with --push"
        )
    if unsure > 1.0 and moved > _MANY * pushed.floor:
        return UsageError(
            f"pushed with {units(force, 'N', '.3g')} the device moved by {units(moved, 'mm', '.3g')}, but in jerks, or "
            "only now and then: dry friction holds it, or the record is too short. Allow more with --push and --travel"
        )
    least, most = (factor * allowed for factor in _MORE_TRAVEL)
    travel = min(max(2.0 * unsure / _UNSURE * allowed, least), most)
    what, size = ("noise", pushed.noise_m) if pushed.noise_m > pushed.count_m else ("counts", pushed.count_m)
    return UsageError(
        f"the position's {what} of {units(size, 'µm', '.3g')} hide how the device answers within "
        f"{units(allowed, 'mm', 'g')} to "
        f"either side: nothing was identified. Allow more with --travel, {travel:.2g} ({units.si.name('m')}) for a "
        "start"
    )


def why_too_far(fit: DeviceFit | None, pushed: Pushed) -> RunError:
    """Why a device moved farther than it may."""
    found, units = why_not(fit, pushed), pushed.units
    if isinstance(found, RunError):
        return found
    return GuardError(
        f"the device moved {units(pushed.peak_m, 'mm', '.3g')} from where it was found, farther than the "
        f"{units(pushed.bounds.travel, 'mm', 'g')} that it may, pushed with {units(pushed.force, 'N', '.3g')}: nothing "
        "more was tried. "
        "It may have broken away from dry friction, it may be much lighter than declared, it may ring on a spring of "
        "its own, or a hand or another force moved it; --travel allows more"
    )


def inverted(fit: DeviceFit | None, pushed: Pushed) -> GuardError | None:
    """The error where the force, and nothing else, moves the device the other way; None where it does not."""
    if fit is None or not fit.mass.value + fit.mass.uncertainty / _UNSURE < 0.0:
        return None
    if pushed.is_loud(fit) and fit.unexplained > _UNEXPLAINED_INVERTED:
        return None
    return GuardError(
        "motor and position disagree in sign: a force to one side moves the device to the other. Swap the motor's two "
        "wires, or reverse the encoder if the position falls when the hand moves the positive way"
    )


def _moved_by_another(fit: DeviceFit, pushed: Pushed) -> DeviceError | None:
    if not pushed.is_loud(fit) or not (fit.unexplained > _UNEXPLAINED or fit.mass.value < 0.0):
        return None
    share = max(1.0 - fit.unexplained**2, 0.0)
    return DeviceError(
        f"the device does not move the way it is pushed: the forces explain {share:.0%} of its motion. A hand or "
        "another force moves it, or what is pushed is not what is measured (two channels swapped). Let it move freely, "
        "and try again"
    )
