"""The force of a link with a scale, at both ends, and its stored energy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene
from hapsim.scene import Scene

K, B, RATIO, GAIN, RATE = 2000.0, 5.0, 0.03, 0.2, 1000.0


def scene_of(precision: str = "double", **link: Any) -> Scene:
    hands = {name: {"type": "device", "channel": i} for i, name in enumerate("ab")}
    tie = {"type": "viscoelastic", "between": ["a", "b"], "stiffness": K, "damping": B, "ratio": RATIO, **link}
    device = {"mass": 0.2, "motion": ["linear", "rotary"]}
    document = {"version": 1, "rate": RATE, "precision": precision, "device": device, "modules": hands | {"tie": tie}}
    return Scene.model_validate(document)


@pytest.mark.parametrize(("precision", "digits"), [("double", 1e-12), ("single", 1e-4)])
@pytest.mark.parametrize("gain", [None, GAIN, 3.0])
def test_the_second_end_feels_its_share_of_the_force_on_the_lever_of_the_ratio(
    precision: str, digits: float, gain: float | None
) -> None:
    program = compile_scene(scene_of(precision, gain=gain and {"force": gain}))
    chance = np.random.default_rng(1)
    way = np.cumsum(chance.normal(0.0, [1e-3, 3e-2], (20, 2)), axis=0)
    start(program, way[0])
    before, force = way[0], np.zeros(2)
    for at in way:
        tick(program, at, np.zeros(2), force)
        d, was = at[0] - RATIO * at[1], before[0] - RATIO * before[1]
        tension = K * d + B * RATE * (d - was)
        np.testing.assert_allclose(force, [-tension, (gain or 1.0) * RATIO * tension], rtol=digits, atol=1e3 * digits)
        before = at
