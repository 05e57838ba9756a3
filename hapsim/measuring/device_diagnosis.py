"""Why a device cannot be identified: each cause in a sentence, with what to do."""

from __future__ import annotations

import math
from typing import NamedTuple

from hapsim.errors import DeviceError, GuardError, RunError, UsageError
from hapsim.measuring.device_excitation import Bounds
from hapsim.measuring.device_fit import DeviceFit
from hapsim.measuring.device_misfit import LOUD
from hapsim.measuring.trace_quality import ROUNDING

_UNSURE = 0.3  # of the mass: its uncertainty, beyond which nothing is said of it
_UNEXPLAINED, _UNEXPLAINED_INVERTED = 0.5, 0.001  # of the motion, rms: more is not of the force
_ENOUGH = 0.25  # of the travel
_MANY = 300.0  # times noise and rounding: a motion that they do not hide
_MORE_TRAVEL = (1.5, 10.0)  # times the travel, where more of it would do


class Pushed(NamedTuple):
    """How a run pushed the device, and how far it moved."""

    force: float
    """N."""
    peak_m: float
    """From where it was found."""
    bounds: Bounds
    noise_m: float
    """rms, at rest."""
    count_m: float

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
    force, moved, allowed = pushed.force, pushed.peak_m, pushed.bounds.travel
    if moved < _ENOUGH * allowed:
        return UsageError(
            f"pushed with {force:.3g} N the device moved by {1e6 * moved:.3g} µm, which is too little to identify "
            "anything: it is held, stuck by dry friction, much heavier than declared, or its motor does not push. Let "
            "it move freely, or allow more with --push"
        )
    if unsure > 1.0 and moved > _MANY * pushed.floor:
        return UsageError(
            f"pushed with {force:.3g} N the device moved by {1e3 * moved:.3g} mm, but in jerks, or only now and then: "
            "dry friction holds it, or the record is too short. Allow more with --push and --travel"
        )
    least, most = (factor * allowed for factor in _MORE_TRAVEL)
    travel = min(max(2.0 * unsure / _UNSURE * allowed, least), most)
    what, size = ("noise", pushed.noise_m) if pushed.noise_m > pushed.count_m else ("counts", pushed.count_m)
    return UsageError(
        f"the position's {what} of {1e6 * size:.3g} µm hide how the device answers within {1e3 * allowed:g} mm to "
        f"either side: nothing was identified. Allow more with --travel, {travel:.2g} (m) for a start"
    )


def why_too_far(fit: DeviceFit | None, pushed: Pushed) -> RunError:
    """Why a device moved farther than it may."""
    found = why_not(fit, pushed)
    if isinstance(found, RunError):
        return found
    return GuardError(
        f"the device moved {1e3 * pushed.peak_m:.3g} mm from where it was found, farther than the "
        f"{1e3 * pushed.bounds.travel:g} mm that it may, pushed with {pushed.force:.3g} N: nothing more was tried. "
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
