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
    scales = (*description.position_scale, *description.force_scale, *description.force_limit, description.rate_hz)
    if not all(np.isfinite(scales)) or min(scales) <= 0:
        raise DescriptionError(f"{name}: the device declares a rate, scale or limit that is not a number above 0")
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
    if scene.sensed_links:
        _require_velocity(scene, name, description)


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
