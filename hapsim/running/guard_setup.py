"""Sets up the slew limit, the force history and the energy guard of a loop, from its scene and its device."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.description import Description
from hapsim.cordis.stored_energy import Tank
from hapsim.errors import UsageError
from hapsim.holds import HOLDS
from hapsim.loop.force_history import ForceHistory
from hapsim.loop.guards.energy_guard import CREDIT_M, FIRST_FORCE_M, LATE_M, EnergyGuard
from hapsim.loop.guards.slew import limit_slew
from hapsim.prediction.force_bounds import ENERGY_M, ONE_PERIOD, ForceBounds, below_a_count
from hapsim.scene import Scene
from hapsim.scene.modules import Buffer, Ground, Link, MaterialPoint, Module, Nonlinear, Structure

MOST_HELD_M = 10.0  # of travel at the force limit: the most energy that a scene counts as stored at the start
REFILL_S = 10.0  # the tank of live changes fills within this time


def set_slew(loop: Any, scene: Scene, description: Description, bounds: ForceBounds) -> None:
    """Fills the SLEW of `loop`, a LOOP. Raises UsageError where a step would be less than a count of the force."""
    steps = None
    if math.isfinite(bounds.slew_limit):
        scale = np.array(description.force_scale)
        with np.errstate(over="ignore"):
            counts = np.floor(bounds.slew_limit * scene.period / scale * ONE_PERIOD)
        steps = np.minimum(counts, 2.0**40).astype(np.int64)
        if scene.device.slew_limit is None:
            steps = np.maximum(steps, 1)  # a device of few counts has no finer step
        elif why := below_a_count(scene, description.force_scale):
            raise UsageError(why)
    limit_slew(
        loop.slew,
        step_counts=steps,
        soft_samples=bounds.soft_start_s * scene.rate,
        lives_samples=int(loop.control.time_to_live),
        channels=description.channels,
    )


def history_of(loop: Any, scene: Scene) -> ForceHistory:
    """Returns the history of the forces that acted, in the FORCE_HISTORY of `loop`, a LOOP."""
    device = scene.device
    hold = HOLDS[device.hold]
    # The mean instant of a position that is averaged is half a sample earlier.
    shift = (0.5 if device.sampling == "average" else 0.0) + hold.mean_delay - 0.5
    return ForceHistory(loop.history, delay=device.delay + shift, keeps_last_force=hold.keeps_last_force)


def energy_guard_of(loop: Any, scene: Scene, description: Description, bounds: ForceBounds) -> EnergyGuard | None:
    """Returns the energy guard of a scene, in the ENERGY of `loop`, a LOOP; None where it is off."""
    if not math.isfinite(bounds.energy_limit):
        return None
    device = scene.device
    return EnergyGuard(
        loop.energy_guard,
        rate_hz=scene.rate,
        friction=np.array(device.frictions(scene.channels)),
        compliance=_compliance(scene, description.channels),
        limit_j=bounds.energy_limit,
        swing_limit_j=min(bounds.energy_limit, ENERGY_M * device.force_limit),
        late_limit_j=max(bounds.energy_limit, LATE_M * device.force_limit),
        credit_j=CREDIT_M * device.force_limit,
        held_j=held_energy(scene.modules, device.force_limit),
        tank=Tank(loop.tank, capacity_j=bounds.energy_limit, refill_j=bounds.energy_limit / (REFILL_S * scene.rate)),
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
    total = 0.0
    for module in modules.values():
        if isinstance(module, MaterialPoint):
            position, velocity = module.start()
            total += 0.5 * module.mass * velocity * velocity
            held = module.held_by()
            total += 0.0 if held is None else _of_spring(held.stiffness, position - held.rest)
        elif isinstance(module, Structure):
            total += _held_by_structure(module)
        elif isinstance(module, Link) and all(end in places for end in module.between):
            first, second = (places[end] for end in module.between)
            total += _held_by_link(module, first - second, force_limit)
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


def _held_by_structure(structure: Structure) -> float:
    at = np.array(structure.initial_positions())
    rest = float(getattr(structure, "position", 0.0))
    if not np.ptp(at) and at[0] == rest:
        return 0.0
    links = np.array([(first, second, abs(stiffness)) for first, second, stiffness, _ in structure.elements().links])
    ends = np.append(at, rest)[links[:, :2].astype(int)]  # -1 is what stays
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sum(0.5 * links[:, 2] * (ends[:, 0] - ends[:, 1]) ** 2))


def _held_by_link(link: Link, apart: float, force_limit: float) -> float:
    if isinstance(link, Nonlinear):
        return FIRST_FORCE_M * force_limit
    if isinstance(link, Buffer):
        apart = min(apart - link.distance, 0.0)
    return _of_spring(float(getattr(link, "stiffness", 0.0)), apart)


def _of_spring(stiffness: float, stretched: float) -> float:
    return 0.5 * stiffness * stretched * stretched
