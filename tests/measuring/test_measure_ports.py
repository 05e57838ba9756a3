"""measure_ports: what two hands on two clocks feel of each other, beside what is predicted over the phases."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from firmware_protocol.description import Description
from hapsim.errors import UsageError
from hapsim.loop.ring import BRIDGED
from hapsim.measuring.measure_ports import measure_ports, on_one_clock, tied_hands
from hapsim.prediction import predict
from hapsim.running.motors import Motors
from hapsim.scene import Scene
from tests.loop.joint_rig import push, run_ports, virtual_scene

COUNT = {"quantum": 1e-8, "force_quantum": 1e-9}


@pytest.mark.parametrize("ppm", [-1000.0, 1000.0])
def test_clocks_that_drift_apart_feel_as_predicted_over_the_phases(ppm: float) -> None:
    """Within a second the phase wraps. Of b, 3 N·s/m go with the sample period: a clock 1000 ppm off changes that on
    one of two sides."""
    scene = virtual_scene(ppm=ppm, mock=COUNT)
    found = measure_ports(scene, duration=2.0)
    (part,) = predict(scene).parts
    assert part.over_phases is not None
    assert part.over_phases.tie is not None
    least, largest = part.over_phases.tie
    assert least.k < found.tie["k"][0] < largest.k
    assert least.b - 1.5e-3 < found.tie["b"][0] < largest.b + 1.5e-3


def test_measured_at_one_phase() -> None:
    found = measure_ports(virtual_scene(phase=0.5, mock=COUNT), duration=2.0)
    assert found.hands == ("a", "b")
    assert found.tie["k"][0] == pytest.approx(2177.511, abs=0.01)
    assert found.tie["b"][0] == pytest.approx(2.50494, abs=5e-5)
    assert found.tie["k"][1] < 0.05


def test_rows_of_two_clocks_come_to_one() -> None:
    run = run_ports(virtual_scene(phase=0.4, ppm=1000.0, mock=COUNT), 1.2, {"left": push(5.0)})
    traces = run.traces | {"left": replace(run.traces["left"], flags=run.traces["left"].flags | BRIDGED)}
    rows = on_one_clock(traces, "right", [("left", 0), ("right", 0)])
    assert rows.rate == pytest.approx(1001.0, rel=1e-9)
    assert np.all(rows.flags & BRIDGED)
    right = traces["right"].position[:, 0]
    np.testing.assert_allclose(rows.position[:, 1], right[: rows.sample.size], atol=1e-9)
    coasting = rows.position[900:]  # together, in the end
    np.testing.assert_allclose(coasting[:, 0], coasting[:, 1], atol=1e-6)


def test_hands_that_no_link_ties_across_devices_are_refused() -> None:
    points = {name: {"type": "device", "of": of, "channel": 0} for name, of in (("a", "left"), ("b", "right"))}
    wall = {"wall": {"type": "ground"}}
    springs = {f"at_{one}": {"type": "spring", "between": [one, "wall"], "stiffness": 100} for one in points}
    with pytest.raises(UsageError, match="tie across devices: none"):
        tied_hands(virtual_scene(modules=points | wall | springs))


def test_a_push_beyond_the_lowered_limit_of_an_unknown_motor_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def lowered(_scene: Scene, _connection: Any, description: Description) -> Motors:
        return Motors((), replace(description, force_limit=(1.0,)), "this motor is not known", (0,))

    monkeypatch.setattr("hapsim.running.motors._may_be_lowered", lambda _: True)
    monkeypatch.setattr("hapsim.running.motors.motors_of", lowered)
    with pytest.raises(UsageError, match=r"push: found 5 N, expected at most 1 N\. this motor is not known"):
        measure_ports(virtual_scene(), duration=1.0, push=5.0)
