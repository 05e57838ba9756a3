"""A run reports a sensed acceleration that contradicts the positions, and the guards stop what it makes run away."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapsim
from firmware_protocol.description import Description
from hapsim.device.mock import assemble_mock
from hapsim.errors import GuardError
from hapsim.loop.ring import row_type
from hapsim.running.sensor_check import SensorCheck

sys.path.append(str(Path(__file__).parents[1] / "probe"))

from virtual_line import PORT, virtual_port

SCENE = """
version: 1
rate: 1000
device: {clock: lockstep, mass: 0.2, friction: 1, sensors: [velocity, acceleration], correction: sensed}
mock: {mass: MASS, initial: {velocity: [0, 0.02]}}
modules:
  spare: {type: device, channel: 0}
  hand: {type: device, channel: 1}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: STIFFNESS, damping: DAMPING}
"""


@pytest.fixture
def send(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Makes the board send this many times the acceleration of channel 1."""
    assemble = assemble_mock.assemble_mock

    def use(times: float) -> None:
        def wrong(scene: hapsim.Scene) -> Any:
            mock = assemble(scene)
            mock.converters["acceleration_quantum"][1] /= times
            return mock

        monkeypatch.setattr(assemble_mock, "assemble_mock", wrong)

    return use


def text(stiffness: float = 2000.0, damping: float = 5.0, mass: float = 0.2) -> str:
    values = {"STIFFNESS": stiffness, "DAMPING": damping, "MASS": mass}
    return functools.reduce(lambda scene, one: scene.replace(one, str(values[one])), values, SCENE)


@pytest.mark.parametrize(("times", "what"), [(-1.0, "sign"), (10.0, "scale"), (0.5, "scale"), (1.2, None), (1.0, None)])
def test_a_wrong_sign_or_scale_is_in_the_report_with_its_figure(
    send: Callable[[float], None], times: float, what: str | None
) -> None:
    send(times)
    report = hapsim.run(hapsim.parse_scene(text()), duration=2.0).report
    expected = f"hand: the sensed acceleration is about {times:.2g} times that of the positions: its {what} is wrong"
    assert report.wrong_sensor.startswith(expected) if what else not report.wrong_sensor


@pytest.mark.parametrize(("times", "of_scene"), [(-10.0, (2000.0, 5.0, 0.05)), (10.0, (8000.0, 10.0, 0.2))])
def test_the_energy_guard_stops_what_a_wrong_sensor_shakes_and_the_error_names_the_sensor(
    send: Callable[[float], None], times: float, of_scene: tuple[float, float, float]
) -> None:
    send(times)
    with pytest.raises(GuardError, match=rf"its limit: .*about {times:.2g} times that of the positions") as caught:
        hapsim.run(hapsim.parse_scene(text(*of_scene)), duration=3.0, judges_energy=True)
    assert caught.value.trace is not None
    assert caught.value.trace.report.ticks < 1000
    send(1.0)
    assert not hapsim.run(hapsim.parse_scene(text(*of_scene)), duration=1.0, judges_energy=True).report.wrong_sensor


def test_run_prints_it_as_a_warning(hapsim: Callable[..., Any], send: Callable[[float], None], tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text(), encoding="utf-8")
    send(-1.0)
    answer = hapsim("run", path, "--duration", 2)
    printed = " ".join(f"{answer.out} {answer.err}".split())
    assert printed.count("hand: the sensed acceleration is about -1 times that of the positions") == 1
    send(1.0)
    assert "sensed acceleration" not in hapsim("run", path, "--duration", 2).out


def sentence_of(sensed: np.ndarray, position: np.ndarray, lost: int = 0) -> str:
    """Returns the sentence of a run of 2 kHz, in pieces of 50 rows, `lost` samples missing after each tenth piece."""
    description = Description("", 2000.0, 7, 100, (1e-6,), (1e-6,), (10.0,), acceleration_scale=(1e-3,))
    check = SensorCheck(2000.0, description)
    rows = np.zeros(position.size, row_type(1, ["acceleration"]))
    rows["sample"] = np.arange(position.size)
    rows["position_counts"][:, 0], rows["acceleration_counts"][:, 0] = np.rint(position / 1e-6), np.rint(sensed / 1e-3)
    for number, at in enumerate(range(0, position.size, 50)):
        check.add(rows[at : at + 50 - (lost if number % 10 == 9 else 0)])
    one_hand = "version: 1\nrate: 2000\ndevice: {mass: 0.2}\nmodules: {hand: {type: device, channel: 0}}\n"
    return check.sentence(hapsim.parse_scene(one_hand))


def test_neither_noise_nor_gravity_nor_a_lost_sample_is_a_contradiction_but_a_wrong_sign_is() -> None:
    """Motions of any size beside noise of the encoder and of the sensor: of 80 right ones none is named."""
    rng, named = np.random.default_rng(4), 0
    time = np.arange(4000) / 2000.0
    for number in range(80):
        largest = (-2.0, -7.0)[number % 2]  # every other motion is lost in noise
        position, true = np.zeros(time.size), np.zeros(time.size)
        for frequency in rng.uniform(0.5, 25.0, 3):
            size, phase, w = 10.0 ** rng.uniform(largest - 4.0, largest), rng.uniform(0.0, 6.0), 2.0 * np.pi * frequency
            position += size * np.sin(w * time + phase)
            true -= size * w**2 * np.sin(w * time + phase)
        position += 10.0 ** rng.uniform(-8.0, -4.5) * rng.normal(size=time.size)
        noise = 10.0 ** rng.uniform(-3.0, 0.5) * rng.normal(size=time.size) + rng.uniform(-10.0, 10.0)
        assert sentence_of(true + noise, position, int(rng.integers(0, 30))) == ""
        named += "its sign is wrong" in sentence_of(noise - true, position)
    assert named > 33


@pytest.mark.parametrize("value", [0.0, -9.81])
def test_a_stuck_sensor_is_named_and_one_at_rest_is_not(value: float) -> None:
    rng, time = np.random.default_rng(5), np.arange(4000) / 2000.0
    w = 2.0 * np.pi * 8.0
    swing, true = 1e-3 * np.sin(w * time), -1e-3 * w**2 * np.sin(w * time)
    constant = np.full(time.size, value)
    expected = "hand: the sensed acceleration has not changed by one count for"
    assert sentence_of(constant, swing).startswith(f"{expected} 2 s although the position accelerated")
    assert sentence_of(constant, swing, lost=30).startswith(expected)
    died = np.where(time < 1.0, true, value)
    assert sentence_of(died, swing).startswith(f"{expected} 1 s")
    assert sentence_of(np.where(time > 1.0, true, value), swing) == ""  # it is back
    for noise in (0.0, 1e-6, 1e-4):  # at rest, and along a straight line
        assert sentence_of(constant, 0.1 * time + noise * rng.normal(size=time.size)) == ""


@pytest.mark.parametrize("at", [0, 20])
def test_the_error_names_a_stuck_sensor_in_place_of_the_slew_limit(monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    virtual_port(monkeypatch, rate=1000.0, accelerates=True, stuck_at=at, bodies=[{"v": 1.0}])
    scene = text(8000.0, 10.0).replace("clock: lockstep", f"port: {PORT}, slew_limit: 300")
    scene = scene.replace("  spare: {type: device, channel: 0}\n", "").replace("channel: 1", "channel: 0")
    scene = scene.replace("[0, 0.02]", "0.0")
    with pytest.raises(GuardError, match="hand: the sensed acceleration has not changed by one count for") as caught:
        hapsim.run(hapsim.parse_scene(scene), duration=1.0, portable=True)
    assert "slew_limit" not in str(caught.value)


def test_lost_samples_of_a_fast_hand_do_not_hide_a_wrong_sign() -> None:
    """Across a gap the second difference of a steady motion is hundreds of times that of its swing."""
    time, w = np.arange(4000) / 2000.0, 2.0 * np.pi * 10.0
    assert "its sign is wrong" in sentence_of(1e-4 * w**2 * np.sin(w * time), 0.1 * time + 1e-4 * np.sin(w * time), 30)
