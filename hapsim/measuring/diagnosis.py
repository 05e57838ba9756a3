"""In what a device differs from what the scene declares, as a measured k and b show it beside the prediction.

Measured was before: nothing that is found here goes back into it.
"""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING, NamedTuple

from hapsim.measuring.measure_trace import Measurement

if TYPE_CHECKING:
    from hapsim.prediction import Felt, Prediction

_UNSURE = 4.0  # uncertainties: what is further apart is not the same
_MANY = 5.0
_SAME = 1e-4  # a mass that is clearly off changes the frequency by 50 times as much
_CLEARLY = 0.01  # of the mass, of what is predicted, of b of half the critical damping: what is less off is not said
_FEW = 0.01  # of the ticks: forces that the device did not get in time act otherwise than the record says
_LASTS = 0.5  # modulus of a pole: below that of any that `SecondMode` counts


class ProbableMass(NamedTuple):
    """The mass with which the prediction has the eigenfrequency and the damping ratio that were measured."""

    mass: float
    """kg."""
    uncertainty: float
    """kg, standard."""
    factor: float
    """Times the mass to which the measurement refers."""


class Mode(NamedTuple):
    """A second mode of the motion."""

    frequency_hz: float
    damping_ratio: float
    share: float
    """Of the motion's energy."""
    predicted: bool
    """Whether the scene has it; else the hand swings along, or a part of the device."""


class Diagnosis(NamedTuple):
    """What a measurement says of a device beside the prediction."""

    probable_mass: ProbableMass | None
    """None where the declared mass fits, or none does better; and where the motion is not that of the hand alone."""
    second_mode: Mode | None
    is_another_device: bool
    """Whether k or b is off by much more than its uncertainty, and no other mass explains it."""

    @property
    def gives(self) -> bool:
        """Whether something swings along that the scene does not have."""
        return self.second_mode is not None and not self.second_mode.predicted

    @property
    def differs(self) -> bool:
        """Whether the device differs from what the scene declares."""
        return self.probable_mass is not None or self.gives or self.is_another_device


def diagnose(prediction: Prediction, measurement: Measurement, channel: int = 0) -> Diagnosis:
    """In what the device differs from what the scene declares, as what was measured on `channel` shows it."""
    felt = next((one for one in prediction.felt if one.channel == channel), None)
    second, extra, mode = measurement.second_mode, gives(prediction, measurement), None
    if second is not None:
        s = cmath.log(second.pole) * measurement.trace.rate
        mode = Mode(abs(s) / (2.0 * math.pi), -s.real / abs(s), second.share, not extra)
    disturbed = extra or bool(measurement.left_region)
    mass = None if disturbed else probable_mass(felt, measurement)
    is_other = felt is not None and not disturbed and mass is None and not math.isnan(measurement.dry_friction_n)
    return Diagnosis(mass, mode, is_other and felt is not None and _is_another_device(felt, measurement))


def probable_mass(felt: Felt | None, measurement: Measurement) -> ProbableMass | None:
    """Returns the mass that the measurement suggests; None where the declared one fits, or no other fits better.

    The eigenfrequency gives the mass; the damping ratio says whether it is the mass that is wrong.
    """
    if (
        felt is None
        or math.isnan(measurement.dry_friction_n)
        or not _is_undisturbed(measurement)
        or not measurement.frequency_hz > 0.0
    ):
        return None
    same_frequency = abs(measurement.frequency_hz - felt.frequency_hz) < _SAME * felt.frequency_hz
    if same_frequency and abs(measurement.damping_ratio - felt.damping_ratio) < _SAME:
        return None  # without importing scipy.optimize, which takes long
    for mass in felt.masses_with(measurement.frequency_hz):
        step = 1e-4 * mass
        above, at_it, below = (felt.with_mass(one) for one in (mass + step, mass, mass - step))
        slope = (above.frequency_hz - below.frequency_hz) / (2.0 * step)
        ratio_slope = (above.damping_ratio - below.damping_ratio) / (2.0 * step)
        unsure = measurement.frequency_uncertainty_hz / abs(slope) if slope else math.inf
        allowed = math.hypot(measurement.damping_ratio_uncertainty, ratio_slope * unsure)
        # A friction that is a little off, of which nothing would be said, does not hide the mass.
        if not abs(at_it.damping_ratio - measurement.damping_ratio) <= max(_UNSURE * allowed, _CLEARLY / 2):
            continue
        known = measurement.mass_uncertainty or 0.0
        off = abs(mass - measurement.mass)
        if off > max(_CLEARLY * measurement.mass, _UNSURE * math.hypot(unsure, known)):
            return ProbableMass(mass, unsure, mass / measurement.mass)
    return None


def gives(prediction: Prediction, measurement: Measurement) -> bool:
    """Returns whether something swings along that the scene does not have: the motion has a second mode, and more
    poles that last than are predicted."""
    if measurement.second_mode is None or math.isnan(measurement.dry_friction_n):
        return False  # the corners that dry friction makes pass for another mode
    lasting = abs(measurement.second_mode.pole) * (1.0 - 1e-9)
    measured = sum(abs(pole) >= lasting for pole in measurement.poles)
    return measured > sum(abs(pole) >= _LASTS for pole in prediction.poles)


def _is_another_device(felt: Felt, measurement: Measurement) -> bool:
    """Returns whether k or b is off by much more than its uncertainty."""
    pairs = [
        (measurement.k - felt.k, measurement.k_uncertainty, felt.k),
        (measurement.b - felt.b, measurement.b_uncertainty, math.sqrt(abs(felt.k) * measurement.mass)),
    ]
    return _is_undisturbed(measurement) and any(
        abs(off) > max(_MANY * uncertainty, _CLEARLY * abs(whole)) for off, uncertainty, whole in pairs
    )


def _is_undisturbed(measurement: Measurement) -> bool:
    """Returns whether the device kept the declared rate, and most forces were in time. Those at a limit, slewed or in
    the soft start are in the record as they acted: k and b come from that."""
    report, seen = measurement.trace.report, measurement.seen_rate
    late = report.deadline_misses / report.ticks > _FEW
    return not late and (seen is None or not seen.differs_from(measurement.trace.rate))
