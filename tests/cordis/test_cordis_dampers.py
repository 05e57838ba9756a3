"""Each damper twice: its recurrence in the kernel against the one that the theory has."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene
from hapsim.dampers import DAMPERS
from hapsim.scene import WITH_CUTOFF, Scene, parse_scene
from hapsim.theory.interface import damper_named

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


def cutoff_of(damper: str) -> float | None:
    return CUTOFF if damper in WITH_CUTOFF else None


@pytest.mark.parametrize("name", DAMPERS)
def test_the_recurrence_is_the_one_that_the_theory_has(name: str) -> None:
    damper = damper_named(name, cutoff_of(name), RATE)
    y = 1e-3 * np.cumsum(np.random.default_rng(3).normal(size=300))
    sensed = np.random.default_rng(4).normal(size=300)
    v = np.zeros(300)
    for n in range(300):
        # The hand was at rest where it starts.
        past = [y[max(n - i, 0)] for i in range(len(damper.of_positions))]
        past_v = [v[n - 1 - j] if n > j else 0.0 for j in range(len(damper.of_velocities))]
        v[n] = np.dot(damper.of_positions, past) + np.dot(damper.of_velocities, past_v)
    speed = sensed if damper.senses else RATE * v
    np.testing.assert_allclose(forces(scene(name), y, sensed), -(K * y + B * speed), rtol=1e-12, atol=1e-12)


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
