"""What a measurement beside its prediction tells of the device: its mass, and a hand that gives."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

from hapsim.measuring.measure_trace import Measurement
from hapsim.prediction import Felt, Prediction
from hapsim.prediction.other_mass import masses_with, oscillation_at

_UNSURE = 4.0  # uncertainties: what is further apart is not the same
_MANY = 10.0
_CLEARLY = 0.01  # of the mass, of what is predicted, of b of half the critical damping: what is less off is not said
_FEW = 0.01
_LASTS = 0.5  # modulus of a pole: below that of any that `SecondMode` counts


class ProbableMass(NamedTuple):
    """The mass with which the prediction has the eigenfrequency and the damping ratio that were measured."""

    mass: float
    """kg."""
    uncertainty: float
    """kg, standard."""
    factor: float
    """Times the mass to which the measurement refers."""


def probable_mass(felt: Felt | None, measurement: Measurement) -> ProbableMass | None:
    """None where the mass is as it is said to be, or no other explains both values.

    The eigenfrequency gives the mass; whether it is the mass that is wrong, the damping ratio tells.
    """
    if felt is None or not _is_undisturbed(measurement) or not measurement.frequency_hz > 0.0:
        return None
    for mass in masses_with(felt, measurement.frequency_hz):
        step = 1e-4 * mass
        above, below = oscillation_at(felt, mass + step), oscillation_at(felt, mass - step)
        slope, ratio_slope = ((a - b) / (2.0 * step) for a, b in zip(above, below, strict=True))
        unsure = measurement.frequency_uncertainty_hz / abs(slope) if slope else math.inf
        allowed = math.hypot(measurement.damping_ratio_uncertainty, ratio_slope * unsure)
        if not abs(oscillation_at(felt, mass)[1] - measurement.damping_ratio) <= _UNSURE * allowed:
            continue
        known = measurement.mass_uncertainty or 0.0
        off = abs(mass - measurement.mass)
        if off > max(_CLEARLY * measurement.mass, _UNSURE * math.hypot(unsure, known)):
            return ProbableMass(mass, unsure, mass / measurement.mass)
    return None


def gives(prediction: Prediction, measurement: Measurement) -> bool:
    """Whether something swings along that the scene does not have: the motion has a second mode, and more poles that
    last than are predicted."""
    if measurement.second_mode is None:
        return False
    lasting = abs(measurement.second_mode.pole) * (1.0 - 1e-9)
    return sum(abs(pole) >= lasting for pole in measurement.poles) > sum(
        abs(pole) >= _LASTS for pole in prediction.poles
    )


def is_another_device(felt: Felt, measurement: Measurement) -> bool:
    """Whether k or b is off by much more than its uncertainty."""
    pairs = [
        (measurement.k - felt.k, measurement.k_uncertainty, felt.k),
        (measurement.b - felt.b, measurement.b_uncertainty, math.sqrt(abs(felt.k) * measurement.mass)),
    ]
    return _is_undisturbed(measurement) and any(
        abs(off) > max(_MANY * uncertainty, _CLEARLY * abs(whole)) for off, uncertainty, whole in pairs
    )


def _is_undisturbed(measurement: Measurement) -> bool:
    """At the declared rate, and with most forces below the limit and in time."""
    report, seen = measurement.trace.report, measurement.seen_rate
    shaped = report.limited_ticks + report.slewed_ticks + report.faded_ticks
    disturbed = shaped + report.deadline_misses > _FEW * report.ticks
    return not disturbed and (seen is None or not seen.differs_from(measurement.trace.rate))


def oscillation_of(pole: complex, rate_hz: float) -> tuple[float, float]:
    """(eigenfrequency in Hz, damping ratio) of a pole in the z-plane."""
    s = cmath.log(pole) * rate_hz
    return abs(s) / (2.0 * math.pi), -s.real / abs(s)
