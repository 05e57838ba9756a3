"""Stored energy at arming: at most the energy that a hand can gain, and none from modules that no hand touches."""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop_rig import POSITION_SCALE, arrive, assembled, frame, run_with_loop

from hapsim.errors import DeviceError, GuardError
from hapsim.loop.guards.energy_guard import MOST_STORED
from hapsim.prediction.characteristic import characteristic_of
from hapsim.running import run
from hapsim.running.session_options import RunOptions
from hapsim.scales import SCALES
from hapsim.scene import Scene, parse_scene
from tests import one_hand

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools" / "bench"))

from wheels import passive_wheels, unstable_wheels

Modules = dict[str, dict[str, Any]]
LIMIT = 10.0
CREDIT = SCALES["linear"].credit
WALL = {"between": ["hand", "wall"]}
GIVES: Modules = {
    "pull": WALL | {"type": "nonlinear", "force_over_velocity": [[-0.3, 3.0], [-0.1, -0.2], [0.1, 0.2], [0.3, -3.0]]}
}
LONE: Modules = {
    "ball": {"type": "mass", "mass": 0.5, "velocity": 4.0, "position": 0.1},
    "tied": {"type": "spring", "between": ["ball", "wall"], "stiffness": 200.0},
    "stop": {"type": "buffer", "between": ["ball", "wall"], "stiffness": 1000.0, "distance": 0.3},
    "table": {"type": "nonlinear", "between": ["ball", "wall"], "force_over_distance": [[-1.0, -5.0], [1.0, 5.0]]},
    "notch": {"type": "detent", "between": ["ball", "wall"], "pitch": 0.01, "depth": 0.001},
    "click": {"type": "click", "between": ["ball", "wall"], "travel": 0.01, "peak": 1.0, "drop": 0.5, "bottom": 900.0},
    "rub": {"type": "friction", "between": ["ball", "wall"], "force": 0.5, "stiffness": 300.0},
    "grip": {"type": "plectrum", "between": ["ball", "wall"], "stiffness": 500.0, "release": 0.5},
    "cell": {"type": "cell", "mass": 0.1, "stiffness": 50.0, "rest": 0.0, "position": 0.2},
    "gut": {"type": "string", "masses": 3, "mass": 0.01, "stiffness": 100.0, "pluck": {"at": 1, "by": 0.02}},
    "skin": {"type": "membrane", "rows": 3, "columns": 3, "mass": 0.01, "stiffness": 100.0, "position": 0.1},
}


def scene_of(modules: Modules, friction: float = 0.1, **mock: Any) -> Scene:
    device = {"friction": friction, "force_limit": LIMIT, "delay": 0}
    return one_hand.scene_of(modules, device=device, mock={"initial": mock})


def judged(scene: Scene, duration: float) -> tuple[str, int, float]:
    """(the ending, how many ticks, J that the scene held)."""
    sessions: list[Any] = []
    try:
        trace = run(scene, duration=duration, judges_energy=True, unstable=True, on_start=sessions.append)
    except GuardError as error:
        trace = error.trace  # type: ignore[assignment]
    return trace.report.ending, trace.report.ticks, float(sessions[0]._loop.record.tick.held)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("many", [1, 5])
def test_what_no_hand_touches_lends_nothing(many: int) -> None:
    """Modules that no hand touches add no energy, whatever their kind and number."""
    lone: Modules = {}
    for n in range(many):
        for name, module in LONE.items():
            ends = [f"{end}{n}" if end in LONE else end for end in module.get("between", ())]
            lone[f"{name}{n}"] = module | ({"between": ends} if ends else {})
    alone = judged(scene_of(GIVES, velocity=0.5), 3.0)
    assert (alone[0], alone[2]) == ("scene diverging", 0.0)
    assert judged(scene_of(GIVES | lone, velocity=0.5), 3.0) == alone


def test_what_a_hand_touches_lends_all_that_it_holds() -> None:
    kept = ("ball", "tied", "stop", "cell", "gut")
    joined: Modules = {
        f"to_{name}": {"type": "damper", "between": ["hand", point], "damping": 0.01}
        for name, point in (("ball", "ball"), ("cell", "cell"), ("gut", "gut.1"))
    }
    string = 4 * 0.5 * 100.0 * 0.01**2
    held = 0.5 * 0.5 * 16.0 + 0.5 * 200.0 * 0.01 + 0.5 * 1000.0 * 0.04 + 0.5 * 50.0 * 0.04 + string
    assert judged(scene_of({name: LONE[name] for name in kept} | joined), 0.001)[2] == pytest.approx(held)


LINKS: Modules = {
    "spring": WALL | {"type": "spring", "stiffness": 300.0},
    "buffer": WALL | {"type": "buffer", "stiffness": 5000.0, "distance": 0.01},
    "table": WALL
    | {"type": "nonlinear", "force_over_distance": [[-0.2, -4.0], [-0.01, -9.0], [0.03, 2.0], [0.2, 9.0]]},
    "sine": WALL | {"type": "detent", "pitch": 0.03, "depth": 2.0},
    "snap": WALL | {"type": "detent", "pitch": 0.03, "depth": 2.0, "shape": "snap", "sharpness": 3.0},
    "click": WALL | {"type": "click", "travel": 0.01, "peak": 3.0, "drop": 1.0, "bottom": 2000.0},
    "plectrum": WALL | {"type": "plectrum", "stiffness": 400.0, "release": 0.1},
}


@pytest.mark.parametrize("kind", [one for one in LINKS if one != "plectrum"])
def test_a_link_at_a_hand_lends_what_its_force_does_on_the_way_to_its_least(kind: str) -> None:
    scene = scene_of({"held": LINKS[kind]})
    hand = characteristic_of(scene, "hand")
    assert hand is not None
    x = np.linspace(-0.15, 0.15, 30_001)
    force = np.clip(-hand.force(x), -LIMIT, LIMIT)
    does = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(x))])
    for at in (-0.05, -0.0187, -0.004, 0.0, 0.0112, 0.06):
        loop = assembled(scene, options=RunOptions(judges_energy=True))
        arrive(loop, frame(0, round(at / POSITION_SCALE)), 0)
        holds = float(np.max(does) - np.interp(at, x, does))
        assert float(loop.record.tick.held) == pytest.approx(holds, abs=1e-6 * LIMIT), at


@pytest.mark.parametrize("kind", LINKS)
@pytest.mark.parametrize("at", [-0.08, 0.05])
def test_what_is_wound_up_at_arming_is_no_scene_that_gives(kind: str, at: float) -> None:
    """Whatever it asks for, some of them for more than the limit at once, with the friction that the stiffest needs."""
    scene = scene_of({"held": LINKS[kind], "soft": LINKS["spring"]}, friction=3.0, position=at)
    assert judged(scene, 2.0)[0] == "done"


@pytest.mark.parametrize("far", [1e3, 1e12])
def test_an_endless_store_lends_up_to_ten_metres_at_the_force_limit(far: float) -> None:
    assert MOST_STORED * CREDIT == 10.0
    ball: Modules = {"ball": {"type": "mass", "mass": 0.5, "velocity": far}, "touch": LINKS["spring"]}
    linked = {"to_ball": {"type": "damper", "between": ["hand", "ball"], "damping": 1e-9}}
    _, loop = run_with_loop(scene_of(ball | linked), duration=0.001, judges_energy=True, unstable=True)
    assert float(loop.record.energy_guard.given[0]) == -10.0 * LIMIT


FEW = 12
drawn = cache(lambda wheels, number: [*wheels(number, seed=3)])


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("number", range(FEW))
def test_no_passive_wheel_is_stopped(number: int) -> None:
    wheel = drawn(passive_wheels, FEW)[number]
    assert judged(wheel.scene, wheel.duration)[0] == "done"


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("number", range(FEW // 2))
def test_a_wheel_that_diverges_is_ended(number: int) -> None:
    wheel = drawn(unstable_wheels, FEW // 2)[number]
    ending, ticks, _ = judged(wheel.scene, 20.0)
    deep = wheel.kind == "detent" and wheel.scene.modules["held"].depth <= wheel.scene.device.force_limit
    assert deep or (ending == "scene diverging" and ticks < 20.0 * wheel.scene.rate)


def test_a_position_at_the_end_of_its_counts_is_named() -> None:
    document = scene_of({"rub": WALL | {"type": "damper", "damping": 1e-6}}, velocity=10.0).model_dump(
        mode="json", exclude_none=True
    )
    document["device"] |= {"motion": "rotary"}
    document["mock"] |= {"quantum": 1e-9}
    with pytest.raises(DeviceError, match=r"count is at its end on channel 0 \(±2.147 rad at 1e-09 rad per count\)"):
        run(parse_scene(json.dumps(document)), duration=1.0)
