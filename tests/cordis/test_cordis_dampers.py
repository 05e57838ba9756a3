"""Each damper twice: its recurrence in the kernel against the one that the theory has."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene
from hapsim.dampers import DAMPERS
from hapsim.scene import WITH_CUTOFF, Scene, parse_scene

RATE, CUTOFF = 1000.0, 70.0
K, B = 300.0, 2.0


def scene(damper: str, between: str = "[hand, wall]", more: str = "") -> Scene:
    cutoff = f", cutoff: {CUTOFF}" if damper in WITH_CUTOFF else ""
    return parse_scene(
        f"version: 1\nrate: {RATE}\ndevice: {{mass: 0.2}}\nmodules:\n  hand: {{type: device, channel: 0}}\n"
        f"  wall: {{type: ground}}\n{more}"
        f"  touch: {{type: viscoelastic, between: {between}, stiffness: {K}, damping: {B}, damper: {damper}{cutoff}}}\n"
    )


def forces(which: Scene, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    program = compile_scene(which)
    force = np.zeros(1)
    start(program, position[:1])
    result = []
    for x, v in zip(position, velocity, strict=True):
        tick(program, np.array([x]), np.array([v]), force)
        result.append(force[0])
    return np.array(result)


@pytest.mark.parametrize("name", DAMPERS)
def test_a_mass_that_is_under_way_is_so_from_the_first_tick_on(name: str) -> None:
    """Nothing pulls it but a damper to a hand at rest: no scheme starts with a jerk of its own."""
    moving = "  m: {type: mass, mass: 1.0e9, position: 0.0, velocity: 0.1}\n"
    which = scene(name, "[m, hand]", moving)
    pulled = forces(which, np.zeros(5), np.zeros(5))
    n = np.arange(5)
    np.testing.assert_allclose(pulled, K * 0.1 * n / RATE + B * 0.1, rtol=1e-9)


def test_an_end_without_a_sensor_has_its_velocity_from_its_positions() -> None:
    moving = "  m: {type: mass, mass: 1.0e9, position: 0.0, velocity: 0.1}\n"
    pulled = forces(scene("sensed", "[m, hand]", moving), np.zeros(3), np.full(3, 0.25))
    np.testing.assert_allclose(pulled, K * 0.1 * np.arange(3) / RATE + B * (0.1 - 0.25), rtol=1e-9)
