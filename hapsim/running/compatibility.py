"""Whether a scene and the device that answers go together."""

from __future__ import annotations

from typing import get_args

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description
from hapsim.errors import DescriptionError, UsageError
from hapsim.scene import DamperScheme, Scene
from hapsim.scene.choices import WITH_SENSOR
from hapsim.scene.issue import one_of

PACING = {
    "device": schema.PACED_BY_DEVICE,
    "host": schema.PACED_BY_HOST,
    "lockstep": schema.LOCKSTEP,
}
"""How a scene's clock is called on the wire."""


def require_compatible(scene: Scene, name: str, description: Description) -> None:
    """UsageError or DescriptionError where scene and device do not go together. `name`: what a user calls the port."""
    if description.channels < scene.channels:
        raise UsageError(f"{name}: the device has {description.channels} channel(s), the scene uses {scene.channels}")
    _require_numbers(name, description)
    if abs(description.rate_hz / scene.rate - 1.0) > 1e-6:
        raise UsageError(
            f"{name}: the device samples at {description.rate_hz:g} Hz, the scene says {scene.rate:g} Hz: "
            f"write rate: {description.rate_hz:g} into the scene, or set the device"
        )
    if description.max_watchdog_samples < 1:
        raise DescriptionError(
            f"{name}: the device allows no watchdog (its register {schema.REG_MAX_WATCHDOG} reads 0), so that nothing "
            f"would end a force of a host that died: found 0, expected 1 to {schema.MAX_WATCHDOG_SAMPLES} samples. Not "
            "armed; set the register in its firmware"
        )
    if not description.paces(PACING[scene.device.clock]):
        raise UsageError(
            f"{name}: the device cannot be run with clock: {scene.device.clock}; try another clock in the scene"
        )
    for channel, origin in enumerate(scene.device.origins(scene.channels)):
        if abs(origin or 0.0) >= 2**31 * description.position_scale[channel]:
            raise UsageError(
                f"{name}: device.origin: found {origin:g} m on channel {channel}, where no position of this device is: "
                f"its counts end at {2**31 * description.position_scale[channel]:g} m"
            )
    if scene.sensed_links:
        _require_velocity(scene, name, description)


def require_known_zero(scene: Scene, name: str) -> None:
    """DescriptionError where the scene's travel counts from a zero that a device which restarted no longer has."""
    named = scene.device.origin is not None and not all(one is None for one in scene.device.origins(scene.channels))
    if named and scene.device.travel is not None:
        raise DescriptionError(
            f"{name}: the device restarted: its position 0 is now where it powered up or homed, and device.origin and "
            "device.travel of the scene count from where it was before. Not armed again: put the device where they "
            "hold, and start anew; with origin: here they count from where it is armed, and without an origin from the "
            "device's own zero (a device that homes), and it is armed again"
        )


def _require_numbers(name: str, description: Description) -> None:
    """DescriptionError where the rate, a scale or a limit is not a number above 0."""
    _require_above_zero(name, "a rate", description.rate_hz, "Hz", schema.REG_RATE)
    declared = (
        ("position scale", description.position_scale, "m per count", schema.REG_POSITION_SCALE),
        ("force scale", description.force_scale, "N per count", schema.REG_FORCE_SCALE),
        ("force limit", description.force_limit, "N", schema.REG_FORCE_LIMIT),
    )
    for channel in range(description.channels):
        at = schema.REG_CHANNEL + channel * schema.CHANNEL_WORDS
        for what, values, unit, register in declared:
            _require_above_zero(name, f"a {what} of channel {channel}", values[channel], unit, at + register)


def _require_above_zero(name: str, what: str, value: float, unit: str, register: int) -> None:
    if not (np.isfinite(value) and value > 0):
        raise DescriptionError(
            f"{name}: the device declares {what} of {value:g} {unit} (register {register}), which is not a number above"
            " 0. Not armed; set the register in its firmware"
        )


def _require_velocity(scene: Scene, name: str, description: Description) -> None:
    links, others = scene.sensed_links, [name for name in get_args(DamperScheme) if name not in WITH_SENSOR]
    if not description.velocity_scale:
        raise UsageError(
            f"{name}: the device does not sense velocity, but {', '.join(links)} {'ask' if links[1:] else 'asks'} "
            f"for it with damper: {one_of(WITH_SENSOR)}; write damper: {one_of(others)} there, or use a firmware that "
            "reports velocity"
        )
    if not description.senses_velocity or not all(np.isfinite(description.velocity_scale)):
        raise DescriptionError(f"{name}: the device declares a velocity scale that is not a number above 0")
