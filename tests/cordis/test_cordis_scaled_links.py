"""The force of a link with a scale, at both ends, and its stored energy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from firmware_protocol.compiled import new_record
from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, positions_of
from hapsim.cordis.stored_energy import TANK, StoredEnergy, Tank, evaluate
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


@pytest.mark.parametrize("gain", [None, GAIN, 3.0])
def test_the_stored_energy_counts_with_the_weight_of_the_first_end(gain: float | None) -> None:
    scene = scene_of(gain=gain and {"force": gain})
    program, record = compile_scene(scene), new_record(TANK)
    program.stored = StoredEnergy(program, scene, Tank(record, capacity_j=1.0, refill_j=0.0), np.inf)
    start(program, at := np.array([0.01, 0.2]))
    addresses = [np.uint64(row.ctypes.data) for row in positions_of(program)]
    found = evaluate(np.uint64(program.record.parameters.stored), *addresses, np.uint64(0))
    assert float(found) == pytest.approx(max(1.0, gain or 1.0) * 0.5 * K * (at[0] - RATIO * at[1]) ** 2)
