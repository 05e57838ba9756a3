"""A hand behind a virtual coupling in virtual time: what it feels is what the theory predicts."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from hapsim import predict
from hapsim.measuring.measure import measure
from hapsim.running.run import run_in_memory
from hapsim.scene import Scene, parse_scene

CUP = {"type": "proxy", "hand": "hand", "mass": 0.02, "stiffness": 769.8, "damping": 0.2818}
PULLED = {"type": "spring", "between": ["hand", "far"], "stiffness": 200.0}


def at_wall(kind: str, **values: float) -> dict[str, Any]:
    return {"type": kind, "between": ["cup", "wall"]} | values


BEHIND: dict[str, dict[str, Any]] = {
    "free": {},
    "spring and damper": {"touch": at_wall("viscoelastic", stiffness=500.0, damping=1.0)},
    # A spring presses the hand into the contact, from 3 cm away, and no push lifts it off.
    "contact": {"touch": at_wall("buffer", stiffness=2000.0, damping=3.0), "press": PULLED},
    "an explicit mass": {
        "ball": {"type": "mass", "mass": 0.005},
        "tie": {"type": "viscoelastic", "between": ["cup", "ball"], "stiffness": 900.0, "damping": 0.5},
        "touch": {"type": "viscoelastic", "between": ["ball", "wall"], "stiffness": 500.0, "damping": 1.0},
    },
}


def scene_of(modules: dict[str, Any]) -> Scene:
    points = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "cup": CUP}
    device = {"mass": 0.2, "friction": 1.0, "delay": 1.0, "hold": "zoh", "clock": "lockstep"}
    far = {"far": {"type": "ground", "position": -0.03}}
    document = {"version": 1, "rate": 1000, "device": device, "mock": {"quantum": 1e-10}}
    document["modules"] = points | far | modules
    return parse_scene(yaml.safe_dump(document, sort_keys=False))


@pytest.mark.parametrize("name", BEHIND)
def test_k_and_b_are_those_of_the_prediction(name: str) -> None:
    scene = scene_of(BEHIND[name])
    (one,) = predict(scene, with_margins=False).parts
    felt = one.own_motion
    assert felt is not None
    found = measure(scene, run=run_in_memory)
    assert found.k == pytest.approx(felt.k, rel=1e-6, abs=1e-6)
    assert found.b == pytest.approx(felt.b, rel=4e-6)  # the fit's own uncertainty is up to 2e-6
