"""In what a device differs from what the scene declares, as a measured k and b show it beside the prediction."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from typing import NamedTuple

from hapsim.loop.ring import FADED, LIMITED, SLEWED
from hapsim.measuring.measure_trace import Measurement
from hapsim.number_format import percent
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


def _shaped_ticks(measurement: Measurement) -> tuple[int, int, int, int]:
    """Returns how many ticks there were, and how many of them at the force limit, at the slew limit and outside the
    travel: of the whole run, or once a hand that was led is at its place."""
    report, flags = measurement.trace.report, measurement.trace.flags
    if measurement.at_m is None:
        return report.ticks, report.limited_ticks, report.slewed_ticks, report.faded_ticks
    limited, slewed, faded = (int((flags & flag != 0).sum()) for flag in (LIMITED, SLEWED, FADED))
    return flags.size, limited, slewed, faded


def oscillation(measurement: Measurement, pole: complex) -> tuple[float, float]:
    """Returns (eigenfrequency in Hz, damping ratio) of a pole in the z-plane."""
    s = cmath.log(pole) * measurement.trace.rate
    return abs(s) / (2.0 * math.pi), -s.real / abs(s)


def limits(measurement: Measurement) -> Iterator[str]:
    """Yields for which motions k and b hold, where something limited the force."""
    in_all, limited, slewed, faded = _shaped_ticks(measurement)
    for ticks, place, holds in (
        (limited, "at the force limit", "stay below it; beyond, the hand feels less"),
        (slewed, "at the slew limit or in the soft start", "are slower; in these the hand feels less"),
        (faded, "outside device.travel or at a position that stood still, where the force fades", "stay within it"),
    ):
        if ticks:
            many = f"{ticks} of {in_all} ticks were {place}"
            yield f"[yellow]{many}[/yellow]: k and b hold for motions that {holds}."


def other_device(felt: Felt | None, measurement: Measurement, prediction: Prediction, of_mass: str) -> Iterator[str]:
    """Yields in what the device differs from what the scene declares."""
    second, mass = measurement.second_mode, probable_mass(felt, measurement)
    if second is not None and gives(prediction, measurement):
        frequency, ratio = oscillation(measurement, second.pole)
        yield (
            f"[yellow]Something swings along[/yellow] at {frequency:.3g} Hz, damping ratio {ratio:.2g}, with "
            f"{percent(second.share, 3)} of the motion's energy: the hand, or a part of the device, moves against the "
            "rest like a mass on a spring; or dry friction bends the motion, which `hapsim identify` finds. "
            "k and b are those of the longest ringing mode, not what the hand feels."
        )
    elif mass is not None:
        share = mass.factor
        yield (
            f"[yellow]The mass is probably {share:.3g} times the {of_mass} one[/yellow], {mass.mass:.4g} kg: with it "
            "the prediction has the eigenfrequency and the damping ratio that were measured, and the hand feels "
            f"k = {share * measurement.k:.6g} N/m, b = {share * measurement.b:.6g} N·s/m. `hapsim identify --write` "
            "measures and stores it."
        )
    elif felt is not None and not math.isnan(measurement.dry_friction_n) and _is_another_device(felt, measurement):
        yield (
            "[yellow]Measured and predicted are much further apart than the uncertainty[/yellow]: the device is not as "
            "the scene declares it, or has dry friction. `hapsim identify` finds what it is."
        )
