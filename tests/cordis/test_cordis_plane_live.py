"""Scenes with two coordinates: what live changes add, other programs that take over, and substeps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of
from hapsim.cordis.offline import take_over, update_parameters
from hapsim.cordis.program import Program, compile_scene, parameter_values, positions_of
from hapsim.cordis.stored_energy import TANK, StoredEnergy, Tank, evaluate
from hapsim.cordis.succession import take_over_from
from hapsim.scene import Scene

from .plane_scenes import RATE, Floats, forces, line, moved, scene_of, shape

LIMIT = 1e6  # N

#: A link between hand and post, a path of the hand, and the stored energy at its end, J.
STORED: dict[str, tuple[dict[str, Any], Floats, float]] = {
    "spring": (
        {"type": "spring", "stiffness": 300.0, "length": 0.03},
        line([0.02, 0.0], [0.0, 0.05], 50),
        150.0 * 0.02**2,
    ),
    "spring through the post": (
        {"type": "spring", "stiffness": 300.0, "length": 0.03},
        line([0.02, 0.0], [-0.01, 0.0], 500),
        150.0 * 0.04**2,
    ),
    "loose spring": ({"type": "spring", "stiffness": 300.0}, line([0.02, 0.0], [-0.01, 0.01], 50), 150.0 * 2e-4),
    "buffer": ({"type": "buffer", "stiffness": 300.0, "distance": 0.03}, line([0.04, 0.0], [0.012, 0.016], 50), 0.015),
    "buffer apart": ({"type": "buffer", "stiffness": 300.0, "distance": 0.03}, line([0.04, 0.0], [0.0, 0.05], 50), 0.0),
    "curve": (
        {"type": "nonlinear", "force_over_distance": [[0.0, 0.0], [0.02, 4.0]]},
        line([0.01, 0.0], [0.0, 0.01], 50),
        0.5 * 2.0 * 0.01,
    ),
    "plectrum": (
        {"type": "plectrum", "stiffness": 300.0, "release": 0.1},
        line([0.01, 0.0], [0.0, 0.01], 50),
        150.0 * 1e-4,
    ),
    "plectrum released": (
        {"type": "plectrum", "stiffness": 300.0, "release": 0.02},
        line([0.01, 0.0], [0.0, 0.03], 50),
        0.0,
    ),
    "bristle": (
        {"type": "friction", "stiffness": 300.0, "force": 50.0},
        line([0.01, 0.0], [0.0, 0.01], 50),
        150.0 * 2e-4,
    ),
    "bristle that slides": (
        {"type": "friction", "stiffness": 300.0, "force": 0.6},
        line([0.01, 0.0], [0.0, 0.01], 50),
        0.5 * 0.6**2 / 300.0,
    ),
    "shape": (shape({"disc": 0.02}), line([0.03, 0.0], [0.0108, 0.0144], 100), 1000.0 * 0.002**2),
    "shape apart": (shape({"disc": 0.02}), line([0.01, 0.0], [0.03, 0.0], 100), 0.0),
    "shape with friction": (
        shape({"half_plane": [0.0, 1.0]}, friction_coefficient=1.0),
        np.vstack([line([0.0, 1e-3], [0.0, -2e-3], 60), line([0.0, -2e-3], [1e-3, -2e-3], 20)]),
        1000.0 * 0.002**2 + 500.0 * 0.001**2,
    ),
    "shape that rubs": (
        shape({"half_plane": [0.0, 1.0]}, friction_coefficient=0.1),
        np.vstack([line([0.0, 1e-3], [0.0, -2e-3], 60), line([0.0, -2e-3], [9e-3, -2e-3], 90)]),
        1000.0 * 0.002**2 + 0.5 * (0.1 * 4.0) ** 2 / 1000.0,
    ),
    "guide": (
        {"type": "guide", "through": [[0.0, 0.0], [0.1, 0.0]], "stiffness": 800.0, "width": 0.002, "reach": 0.01},
        line([0.02, 0.0], [0.05, -0.004], 50),
        400.0 * 0.003**2,
    ),
    "guide released": (
        {"type": "guide", "through": [[0.0, 0.0], [0.1, 0.0]], "stiffness": 800.0, "width": 0.002, "reach": 0.01},
        line([0.02, 0.0], [0.05, -0.014], 50),
        0.0,
    ),
}


def account(program: Program, scene: Scene) -> tuple[StoredEnergy, Any]:
    tank = new_record(TANK)
    Tank(tank, capacity_j=1e-3, refill_j=0.0)
    return StoredEnergy(program, scene, tank, LIMIT), tank


def energy(program: Program, stored: StoredEnergy, way: int = 0) -> float:
    here, before = positions_of(program)
    record: Any = stored._record
    return float(evaluate(address_of(record), address_of(here), address_of(before), way))


@pytest.mark.thorough(keep=10)
@pytest.mark.parametrize("name", STORED)
@pytest.mark.parametrize("precision", ["double", "single"])
def test_the_stored_energy_of_a_link(name: str, precision: str) -> None:
    link, path, expected = STORED[name]
    scene = scene_of({"it": link}, precision=precision)
    program = compile_scene(scene)
    stored, _ = account(program, scene)
    path = np.vstack([path, path[-1:]])
    moved(program, path)
    assert energy(program, stored) == pytest.approx(expected, rel=1e-9 if precision == "double" else 1e-3, abs=1e-12)


def test_the_kinetic_energy_of_a_mass_is_that_of_both_coordinates() -> None:
    ball = {"type": "mass", "mass": 0.05, "position": [0.02, 0.01], "velocity": [0.3, -0.4]}
    scene = scene_of({"ball": ball, "it": {"type": "damper", "damping": 0.0, "between": ["hand", "ball"]}})
    program = compile_scene(scene)
    stored, _ = account(program, scene)
    moved(program, np.zeros((3, 2)))
    assert energy(program, stored) == pytest.approx(0.5 * 0.05 * 0.25)


@pytest.mark.parametrize("name", ["spring", "shape", "guide", "shape with friction"])
def test_a_stiffness_that_ramps_adds_no_more_than_the_tank_holds(name: str) -> None:
    link, path, before = STORED[name]
    scene = scene_of({"it": link})
    program = compile_scene(scene)
    stored, tank = account(program, scene)
    moved(program, np.vstack([path, path[-1:]]))  # the second row of positions has the hand, too
    stiff = scene_of({"it": dict(link) | {"stiffness": 100.0 * link["stiffness"]}})
    program.parameters.post(parameter_values(stiff), 50)
    for _ in range(200):
        update_parameters(program)
        moved(program, path[-1:], begin=False)
    moved(program, path[-1:], begin=False)
    assert tank.slowed_ticks > 0
    assert energy(program, stored) - before == pytest.approx(1e-3, rel=1e-6)
    assert tank.spent == pytest.approx(1e-3, rel=1e-6)


def test_a_ground_moves_in_the_plane_while_a_scene_runs() -> None:
    spring = {"type": "spring", "stiffness": 300.0}
    scene = scene_of({"it": spring})
    program = compile_scene(scene)
    assert {("post.x", "position"), ("post.y", "position"), ("it", "stiffness")} == program.places.keys()
    moved(program, np.zeros((1, 2)))
    there = scene_of({"post": {"type": "ground", "position": [0.01, -0.02]}, "it": spring})
    program.parameters.post(parameter_values(there), 10)
    for _ in range(12):
        update_parameters(program)
        force = moved(program, np.zeros((1, 2)), begin=False)
    assert force[0] == pytest.approx([3.0, -6.0])


def test_another_program_goes_on_with_the_memory_of_common_links() -> None:
    """Pressed through a thin wall and a point, with a bent bristle: the same forces, unless the form is another."""
    ball = {"type": "mass", "mass": 0.05, "position": [0.02, 0.01], "velocity": [0.3, -0.4]}
    wall = shape({"capsule": [[-0.02, 0.0], [0.02, 0.0]], "radius": 0.001}, friction_coefficient=0.3)
    modules = {
        "wall": wall,
        "ball": ball,
        "hit": {"type": "buffer", "stiffness": 300.0, "distance": 0.01},
        "rope": {"type": "viscoelastic", "stiffness": 30.0, "length": 0.01, "between": ["hand", "ball"]},
        "rub": {"type": "friction", "stiffness": 300.0, "force": 50.0},
        "touch": {"type": "spring", "stiffness": 300.0, "length": 0.02},
    }
    path = np.vstack([line([0.0, 0.01], [0.0, -0.003], 200), line([0.0, -0.003], [1e-5, -0.003], 20)])
    for other, same in ((wall, True), (wall | {"form": {"disc": 0.001}}, False)):
        older_scene = scene_of(modules)
        later = scene_of({"more": {"type": "damper", "damping": 0.1}} | modules | {"wall": other})
        older, program, alone = compile_scene(older_scene), compile_scene(later), compile_scene(older_scene)
        moved(older, path)
        moved(alone, path)
        take_over_from(older, older_scene, program, later)
        take_over(older, program, path[-1])
        expected = moved(alone, path[-1:], begin=False)
        found = moved(program, path[-1:], begin=False)
        assert (found == pytest.approx(expected, abs=1e-9)) is same
        here, there = positions_of(program)[0], positions_of(older)[0]
        for axis in "xy":
            assert here[program.numbers[f"ball.{axis}"]] != there[older.numbers[f"ball.{axis}"]]


def test_substeps_are_ticks_at_their_own_rate() -> None:
    """A damper and a mass in a scene with ten substeps are those of a scene at ten times the rate."""
    modules = {
        "ball": {"type": "mass", "mass": 0.05, "position": [0.02, 0.01]},
        "rope": {"type": "viscoelastic", "stiffness": 90.0, "damping": 0.2, "between": ["hand", "ball"]},
        "wall": shape({"disc": 0.01}, damping=2.0, friction_coefficient=0.3) | {"between": ["ball", "post"]},
    }
    path = np.repeat(line([0.0, 0.02], [0.0, 0.01], 40), 10, axis=0)
    many = forces(modules, path, substeps=10)
    fast = forces(modules, path, rate=10.0 * RATE)
    assert many == pytest.approx(fast, abs=1e-12)
    assert math.hypot(*many[-1]) > 0.1
