"""Sentences on the motors and transmissions of a device: what swings in them, and whether the hand feels any of it."""

from __future__ import annotations

import math
from collections.abc import Iterator

from hapsim.number_format import duration, frequency
from hapsim.prediction.linear import with_device
from hapsim.prediction.predict import prediction_of
from hapsim.prediction.prediction import Prediction
from hapsim.scene.drive import Drive
from hapsim.theory import NotWorkedOutError
from hapsim.units import Units


def drive_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields what lies between motor and hand, and how fast it swings; nothing for a device that is one mass."""
    scene = prediction.scene
    drives, masses = scene.device.drives(scene.channels), scene.device.masses(scene.channels)
    if all(one.is_rigid for one in drives):
        return
    for name, point in scene.device_points.items():
        drive, units = drives[point.channel], scene.units_of(point.channel)
        if drive.is_elastic:
            yield f"Transmission of {name}: {_belt(drive, masses[point.channel], scene.rate, units)}"
        if drive.backlash > 0.0:
            yield f"Backlash of {name}: {_play(prediction, name, drive, units)}"
        if drive.lag > 0.0:
            yield f"Motor of {name}: its force lags by {duration(drive.lag)} ({drive.lag * scene.rate:.3g} samples)"
    if _printed(prediction) == _printed(prediction_of(with_device(scene, transmission=None, motor_lag=0.0))):
        yield "Transmission and motor lag change no digit of the felt values and of the largest pole: omit them"


def resonance_hz(drive: Drive, mass: float) -> float:
    """Returns the frequency, Hz, at which motor and handle swing against each other while nothing holds them."""
    return math.sqrt(drive.stiffness / drive.motor_mass * mass / (mass - drive.motor_mass)) / (2.0 * math.pi)


def _belt(drive: Drive, mass: float, rate: float, units: Units) -> str:
    motor, handle = (units(one, "kg", ".4g") for one in (drive.motor_mass, mass - drive.motor_mass))
    swing = resonance_hz(drive, mass)
    image = abs(swing - rate * round(swing / rate))
    seen = f", beyond half the rate: the loop sees it at {frequency(image)}" if swing > 0.5 * rate else ""
    belt = units(drive.stiffness, "N/m", ".4g")
    return f"a motor of {motor} and a handle of {handle} on {belt} swing against each other at {frequency(swing)}{seen}"


def _play(prediction: Prediction, name: str, drive: Drive, units: Units) -> str:
    """Returns what the play of a transmission does to a hand that presses on neither side."""
    play = units(drive.backlash, "mm", ".4g")
    try:
        rattle = prediction.states.rattle_of(name)
    except NotWorkedOutError as reason:
        return f"{play}; its oscillation in it was not worked out: {reason}"
    if rattle is None:
        return f"{play}; no steady oscillation in it was found"
    motor, handle = (units(one, "mm", ".3g") for one in rattle)
    swing = f"the motor swings in it by {motor} and the handle by {handle} from end to end"
    return f"{play}; {swing} unless the hand presses on one side"


def _printed(prediction: Prediction) -> tuple[str, ...]:
    """Returns the felt values and the spectral radius as `check` prints them."""
    rows = [row for part in prediction.parts for row in part.rows]
    values = (value for row in rows for value in (row.k, row.b, row.static_stiffness))
    return (*(f"{value:.6g}" for value in values), f"{prediction.spectral_radius:.9g}")
