"""Requirements of a scene in admittance on its device, checked before it is armed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from firmware_protocol.description import Description, Servo
from hapsim.device.mock.assemble_mock import describe_mock
from hapsim.errors import DescriptionError, UsageError
from hapsim.running.requirements import require_compatible
from hapsim.scene import Scene
from tests import one_hand
from tests.admittance_scenes import scene_of

WITH_SERVO = {"servo": {"bandwidth": 50.0}, "speed_limit": 0.5, "simulated_damping": 20.0}


def required(scene: Scene, device: Description) -> None:
    require_compatible(scene, "/dev/ttyACM0", device)


@pytest.mark.parametrize("device", [{}, WITH_SERVO, {"motion": "rotary", "simulated_mass": 1e-3}])
def test_the_mock_is_the_device_of_its_scene(device: dict[str, Any]) -> None:
    scene = scene_of(device=device)
    required(scene, describe_mock(scene))


@pytest.mark.parametrize(
    ("lacks", "words"),
    [
        ({"hand_force_scale": (), "hand_force_range": ()}, "senses no force of the hand (its register 15, bit 1)"),
        ({"servo": None}, "follows no position commands (its register 15, bit 4)"),
    ],
)
def test_a_device_without_sensor_or_servo_is_refused(lacks: dict[str, Any], words: str) -> None:
    scene = scene_of()
    with pytest.raises(UsageError) as refused:
        required(scene, replace(describe_mock(scene), **lacks))
    assert str(refused.value) == (
        f"/dev/ttyACM0: device.mode: found admittance, but the device {words}; write mode: impedance, or use a "
        "firmware that does"
    )


def test_a_device_without_both_is_refused_for_both() -> None:
    impedance = one_hand.scene_of({})
    with pytest.raises(UsageError, match=r"bit 1\) and follows no position commands \(its register 15, bit 4\)"):
        required(scene_of(), describe_mock(impedance))


def test_everything_that_differs_is_in_one_sentence() -> None:
    scene = scene_of(device=WITH_SERVO)
    device = replace(describe_mock(scene), servo=Servo((0.25,), (100.0,), (20.0,), (0.7,)))
    with pytest.raises(UsageError) as refused:
        required(scene, device)
    assert str(refused.value) == (
        "/dev/ttyACM0: device: found speed_limit: 0.5 m/s, servo: {bandwidth: 50 Hz, damping: 1}, but the device "
        "has at most 0.25 m/s, servo: {bandwidth: 20 Hz, damping: 0.7}: write that into the scene"
    )


@pytest.mark.parametrize(
    ("own", "theirs", "words"),
    [
        ({}, (50.0, 1.0), "found no servo, but the device has servo: {bandwidth: 50 Hz, damping: 1}"),
        (WITH_SERVO, (0.0, 1.0), "servo: {bandwidth: 50 Hz, damping: 1}, but the device has no servo"),
        (WITH_SERVO, (50.0, 1.5), "damping: 1}, but the device has servo: {bandwidth: 50 Hz, damping: 1.5}"),
        (WITH_SERVO, (45.0, 1.1), ""),  # as one is identified
    ],
)
def test_the_scene_s_servo_is_the_device_s(own: Any, theirs: tuple[float, float], words: str) -> None:
    scene = scene_of(device=own)
    device = replace(describe_mock(scene), servo=Servo((1.0,), (100.0,), *((one,) for one in theirs)))
    if not words:
        required(scene, device)
        return
    with pytest.raises(UsageError) as refused:
        required(scene, device)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("declares", "words"),
    [
        ({"hand_force_range": (0.0,)}, "a hand force range of channel 0 of 0 N (register 166)"),
        (
            {"servo": Servo((float("nan"),), (100.0,), (0.0,), (1.0,))},
            "a speed limit of channel 0 of nan m/s (register 168)",
        ),
        ({"servo": Servo((1.0,), (-1.0,), (0.0,), (1.0,))}, "a braking of channel 0 of -1 m/s² (register 170)"),
    ],
)
def test_registers_that_are_no_numbers_above_0_are_named(declares: dict[str, Any], words: str) -> None:
    scene = scene_of()
    with pytest.raises(DescriptionError) as refused:
        required(scene, replace(describe_mock(scene), **declares))
    assert f"the device declares {words}, which is not a number above 0. Not armed" in str(refused.value)
