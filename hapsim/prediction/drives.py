"""Sentences on the motors and transmissions of a device: what swings in them, and whether the hand feels any of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from hapsim.number_format import duration, frequency
from hapsim.prediction.backlash import Rattle
from hapsim.prediction.linear import with_device
from hapsim.prediction.predict import prediction_of
from hapsim.prediction.prediction import Prediction
from hapsim.prediction.timing import lag_as_delay
from hapsim.scene.drive import Drive
from hapsim.theory import NotWorkedOutError
from hapsim.units import Units


def drive_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields what lies between motor and hand, and how fast it swings; nothing for a device that is one mass."""
    scene = prediction.scene
    drives, masses = scene.device.drives(scene.channels), scene.device.masses(scene.channels)
    if all(one.is_rigid for one in drives):
        return
    plays = plays_of(prediction)
    for name, point in scene.device_points.items():
        drive, units = drives[point.channel], scene.units_of(point.channel)
        if drive.is_elastic:
            yield f"Transmission of {name}: {_belt(drive, masses[point.channel], scene.rate, units)}"
        if drive.backlash > 0.0:
            play = f"{units(drive.backlash, 'mm', '.4g')}; {_swing(plays[name], units)}"
            yield f"Backlash of {name}: {play}. The felt values and the gain margins are those in mesh"
        if drive.lag > 0.0:
            samples = f"{drive.lag * scene.rate:.3g} samples"
            taken = f"; correction {scene.device.correction} takes it as a longer delay" * bool(lag_as_delay(scene))
            yield f"Motor of {name}: its force lags by {duration(drive.lag)} ({samples}){taken}"
    if lag_as_delay(scene):
        return
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


class Play(NamedTuple):
    """Play of a transmission, and the oscillation in it of a hand that presses on neither side."""

    backlash: float
    """m."""
    swing: Rattle | None
    """None: no steady one was found, or it was not worked out."""
    reason: str
    """Reason why it was not worked out; "" if it was."""


def plays_of(prediction: Prediction) -> dict[str, Play]:
    """Returns the play of each hand behind a transmission that has some."""
    drives, found = prediction.scene.device.drives(prediction.scene.channels), dict[str, Play]()
    for name, point in prediction.scene.device_points.items():
        if play := drives[point.channel].backlash:
            try:
                found[name] = Play(play, prediction.states.rattle_of(name), "")
            except NotWorkedOutError as reason:
                found[name] = Play(play, None, str(reason))
    return found


def _swing(play: Play, units: Units) -> str:
    if play.swing is None:
        worked_out = f"its oscillation in it was not worked out: {play.reason}"
        return worked_out if play.reason else "no steady oscillation in it was found"
    motor, handle = (units(one, "mm", ".3g") for one in play.swing)
    swing = f"the motor swings in it by {motor} and the handle by {handle} from end to end"
    return f"{swing} unless the hand presses on one side"


def _printed(prediction: Prediction) -> tuple[str, ...]:
    """Returns the felt values and the spectral radius as `check` prints them."""
    rows = [row for part in prediction.parts for row in part.rows]
    values = (value for row in rows for value in (row.k, row.b, row.static_stiffness))
    return (*(f"{value:.6g}" for value in values), f"{prediction.spectral_radius:.9g}")
