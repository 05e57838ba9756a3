"""Sets up the guards of a loop, from its scene and its device."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocol.description import Description
from hapsim.compiling.native import address_of
from hapsim.cordis.stored_energy import Tank
from hapsim.errors import UsageError
from hapsim.holds import HOLDS
from hapsim.loop.force_history import ForceHistory
from hapsim.loop.guards.energy_guard import EnergyGuard
from hapsim.loop.guards.frozen_sensor import watch_sensor
from hapsim.loop.guards.leap import watch_for_leaps
from hapsim.loop.guards.slew import NO_LIMIT, shape_force
from hapsim.loop.guards.travel import NOISE_RMS, fade
from hapsim.prediction.force_bounds import ONE_PERIOD, SOFT_START_S, ForceBounds, below_a_count
from hapsim.prediction.timing import on_wire
from hapsim.scene import Scene

REFILL_S = 10.0  # the tank of live changes fills within this time


def set_leap(leap: Any, scene: Scene, description: Description) -> None:
    """Fills a LEAP by the scene's device or, where the mock lets a position go farther, by the mock."""
    device, mock, channels = scene.device, scene.mock_device, scene.channels
    watch_for_leaps(
        leap,
        rate_hz=scene.rate,
        by_host=device.clock == "host",
        mass=np.minimum([least for least, _ in device.mass_spans(channels)], mock.mass),
        friction=np.maximum(device.frictions(channels), mock.friction),
        stiffness=np.maximum(device.stiffnesses(channels), mock.stiffness),
        force=np.full(channels, device.force_limit + mock.coulomb),
        noise_m=mock.noise,
        count_m=np.array(description.position_scale[:channels]),
        scales=device.scales(channels),
    )


def set_travel(travel: Any, scene: Scene, description: Description) -> None:
    """Fills a TRAVEL, where the scene declares one."""
    if scene.device.travel is None:
        return
    used = slice(scene.channels)
    travel.low[:], travel.high[:] = -np.inf, np.inf
    travel.low[used], travel.high[used] = np.transpose(scene.device.travels(scene.channels))
    travel.margin[used] = scene.device.travel_margins(scene.channels)
    travel.unsure[used] = NOISE_RMS * scene.mock_device.noise + np.array(description.position_scale[used])
    travel.address, travel.fade = address_of(travel), fade.address()


def set_slew(loop: Any, scene: Scene, description: Description, bounds: ForceBounds) -> None:
    """Fills the SLEW of a LOOP, if it needs one. Raises UsageError where a step would be less than a count."""
    slew, is_limited = loop.slew, math.isfinite(bounds.slew_limit)
    if not is_limited and bounds.soft_start_s <= 0.0:
        return
    if is_limited and (why := below_a_count(scene, description.force_scale)):
        raise UsageError(why)
    with np.errstate(over="ignore"):
        counts = np.floor(bounds.slew_limit * scene.period / np.array(description.force_scale) * ONE_PERIOD)
    least = 1 if scene.device.slew_limit is None else 0  # a device of few counts has no finer step
    slew.step[: description.channels] = np.clip(counts, least, NO_LIMIT)
    slew.soft_samples, slew.lives = bounds.soft_start_s * scene.rate, loop.control.time_to_live
    slew.address, slew.shape = address_of(slew), shape_force.address()


def set_frozen_sensor(loop: Any, scene: Scene, description: Description, bounds: ForceBounds) -> None:
    """Fills the FROZEN_SENSOR of a LOOP."""
    device, channels, used = scene.device, scene.channels, slice(scene.channels)
    low, high = np.transpose(device.travels(channels))
    margin = np.array(device.travel_margins(channels)) if device.travel is not None else 0.0
    watch_sensor(
        loop.frozen_sensor,
        rate_hz=scene.rate,
        scales=device.scales(channels),
        mass=np.array([least for least, _ in device.mass_spans(channels)]),
        dry_friction=scene.mock_device.coulomb,
        force_limit=loop.io.force_limit[used],
        count=np.array(description.position_scale[used]),
        travel=np.array([low + margin, high - margin]),
        soft_start_s=bounds.soft_start_s or SOFT_START_S,
    )


def history_of(loop: Any, scene: Scene) -> ForceHistory:
    """Returns the history of the forces that acted, in the FORCE_HISTORY of `loop`, a LOOP."""
    device = on_wire(scene).device
    hold = HOLDS[device.hold]
    # The mean instant of a position that is averaged is half a sample earlier.
    shift = (0.5 if device.sampling == "average" else 0.0) + hold.mean_delay - 0.5
    return ForceHistory(loop.history, delay=device.delay + shift, keeps_last_force=hold.keeps_last_force)


def energy_guard_of(loop: Any, scene: Scene, bounds: ForceBounds) -> EnergyGuard | None:
    """Returns the energy guard of a scene, in the ENERGY_GUARD of `loop`, a LOOP; None where it is off."""
    limit_j, force_limit, scales = bounds.energy_limit, scene.device.force_limit, scene.device.scales(scene.channels)
    if not math.isfinite(limit_j):
        return None
    return EnergyGuard(
        loop.energy_guard,
        Tank(loop.tank, capacity_j=limit_j, refill_j=limit_j / (REFILL_S * scene.rate)),
        rate_hz=scene.rate,
        friction=np.array(scene.device.frictions(scene.channels)),
        limit_j=limit_j,
        usual_j=force_limit * min(one.energy for one in scales),
        credit_j=force_limit * max(one.credit for one in scales),
    )
