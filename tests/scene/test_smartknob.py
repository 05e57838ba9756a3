"""Scenes from SmartKnob's configurations do what its firmware does.

The numbers are those of `configs[]` in firmware/src/interface_task.cpp, and `Firmware` says its motor_task.cpp in
Python (github.com/scottbez1/smartknob, Apache-2.0)."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene
from hapsim.errors import UsageError
from hapsim.prediction import predict
from hapsim.prediction.linear import with_device
from hapsim.scene import Scene, parse_scene
from hapsim.scene.smartknob import scene_from_smartknob

DEGREE = math.pi / 180.0
KEYS = [
    *("position", "min_position", "max_position", "position_width_radians", "detent_strength_unit"),
    *("endstop_strength_unit", "snap_point", "text", "detent_positions", "snap_point_bias", "led_hue"),
]
CONFIGS = [
    (0, 0, -1, 10 * DEGREE, 0, 1, 1.1, "Unbounded\nNo detents", [], 0, 200),
    (0, 0, 10, 10 * DEGREE, 0, 1, 1.1, "Bounded 0-10\nNo detents", [], 0, 0),
    (0, 0, 72, 10 * DEGREE, 0, 1, 1.1, "Multi-rev\nNo detents", [], 0, 73),
    (0, 0, 1, 60 * DEGREE, 1, 1, 0.55, "On/off\nStrong detent", [], 0, 157),
    (0, 0, 0, 60 * DEGREE, 0.01, 0.6, 1.1, "Return-to-center", [], 0, 45),
    (127, 0, 255, 1 * DEGREE, 0, 1, 1.1, "Fine values\nNo detents", [], 0, 219),
    (127, 0, 255, 1 * DEGREE, 1, 1, 1.1, "Fine values\nWith detents", [], 0, 25),
    (0, 0, 31, 8.225806452 * DEGREE, 2, 1, 1.1, "Coarse values\nStrong detents", [], 0, 200),
    (0, 0, 31, 8.225806452 * DEGREE, 0.2, 1, 1.1, "Coarse values\nWeak detents", [], 0, 0),
    (0, 0, 31, 7 * DEGREE, 2.5, 1, 0.7, "Magnetic detents", [2, 10, 21, 22], 0, 73),
    (0, -6, 6, 60 * DEGREE, 1, 1, 0.55, "Return-to-center\nwith detents", [], 0.4, 157),
]
VOLT = 0.015 / 2.645  # N·m, a guess of configs/boards/smartknob.yaml


def config_of(number: int, **more: Any) -> dict[str, Any]:
    return dict(zip(KEYS, CONFIGS[number], strict=True)) | more


def made(tmp_path: Path, config: Any) -> tuple[Scene, list[str]]:
    (file := tmp_path / "knob.json").write_text(config if isinstance(config, str) else json.dumps(config))
    text, unsaid = scene_from_smartknob(file)
    return parse_scene(text, "knob.yaml"), unsaid


class Firmware:
    """The loop of motor_task.cpp without D and bias, with angles that count as positions do."""

    def __init__(self, config: dict[str, Any]) -> None:
        self.config, self.position, self.centre = config, config["position"], 0.0

    def torque(self, angle: float) -> float:
        """N·m, on the knob at this angle in rad."""
        one = self.config
        width, low, high = one["position_width_radians"], one["min_position"], one["max_position"]
        is_open = high < low
        off, snap = angle - self.centre, width * one["snap_point"]
        if off < -snap and (is_open or self.position > low):
            self.centre, self.position, off = self.centre - width, self.position - 1, off + width
        elif off > snap and (is_open or self.position < high):
            self.centre, self.position, off = self.centre + width, self.position + 1, off - width
        zone = min(0.2 * width, DEGREE)
        dead = min(max(off, -zone), zone)
        beyond = not is_open and ((off < 0 and self.position == low) or (off > 0 and self.position == high))
        strength = one["endstop_strength_unit"] if beyond else one["detent_strength_unit"]
        if not beyond and one["detent_positions"] and self.position not in one["detent_positions"]:
            strength = 0.0
        return -4.0 * strength * VOLT * (off - dead)


@pytest.mark.parametrize("number", range(len(CONFIGS)))
def test_each_configuration_is_the_firmwares_law_and_stable(number: int, tmp_path: Path) -> None:
    config = config_of(number)
    scene, unsaid = made(tmp_path, config)
    assert any("snap_point_bias" in one for one in unsaid) == (number == 10)
    assert any("led_hue" in one for one in unsaid) == bool(config["led_hue"])
    assert predict(scene, with_margins=False).stable

    firmware, rng = Firmware(config), np.random.default_rng(number)
    width = config["position_width_radians"]
    way = np.cumsum(rng.choice([-0.3, 0.3], 200).repeat(20) * rng.uniform(0.0, 1.0, 4000)) * width * 0.3
    ends = (-2.0 * width, 6.0 * width)
    angles = ends[0] + abs((way - ends[0]) % (2 * (ends[1] - ends[0])) - (ends[1] - ends[0]))
    angles -= angles[0]
    undamped = scene.modules["detent"].model_copy(update={"damping": 0.0})
    program = compile_scene(scene.model_copy(update={"modules": dict(scene.modules) | {"detent": undamped}}))
    start(program, angles[:1])
    found, expected, places = [], [], []
    for angle in angles:
        force = np.zeros(1)
        tick(program, np.array([angle]), np.zeros(1), force)
        found.append(force[0])
        expected.append(firmware.torque(angle))
        places.append(int(program.parts[-1].numbers.place[0]) == firmware.position - max(config["min_position"], -99))
    assert found == pytest.approx(expected, rel=1e-6, abs=2e-9)  # the file has 7 digits of a degree
    is_open = config["max_position"] < config["min_position"]
    assert all(places) or is_open
    assert number in (0, 5) or np.max(np.abs(expected)) > 1e-5  # these two meet no stop


def test_a_configuration_runs_until_the_knob_rests(tmp_path: Path) -> None:
    """Coarse values, weak: spun by the mock, it passes places and settles in one."""
    scene, _ = made(tmp_path, config_of(8))
    events: list[Any] = []
    with hapsim.start(with_device(scene, clock="lockstep"), duration=1.5, on_event=events.append) as session:
        session.wait()
        places = session.state().places
    last = session.trace.position[-200:, 0]
    assert session.trace.report.ending == "done"
    assert np.ptp(last) <= 1.01 * scene.mock_device.quantum[0]
    assert places == {"detent": 2}
    assert [one.values["detent.place"] for one in events if one.kind == "place"] == [1, 2]


def test_protobufs_own_json_and_a_whole_state_are_taken(tmp_path: Path) -> None:
    plain = {"position_width_radians": 0.1, "detent_strength_unit": 1, "snap_point": 1.1, "max_position": 3}
    camel = {"positionWidthRadians": 0.1, "detentStrengthUnit": 1, "snapPoint": 1.1, "maxPosition": 3}
    assert made(tmp_path, plain) == made(tmp_path, {"current_position": 1, "config": camel})


@pytest.mark.parametrize(
    ("config", "told"),
    [
        ("{", "found no JSON"),
        ("[1]", "expected an object"),
        ({"snap_point": 1.1}, "position_width_radians: found none above 0"),
        (config_of(3, snap_point=0.4), "snap_point: found 0.4: the firmware ignores it, as it would give energy"),
        (config_of(3, snap_point=1.5), "expected from 0.5 to below 1.5"),
        (config_of(3, detent_strength_unit=-1), "detent_strength_unit: found -1, expected 0 or more"),
        (config_of(3, snap_points=1), "found 'snap_points', expected .*; did you mean 'snap_point'"),
        (config_of(3, text=5), "text: found 5, expected a text"),
        (config_of(3, detent_positions=[0.5]), r"detent_positions: found \[0.5\], expected a list of whole numbers"),
        (config_of(3, max_position=5000), "found 5001 positions, expected at most 1000"),
    ],
)
def test_what_is_no_configuration_is_refused(config: Any, told: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=told):
        made(tmp_path, config)
