"""Walls that meet: a hand is not pressed through a joint, and is not pushed twice where two overlap."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.cordis.program import compile_scene
from hapsim.prediction.plane_geometry import Plane
from hapsim.scene import Scene
from tests import thorough
from tests.cordis.plane_scenes import moved, scene_of
from tests.plane_mazes import LOOP_J, OFF_M, OUT_M, SWING_M, pressed, thrown, worked


def wall(begin: tuple[float, float], end: tuple[float, float], **more: Any) -> dict[str, Any]:
    return {
        "type": "shape",
        "form": {"capsule": [list(begin), list(end)], "radius": 0.001},
        "stiffness": 600.0,
        "damping": 1.0,
        **more,
    }


def room(corners: int, **more: Any) -> dict[str, Any]:
    """A closed room of as many thin walls."""
    at = [
        (0.03 * math.cos(2.0 * math.pi * i / corners), 0.03 * math.sin(2.0 * math.pi * i / corners))
        for i in range(corners)
    ]
    return {f"w{i}": wall(at[i], at[(i + 1) % corners], **more) for i in range(corners)}


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("corners", [3, 4, 6])
def test_a_hand_that_is_pressed_into_any_corner_of_thin_walls_stays_in_the_room(corners: int, friction: float) -> None:
    """It is pressed by up to 10 mm, and thrown; a wall is 2 mm thick."""
    random = np.random.default_rng(corners)
    for trial in range(4):
        towards = 2.0 * math.pi * trial / corners + random.normal(0.0, 0.1)
        thrown = random.uniform(-0.3, 0.3, 2)
        scene = Scene.model_validate(
            {
                "version": 1,
                "rate": 1000.0,
                "space": 2,
                "device": {"mass": 0.3, "friction": 2.0, "clock": "lockstep", "force_limit": 20.0},
                "mock": {
                    "initial": {"velocity": thrown.tolist()},
                    "noise": 1e-6,
                    "hand": {"force": [6.0 * math.cos(towards), 6.0 * math.sin(towards)]},
                },
                "modules": {
                    "hand": {"type": "device", "channels": [0, 1]},
                    "post": {"type": "ground"},
                    **{
                        name: one | {"between": ["hand", "post"]}
                        for name, one in room(corners, friction_coefficient=friction).items()
                    },
                },
            }
        )
        trace = hapsim.run(scene, duration=3.0)
        assert np.hypot(*trace.position[-1]) < 0.03 + 0.011
        assert np.ptp(trace.position[-100:], axis=0).max() < 1e-4


MAZES = thorough.points(6, 20)
"""tools/bench/joints has 2000."""


@pytest.mark.thorough
def test_hands_pressed_against_random_mazes_rest_where_the_referee_has_them() -> None:
    rested = 0
    for press in filter(None, map(pressed, range(MAZES))):
        if press.own_swing < SWING_M and not press.leaves:
            rested += 1
            if press.swing >= SWING_M:
                assert not hapsim.predict(press.scene, with_margins=False, at=press.end).stable_as_taken
            else:
                assert press.off <= OFF_M
    assert rested > 0.3 * MAZES


def test_walls_that_meet_give_no_work_on_a_closed_way() -> None:
    works = [work for seed in range(MAZES) for work in worked(seed)]
    assert len(works) > 0.5 * MAZES
    assert max(works) <= LOOP_J


@pytest.mark.parametrize("seeds", [range(MAZES), (257, 491, 1431)], ids=["any", "beyond a wall as a contact ends"])
def test_no_hand_that_moves_less_than_the_thickness_in_a_sample_leaves_a_room(seeds: range) -> None:
    assert max(map(thrown, seeds)) <= OUT_M


@pytest.mark.parametrize("degrees", [40.0, 90.0, 140.0])
def test_two_walls_push_to_the_corner_where_they_meet(degrees: float) -> None:
    """A hand slides along one wall into the other, whatever the angle: nothing jumps, and both share its way out."""
    angle = math.radians(degrees)
    flat, steep = (
        wall((0.0, 0.0), (0.04, 0.0), damping=0.0),
        wall((0.0, 0.0), (0.04 * math.cos(angle), 0.04 * math.sin(angle)), damping=0.0),
    )
    scene = scene_of({"flat": flat, "steep": steep})
    corner = 0.001 / math.tan(0.5 * angle), 0.001
    depth = 0.0006
    ways = np.linspace(0.01, corner[0] - 0.3 * depth, 4000)
    begin = np.column_stack([np.full(200, 0.01), np.linspace(0.002, corner[1] - depth, 200)])
    path = np.vstack([begin, np.column_stack([ways, np.full(4000, corner[1] - depth)])])
    force = moved(compile_scene(scene), path)
    steps = np.hypot(*np.diff(force[200:], axis=0).T)
    assert steps.max() < 600.0 * (ways[0] - ways[1]) * 1.5
    np.testing.assert_allclose(force[-1], 600.0 * (np.array(corner) - path[-1]), atol=1e-6)


def test_a_prediction_shares_the_way_out_as_the_kernel_does() -> None:
    random, both = np.random.default_rng(3), 0
    scene = scene_of(
        {"a": wall((0.0, 0.0), (0.04, 0.0), damping=0.0), "b": wall((0.0, 0.0), (0.02, 0.03), damping=0.0)}
    )
    plane = Plane(scene)
    for _ in range(60):
        place = np.array([0.00188, 0.001]) + random.uniform(-0.0005, 0.0005, 2)
        from_inside = np.linspace([0.03, 0.012], place, 3000)
        force = moved(compile_scene(scene), np.vstack([from_inside, np.tile(place, (3, 1))]))[-1]
        links = plane.at({"hand": (float(place[0]), float(place[1]))})
        expected = -sum(one.tension * np.array(one.normal) for one in links)
        both += sum(one.tension != 0.0 for one in links) > 1
        np.testing.assert_allclose(force, expected, atol=1e-6)
    assert both > 5
