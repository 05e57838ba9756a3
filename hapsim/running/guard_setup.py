"""Sets up the guards of a loop, from its scene and its device."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.description import Description
from hapsim.compiling.native import address_of
from hapsim.cordis.stored_energy import Tank
from hapsim.errors import UsageError
from hapsim.holds import HOLDS
from hapsim.loop.force_history import ForceHistory
from hapsim.loop.guards.energy_guard import FIRST_FORCE_M, EnergyGuard
from hapsim.loop.guards.frozen_sensor import watch_sensor
from hapsim.loop.guards.leap import watch_for_leaps
from hapsim.loop.guards.slew import NO_LIMIT, shape_force
from hapsim.loop.guards.travel import NOISE_RMS, fade
from hapsim.prediction.force_bounds import ONE_PERIOD, SOFT_START_S, ForceBounds, below_a_count
from hapsim.scene import Scene
from hapsim.scene.modules import Buffer, Click, Detent, Ground, Link, MaterialPoint, Module, Nonlinear, Structure

MOST_HELD_M = 10.0  # of travel at the force limit: the most energy that a scene counts as stored at the start
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
        motions=device.motions(channels),
        mass=np.array([least for least, _ in device.mass_spans(channels)]),
        dry_friction=scene.mock_device.coulomb,
        force_limit=loop.io.force_limit[used],
        count=np.array(description.position_scale[used]),
        travel=np.array([low + margin, high - margin]),
        soft_start_s=bounds.soft_start_s or SOFT_START_S,
    )


def history_of(loop: Any, scene: Scene) -> ForceHistory:
    """Returns the history of the forces that acted, in the FORCE_HISTORY of `loop`, a LOOP."""
    device = scene.device
    hold = HOLDS[device.hold]
    # The mean instant of a position that is averaged is half a sample earlier.
    shift = (0.5 if device.sampling == "average" else 0.0) + hold.mean_delay - 0.5
    return ForceHistory(loop.history, delay=device.delay + shift, keeps_last_force=hold.keeps_last_force)


def energy_guard_of(loop: Any, scene: Scene, description: Description, bounds: ForceBounds) -> EnergyGuard | None:
    """Returns the energy guard of a scene, in the ENERGY_GUARD of `loop`, a LOOP; None where it is off."""
    limit_j, force_limit = bounds.energy_limit, scene.device.force_limit
    if not math.isfinite(limit_j):
        return None
    return EnergyGuard(
        loop.energy_guard,
        Tank(loop.tank, capacity_j=limit_j, refill_j=limit_j / (REFILL_S * scene.rate)),
        rate_hz=scene.rate,
        friction=np.array(scene.device.frictions(scene.channels)),
        compliance=_compliance(scene, description.channels),
        force_limit=force_limit,
        limit_j=limit_j,
        held_j=held_energy(scene.modules, force_limit),
    )


def _compliance(scene: Scene, channels: int) -> NDArray[np.float64]:
    """(channels,) m/N: 1/K of all that is linked to each channel's device point; 0 where nothing is."""
    stiffness = np.zeros(channels)
    for point, module in scene.device_points.items():
        held = (link for link in scene.links.values() if point in link.between)
        stiffness[module.channel] += sum(float(getattr(link, "stiffness", 0.0)) for link in held)
    return np.divide(1.0, stiffness, out=np.zeros(channels), where=stiffness > 0.0)


def held_energy(modules: Mapping[str, Module], force_limit: float) -> float:
    """Returns the energy (J) that moving masses and stretched links store before any hand moves.

    It is at most MOST_HELD_M at the force limit: the guard would wait for ever for an energy without bounds. What a
    link at a device point stores is known with its first force only."""
    places = dict(_initial_places(modules))
    with np.errstate(over="ignore", invalid="ignore"):
        total = float(sum(_held_by(module, places, force_limit) for module in modules.values()))
    most = MOST_HELD_M * force_limit
    return total if total <= most else most  # also where the total is NaN


def _initial_places(modules: Mapping[str, Module]) -> Iterator[tuple[str, float]]:
    """Yields the initial position (m) of every point that no hand holds."""
    for name, module in modules.items():
        if isinstance(module, Ground):
            yield name, module.position
        elif isinstance(module, MaterialPoint):
            yield name, module.start()[0]
        elif isinstance(module, Structure):
            names = (f"{name}.{point}" for point in module.point_names())
            yield from zip(names, module.initial_positions(), strict=True)


def _held_by(module: Module, places: Mapping[str, float], force_limit: float) -> float:
    """Returns the energy (J) that a module stores with the points at `places` (m)."""
    if isinstance(module, MaterialPoint):
        position, velocity = module.start()
        held = module.held_by()
        spring = 0.0 if held is None else _of_spring(held.stiffness, position - held.rest)
        return 0.5 * module.mass * velocity * velocity + spring
    if isinstance(module, Structure):
        at = np.array(module.initial_positions())
        rest = float(getattr(module, "position", 0.0))
        if np.all(at == rest):
            return 0.0
        links = np.array(module.elements().links)
        ends = np.append(at, rest)[links[:, :2].astype(int)]  # -1 is what stays
        return float(np.sum(_of_spring(np.abs(links[:, 2]), ends[:, 0] - ends[:, 1])))
    if isinstance(module, Link) and all(end in places for end in module.between):
        first, second = (places[end] for end in module.between)
        if isinstance(module, Nonlinear | Detent | Click):
            return FIRST_FORCE_M * force_limit
        apart = min(first - second - module.distance, 0.0) if isinstance(module, Buffer) else first - second
        return _of_spring(float(getattr(module, "stiffness", 0.0)), apart)
    return 0.0


def _of_spring(stiffness: Any, stretched: Any) -> Any:
    return 0.5 * stiffness * stretched * stretched
