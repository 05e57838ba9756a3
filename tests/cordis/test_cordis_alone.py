"""A hand on a single link, which a tick works out in registers: the same as in memory, to the last bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hapsim.compiled import jit
from hapsim.cordis.program import Program, compile_scene, numbers_of, parameter_values
from hapsim.cordis.tick import settle_grounds, start, tick
from hapsim.scene import Scene

SAMPLES = 400
DAMPERS = ("backward", "centred", "filtered", "sensed")
LINKS: dict[str, dict[str, Any]] = {
    f"viscoelastic, {damper}": {"type": "viscoelastic", "stiffness": 800.0, "damping": 3.0, "damper": damper}
    | ({"cutoff": 80.0} if damper == "filtered" else {})
    for damper in DAMPERS
} | {
    "spring": {"type": "spring", "stiffness": 800.0},
    "damper": {"type": "damper", "damping": 3.0},
    "buffer": {"type": "buffer", "stiffness": 800.0, "damping": 3.0, "distance": 0.002},
    "friction": {"type": "friction", "force": 1.0, "stiffness": 3000.0, "damping": 1.0},
    "plectrum": {"type": "plectrum", "stiffness": 800.0, "release": 0.004},
    "nonlinear": {
        "type": "nonlinear",
        "force_over_distance": [[-0.01, -3.0], [0.0, 0.0], [0.01, 5.0]],
        "force_over_velocity": [[-0.1, -1.0], [0.1, 1.0]],
    },
}


@jit
def settle_compiled(program):
    settle_grounds(program)


def scene_of(link: dict[str, Any], **keys: Any) -> Scene:
    modules = {
        "hand": {"type": "device", "channel": 0},
        "wall": {"type": "ground", "position": 0.001},
        "link": {"between": ["hand", "wall"], **link},
    }
    return Scene.model_validate({"version": 1, "rate": 1000, "device": {"mass": 0.2}, "modules": modules, **keys})


def played(scene: Scene, channels: int) -> tuple[Program, np.ndarray]:
    """The hand trembles at the ground, which is moved twice; the force on it, sample by sample."""
    rng = np.random.default_rng(7)
    hand = 0.003 * np.sin(0.05 * np.arange(SAMPLES)) + 1e-4 * rng.normal(size=SAMPLES)
    values = parameter_values(scene)
    program = compile_scene(scene, values, channels)
    measured, velocity, force = np.zeros((3, channels))
    measured[0] = hand[0]
    start(program, measured)
    forces = np.empty(SAMPLES)
    ground = program.grounds.rest
    for n in range(SAMPLES):
        if n in (100, 101, 250, 251):
            ground[0] = -0.002 if n < 200 else 0.0015
            settle_compiled(program)
        measured[0], velocity[0] = hand[n], 1000.0 * (hand[n] - hand[n - 1])
        tick(program, measured, velocity, force)
        forces[n] = force[0]
    return program, forces


@pytest.mark.parametrize("name", LINKS)
def test_registers_hold_what_memory_would(name: str) -> None:
    scene = scene_of(LINKS[name])
    alone, forces = played(scene, channels=1)
    among_others, expected = played(scene, channels=2)
    assert alone.force is None
    assert among_others.force is not None
    assert np.ptp(forces) > 0.1
    np.testing.assert_array_equal(forces, expected)


def test_registers_hold_single_precision_too() -> None:
    scene = scene_of(LINKS["viscoelastic, backward"], precision="single")
    forces, expected = played(scene, channels=1)[1], played(scene, channels=2)[1]
    np.testing.assert_array_equal(forces, expected)
    assert not np.array_equal(forces, played(scene_of(LINKS["viscoelastic, backward"]), channels=1)[1])


@pytest.mark.parametrize(
    "more",
    [
        {"ball": {"type": "mass", "mass": 0.1}},
        {"second": {"type": "spring", "between": ["hand", "wall"], "stiffness": 1.0}},
        {"other": {"type": "device", "channel": 1}},
    ],
)
def test_whatever_has_more_than_that_has_forces_in_memory(more: dict[str, Any]) -> None:
    scene = scene_of(LINKS["spring"])
    modules = {name: module.model_dump() for name, module in scene.modules.items()} | more
    program = compile_scene(Scene.model_validate(scene.model_dump() | {"modules": modules}))
    assert program.force is not None
    assert program.force.size == program.rows.shape[1] == len(numbers_of(scene)) + len(more) - ("second" in more)
