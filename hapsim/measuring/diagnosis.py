"""Differences between a device and its declaration in the scene, from measured and predicted k and b.

A diagnosis comes after the measurement and does not change it.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from scipy.optimize import brentq

from hapsim.measuring.measure_trace import Measurement
from hapsim.measuring.scene_law import asks_by_one_law
from hapsim.scene.choices import AHEAD

if TYPE_CHECKING:
    from hapsim.prediction import Felt, Prediction

_UNSURE = 4.0  # uncertainties: values further apart differ
_MANY = 5.0
_SAME = 1e-4  # a clearly wrong mass changes the frequency by 50 times as much
_CLEARLY = 0.01  # of mass, prediction, half the critical damping of b: smaller deviations are not reported
_FAR = 0.05  # of k: a smaller deviation is no sign of a link that changed
_FEW = 0.01  # of the ticks: with more deadline misses, the record does not show the forces that acted
_LATER = 8  # sample periods: the most by which a delay is found to be longer than declared
_LASTS = 0.5  # modulus of a pole, below that of every `SecondMode`


class ProbableMass(NamedTuple):
    """The mass for which the prediction has the measured eigenfrequency and damping ratio."""

    mass: float
    """Mass, kg."""
    uncertainty: float
    """Standard uncertainty, kg."""
    factor: float
    """Ratio to the mass of the measurement."""


class Mode(NamedTuple):
    """A second mode of the motion."""

    frequency_hz: float
    damping_ratio: float
    share: float
    """Share of the motion's energy."""
    predicted: bool
    """True if the scene has this mode; else it belongs to the hand or to a part of the device."""


class Diagnosis(NamedTuple):
    """The differences between measurement and prediction, and their likely causes."""

    probable_mass: ProbableMass | None
    """Likely mass; None if the declared one fits, if no other fits better, or if more than the hand moves."""
    second_mode: Mode | None
    is_another_device: bool
    """True if k or b is off by much more than its uncertainty, and neither another mass nor a link explains it."""
    link_changed: bool = False
    """True if a link that touches, releases or slides may explain the measured k."""
    probable_delay: float | None = None
    """Likely delay in sample periods; None if the declared one fits, or if another cause is possible."""
    machine_held_up: bool = False
    """True if positions arrived at another rate, but k and b show that the device kept the declared one."""

    @property
    def gives(self) -> bool:
        """True if the motion has a mode that the scene lacks."""
        return self.second_mode is not None and not self.second_mode.predicted

    @property
    def differs(self) -> bool:
        """True if the device differs from the scene's declaration."""
        return bool(self.probable_mass or self.probable_delay) or self.gives or self.is_another_device


def diagnose(prediction: Prediction, measurement: Measurement, channel: int = 0) -> Diagnosis:
    """Returns the differences between device and scene that the measurement on `channel` shows."""
    felt = next((one for one in prediction.felt if one.channel == channel), None)
    second, extra, mode = measurement.second_mode, has_unmodelled_mode(prediction, measurement), None
    if second is not None:
        s = cmath.log(second.pole) * measurement.trace.rate
        mode = Mode(abs(s) / (2.0 * math.pi), -s.real / abs(s), second.share, not extra)
    disturbed = extra or bool(measurement.left_region)
    mass = None if disturbed else probable_mass(felt, measurement)
    changed = not disturbed and _link_changed(prediction, measurement, channel)
    if felt is None or disturbed or changed or mass or math.isnan(measurement.dry_friction_n):
        return Diagnosis(mass, mode, is_another_device=False, link_changed=changed)
    off, off_at_seen, seen = _is_off(felt, measurement), False, measurement.seen_rate
    differs = seen is not None and seen.differs_from(measurement.trace.rate)
    if seen is not None and differs:
        off_at_seen = _is_off(felt.at_rate(seen.rate_hz), measurement.at_rate(seen.rate_hz))
    delay = probable_delay(felt, measurement) if off else None
    is_other = off and delay is None and (off_at_seen or not differs) and _is_in_time(measurement)
    return Diagnosis(mass, mode, is_other, changed, delay, off_at_seen and not off)


def _link_changed(prediction: Prediction, measurement: Measurement, channel: int) -> bool:
    """Returns True if k is missing or far from that of the assumed states, and the force followed no single law."""
    part = prediction.part_on(channel)
    own = part.own_motion if part else None
    predicts = prediction.scene.device.correction in AHEAD  # positions that the record lacks
    if own is None or predicts or not prediction.assumptions:
        return False
    is_near = abs(measurement.k - own.k) <= max(_UNSURE * measurement.k_uncertainty, _FAR * abs(own.k))
    return not is_near and not asks_by_one_law(measurement.trace, channel)


def probable_mass(felt: Felt | None, measurement: Measurement) -> ProbableMass | None:
    """Returns the mass that the measurement suggests; None if the declared one fits, or no other fits better.

    The eigenfrequency gives the mass. The damping ratio shows whether a wrong mass is the cause.
    """
    if (
        felt is None
        or math.isnan(measurement.dry_friction_n)
        or not _is_undisturbed(measurement)
        or not measurement.frequency_hz > 0.0
    ):
        return None
    off = abs(measurement.frequency_hz - felt.frequency_hz), abs(measurement.damping_ratio - felt.damping_ratio)
    unsure = measurement.frequency_uncertainty_hz, measurement.damping_ratio_uncertainty
    if off[0] <= max(_SAME * felt.frequency_hz, _UNSURE * unsure[0]) and off[1] <= max(_SAME, _UNSURE * unsure[1]):
        return None  # the declared mass is not excluded
    for mass in felt.masses_with(measurement.frequency_hz):
        step = 1e-4 * mass
        above, at_it, below = (felt.with_mass(one) for one in (mass + step, mass, mass - step))
        slope = (above.frequency_hz - below.frequency_hz) / (2.0 * step)
        ratio_slope = (above.damping_ratio - below.damping_ratio) / (2.0 * step)
        mass_off = measurement.frequency_uncertainty_hz / abs(slope) if slope else math.inf
        allowed = math.hypot(measurement.damping_ratio_uncertainty, ratio_slope * mass_off)
        # A small error of the friction, which would not be reported, does not hide the mass.
        if not abs(at_it.damping_ratio - measurement.damping_ratio) <= max(_UNSURE * allowed, _CLEARLY / 2):
            continue
        known = measurement.mass_uncertainty or 0.0
        if abs(mass - measurement.mass) > max(_CLEARLY * measurement.mass, _UNSURE * math.hypot(mass_off, known)):
            return ProbableMass(mass, mass_off, mass / measurement.mass)
    return None


def probable_delay(felt: Felt, measurement: Measurement) -> float | None:
    """Returns the delay in sample periods with which the prediction has the measured k and b. None if there is none, or
    if b is less than predicted by no more than the device's friction, which may be declared too large."""
    device, k = felt.configuration, measurement.k
    unsure = max(_MANY * measurement.b_uncertainty, _CLEARLY * math.sqrt(abs(felt.k) * measurement.mass))
    if not (felt.b - measurement.b > device.friction + unsure and felt.predictor is None and _is_in_time(measurement)):
        return None

    def late(delay: float) -> Felt:
        return replace(felt, configuration=replace(device, delay=delay))

    longer = (device.delay + samples for samples in range(1, _LATER + 1))
    most = next((delay for delay in longer if not late(delay).b > measurement.b), device.delay)
    if not late(most).b <= measurement.b:
        return None
    delay = float(brentq(lambda delay: late(delay).b - measurement.b, device.delay, most, xtol=1e-6))
    agrees = abs(late(delay).k - k) <= max(_UNSURE * measurement.k_uncertainty, _CLEARLY * abs(k))
    return delay if agrees else None


def has_unmodelled_mode(prediction: Prediction, measurement: Measurement) -> bool:
    """Returns True if the motion has a mode that the scene lacks: a second mode, and more slow poles than predicted."""
    if measurement.second_mode is None or math.isnan(measurement.dry_friction_n):
        return False  # corners from dry friction look like another mode
    lasting = abs(measurement.second_mode.pole) * (1.0 - 1e-9)
    measured = sum(abs(pole) >= lasting for pole in measurement.poles)
    return measured > sum(abs(pole) >= _LASTS for pole in prediction.poles)


def _is_off(felt: Felt, measurement: Measurement) -> bool:
    """Returns True if k or b is off by much more than its uncertainty."""
    pairs = [
        (measurement.k - felt.k, measurement.k_uncertainty, felt.k),
        (measurement.b - felt.b, measurement.b_uncertainty, math.sqrt(abs(felt.k) * measurement.mass)),
    ]
    return any(abs(off) > max(_MANY * uncertainty, _CLEARLY * abs(whole)) for off, uncertainty, whole in pairs)


def _is_undisturbed(measurement: Measurement) -> bool:
    """Returns True if the device kept the declared rate, and most forces were in time."""
    seen = measurement.seen_rate
    return _is_in_time(measurement) and (seen is None or not seen.differs_from(measurement.trace.rate))


def _is_in_time(measurement: Measurement) -> bool:
    """Returns True if most forces were in time. Limited or slewed forces and those of the soft start do not count: they
    are recorded as they acted."""
    report = measurement.trace.report
    return report.deadline_misses / report.ticks <= _FEW
