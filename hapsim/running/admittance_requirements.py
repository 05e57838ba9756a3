"""Requirements of `mode: admittance` on a device: sensed forces, position commands, and the scene's servo."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description, Servo
from hapsim.errors import UsageError
from hapsim.number_format import rounded_down
from hapsim.scene import Scene

_NUMBERS = (
    ("hand_force_range", "N", schema.REG_HAND_FORCE_RANGE),
    ("speed_limit", "m/s", schema.REG_SPEED_LIMIT),
    ("braking", "m/s²", schema.REG_BRAKING),
)
_SAME = 0.2  # relative: a servo as identified may be that far from the one that its firmware was made for


def require_admittance(scene: Scene, name: str, description: Description) -> None:
    """Raises UsageError if the device cannot run a scene with `mode: admittance` as it is."""
    servo = description.servo
    lacking = [
        words
        for words, has in (
            ("senses no force of the hand (its register 15, bit 1)", "hand_force" in description.sensed),
            ("follows no position commands (its register 15, bit 4)", servo is not None),
        )
        if not has
    ]
    if servo is None or lacking:
        raise UsageError(
            f"{name}: device.mode: found admittance, but the device {' and '.join(lacking)}; write mode: impedance, or "
            "use a firmware that does"
        )
    if differing := [*_differences(scene, servo)]:
        found, write = (", ".join(one[side] for one in differing) for side in (0, 1))
        raise UsageError(f"{name}: device: found {found}, but the device has {write}: write that into the scene")


def declared_numbers(description: Description) -> Iterator[tuple[str, float, str, int]]:
    """Yields what has to be a number above 0 in admittance: its name, value, unit and register."""
    for name, unit, register in _NUMBERS:
        values: Any = getattr(description.servo, name, None) or getattr(description, name, ())
        for c, value in enumerate(values):
            yield f"{name.replace('_', ' ')} of channel {c}", value, unit, register + c * schema.MORE_WORDS


def _differences(scene: Scene, servo: Servo) -> Iterator[tuple[str, str]]:
    """Yields what the scene has and what the device has, where they differ; of the first channel of each kind."""
    speeds = scene.device.speed_limits(scene.channels)
    servos = () if scene.is_auxiliary else scene.device.servos(scene.channels)  # of a device that is identified
    for c, speed in enumerate(speeds):
        if speed > servo.speed_limit[c] * (1.0 + 1e-9):
            units, most = scene.units_of(c), servo.speed_limit[c]
            yield f"speed_limit: {units(speed, 'm/s', 'g')}", f"at most {units(most, 'm/s', rounded_down)}"
            break
    for own, has in zip(servos, zip(servo.bandwidth_hz, servo.damping, strict=True), strict=False):
        if not np.allclose(own or 0.0, has if has[0] else 0.0, rtol=_SAME, atol=0.0):
            yield _words(own), _words(has)
            break


def _words(servo: tuple[float, float] | None) -> str:
    return "servo: {{bandwidth: {:g} Hz, damping: {:g}}}".format(*servo) if servo and servo[0] else "no servo"
