"""A simulated mass that a hand on the mock holds: scenes in virtual time, and their loop written out once more."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.linalg import expm

from hapsim.scene import Scene

HAND: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
DEVICE: dict[str, Any] = {
    "clock": "lockstep",
    "mode": "admittance",
    "simulated_mass": 0.2,
    "simulated_damping": 5.0,
    "assumed_hand": {"stiffness": 2000.0},
}


def scene_of(
    modules: dict[str, Any] | None = None, *, device: Any = None, hand: Any = None, mock: Any = None, **keys: Any
) -> Scene:
    """Returns a scene at 1 kHz with these modules besides; `device`, `hand` (of the mock), `mock`: what differs."""
    held = {"hand": {"stiffness": 2000.0} | (hand or {}), "initial": {"position": 1e-3}} | (mock or {})
    whole: dict[str, Any] = {"version": 1, "rate": 1000.0, "device": DEVICE | (device or {}), "mock": held} | keys
    return Scene.model_validate(whole | {"modules": HAND | (modules or {})})


def written_out(scene: Scene, count: int, *, stiffness: float = 0.0, damping: float = 0.0) -> dict[str, Any]:
    """Returns position, hand_force and command of `count` samples of channel 0, without rounding. `stiffness`,
    `damping`: of a link from the device point to the ground."""
    period, delay = scene.period, scene.mock_device.delay
    mass, friction = scene.device.masses(1)[0], scene.device.frictions(1)[0]
    hand: Any = scene.mock_device.hand
    (servo,) = scene.mock_device.servo
    whole, part = math.floor(delay), delay % 1.0
    first = scene.mock_device.initial_position[0]
    masses = dict.fromkeys(range(-whole - 1, 1), first)  # X[n]
    found = np.zeros((3, count))
    at, speed, past = first, 0.0, [first, first]
    for n in range(count):
        if n > 0:  # the device moves from sample n - 1 on, by what was decided up to then
            old, new = masses[n - 1 - whole], masses[n - whole]
            if servo is None:
                at, speed = new + part * (old - new), (new - old) / period
            else:
                for share, place in ((part, old), (1.0 - part, new)):
                    at, speed = _follow(servo, share * period, at, speed, place)
        bend = (at - 2.0 * past[-1] + past[-2]) / period**2
        past = [past[-1], at]
        force = hand.force - hand.stiffness * (at - hand.position) - hand.damping * speed - hand.mass * bend
        step = masses[n] - masses[n - 1]
        pull = force - stiffness * masses[n] - damping * step / period
        masses[n + 1] = masses[n] + step + period**2 / mass * (pull - friction * step / period)
        found[:, n] = at, force, masses[n + 1]
    return dict(zip(("position", "hand_force", "command"), found, strict=True))


def _follow(servo: Any, seconds: float, at: float, speed: float, place: float) -> tuple[float, float]:
    """Returns position and speed of a servo that followed the command `place` for `seconds`."""
    w = 2.0 * math.pi * servo.bandwidth
    moved = expm(seconds * np.array([[0.0, 1.0], [-(w**2), -2.0 * servo.damping * w]])) @ [at - place, speed]
    return place + moved[0], moved[1]
