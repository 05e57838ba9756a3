"""How hard, how long and at which simulated (K, B) a device is pushed, so that its parameters show and it stays where
it may be.

The device hangs on a soft simulated spring and damper at the place where it was found, and is pushed to one side and to
the other, level, each time for `half` samples. Everything is slow beside the delay: with w the eigenfrequency,
w half T <= 1 and half >= 16 (delay + 1), so that the loop is stable for a mass and a delay several times the ones
that it was designed for, or a fraction of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hapsim.measuring.converters import Converters
from hapsim.measuring.device_motion import sampled_motion
from hapsim.running.options import Excitation
from hapsim.scene import Ground, Initial, Mock, Scene, ViscoElastic

_LEAST_HALF = 32
_SLOW = 16.0  # sample periods for each of the delay and one more
_LONGEST_HALF_S = 1.0
_DAMPING_RATIO = 0.5
_PUSHES = 0.8  # of the force that is allowed; the rest is the spring's
_WITH_SPRING = 2.0  # times a push: what leaves at most
_FADES = 0.3  # of the travel, at its ends
_LOOKED_AT = 24  # half periods of a motion that is simulated ahead
_GOLDEN = 0.6180339887498949  # as the loop varies its pushes


@dataclass(frozen=True)
class Bounds:
    """What the device may be given: force in N, travel in m to either side of where it was found."""

    force: float
    travel: float

    @property
    def push(self) -> float:
        """N that a push may have."""
        return _PUSHES * self.force


class Plant(NamedTuple):
    """A model of the device, SI units, delay in sample periods."""

    mass: float
    friction: float
    stiffness: float
    delay: float


@dataclass(frozen=True)
class Drive:
    """A simulated spring and damper in SI units, and pushes of `force` N, `half` samples each."""

    stiffness: float
    damping: float
    force: float
    half: int

    def excitation(self, channel: int) -> Excitation:
        """From the first tick on, one push after the other."""
        return Excitation(channel, self.force, self.half, self.half, start=0, first=False)


def drive_for(plant: Plant, bounds: Bounds, rate_hz: float, *, pace: float, tightness: float) -> Drive:
    """Pushes with all the force that is allowed, and as long as it takes to cross the travel, were the plant free.

    `pace`: a factor on that time; `tightness`: eigenfrequency on the spring times half a period, in rad.
    """
    shortest = max(_LEAST_HALF, math.ceil(_SLOW * (plant.delay + 1.0)))
    longest = max(shortest, math.floor(_LONGEST_HALF_S * rate_hz))
    crossing = math.sqrt(4.0 * bounds.travel * plant.mass / bounds.push) * rate_hz
    half = min(max(shortest, math.ceil(pace * crossing)), longest)
    eigen = tightness * rate_hz / half  # rad/s
    return Drive(plant.mass * eigen**2, 2.0 * _DAMPING_RATIO * plant.mass * eigen, bounds.push, half)


def peak_per_newton(plant: Plant, drive: Drive, rate_hz: float, converters: Converters) -> float:
    """How far the plant gets under these pushes, m for each newton of them; with dry friction it would be less."""
    inertia = rate_hz * plant.mass * rate_hz
    motion = sampled_motion(plant.friction * rate_hz / inertia, plant.stiffness / inertia, plant.delay, converters)
    gains = np.array(motion.gains)
    ages = motion.whole_delay + np.arange(len(gains))
    pushes, gone = _LOOKED_AT * drive.half, int(ages[-1]) + 1
    forces, seen, state = np.zeros(pushes + gone), np.zeros(pushes + 1), np.zeros(2)
    for n in range(pushes):
        number = n // drive.half
        push = (-1.0) ** number * (1.0 - 0.5 * ((number * _GOLDEN) % 1.0))
        spring = drive.stiffness * seen[n] + drive.damping * rate_hz * (seen[n] - seen[max(n - 1, 0)])
        forces[n + gone] = (push - spring) / inertia
        acting = forces[n + gone - ages] @ gains
        seen[n + 1] = motion.row @ state + acting[motion.seen]
        state = motion.step @ state + acting[:2]
    return float(np.max(np.abs(seen)))


def scene_of(scene: Scene, bounds: Bounds, channel: int, drive: Drive | None, home: float) -> Scene:
    """The scene's device on this spring and damper at `home` (m), or on nothing.

    Every other channel is free. The force is limited to what is allowed, and fades where the device comes near the end
    of its travel; nothing is corrected by what is declared, and a mock begins at rest.
    """
    device: dict[str, Any] = {"correction": "none", "force_limit": bounds.force, "travel": None}
    modules: dict[str, Any] = {f"device-{point.channel}": point for point in scene.device_points.values()}
    if drive is not None:
        ends, K, B = (f"device-{channel}", "home"), drive.stiffness, drive.damping
        modules["home"] = Ground(type="ground", position=home)
        modules["spring"] = ViscoElastic(type="viscoelastic", between=ends, stiffness=K, damping=B)
        limits, fades = list(scene.device.travels(scene.channels)), _FADES * bounds.travel
        least, most = limits[channel]
        limits[channel] = max(least, home - bounds.travel + fades), min(most, home + bounds.travel - fades)
        force = min(bounds.force, _WITH_SPRING * drive.force)
        device |= {"travel": tuple(limits), "travel_margin": fades, "force_limit": force}
    mock = scene.mock or Mock()
    changed = {
        "device": scene.device.model_copy(update=device),
        "mock": mock.model_copy(update={"initial": Initial(position=mock.initial.position)}),
        "modules": modules,
        "scheme": "cordis",
        "precision": "double",
    }
    return scene.model_copy(update=changed)
