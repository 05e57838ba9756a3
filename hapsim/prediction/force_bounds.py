"""What bounds the force beside its limit: how fast it changes, how it begins, how much energy it gives.

Where a hand may hold the device, behind a port, each has a value when the scene names none. Before the mock, and in
virtual time, there is no hand, and every prediction is of a force that nothing shapes: there each holds where the scene
names it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hapsim.scene import Scene

RISE_S = 1e-3  # from zero to the force limit, or a sample period where that is longer
SOFT_START_S = 0.05
ENERGY_M = 0.02  # of travel at the force limit


class ForceBounds(NamedTuple):
    """Of a run."""

    slew_limit: float
    """N/s; infinity: none."""
    soft_start_s: float
    """s; 0: none."""
    energy_limit: float
    """J; infinity: none."""


def force_bounds(
    scene: Scene, *, in_hand: bool, judges_energy: bool = False, force_limit: float | None = None
) -> ForceBounds:
    """Those of a scene before a device that a hand may hold, or before the mock. `judges_energy`: the energy has a
    limit before the mock too; `force_limit`: N, where the device's own is less than the scene's."""
    device = scene.device
    most = device.force_limit if force_limit is None else min(force_limit, device.force_limit)
    slew, soft, energy = device.slew_limit, device.soft_start, device.energy_limit
    if slew is None:
        slew = most / max(RISE_S, scene.period) if in_hand else math.inf
    if soft is None:
        soft = SOFT_START_S if in_hand else 0.0
    if energy is None:
        energy = ENERGY_M * most if in_hand or judges_energy else math.inf
    return ForceBounds(slew, soft, energy)


def run_bounds(scene: Scene) -> ForceBounds:
    """Those of `hapsim run`, where the scene says that its device is."""
    in_hand = scene.device.port is not None and scene.device.clock != "lockstep"
    return force_bounds(scene, in_hand=in_hand, judges_energy=True)
