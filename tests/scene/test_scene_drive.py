"""A device with a transmission and a motor lag: what a scene says of them, and what does not go with them."""

from collections.abc import Callable

import pytest

from hapsim.scene import parse_scene
from hapsim.scene.drive import Drive
from tests.device_texts import faults_in, text_of

BELT = "transmission: {stiffness: 20 N/mm, motor_mass: 50 g}"
RIGID = Drive()


def _text(device: str, mock: str = "seed: 1", damper: str = "") -> str:
    return text_of(f"mass: 200 g, {device}", mock, damper)


def test_a_channel_has_a_drive_of_its_own() -> None:
    device = (
        "motor_lag: [0, 1 ms], transmission: {stiffness: 2e4, damping: [1, 2], motor_mass: [50 g, 0], "
        "sensor: [handle, motor], backlash: 0.1 mm}"
    )
    scene = parse_scene(_text(device, "motor_lag: 2 ms") + "  other: {type: device, channel: 1}\n")
    belt = Drive(2e4, 1.0, 0.05, "handle", "motor", 1e-4)
    assert scene.device.drives(2) == (belt, Drive(lag=1e-3))
    assert [one.is_elastic for one in scene.device.drives(2)] == [True, False]
    assert scene.mock_device.drive == (belt._replace(lag=2e-3), Drive(lag=2e-3))


@pytest.mark.parametrize(
    ("device", "mock", "drives"),
    [
        ("friction: 1", "seed: 1", (RIGID, RIGID)),
        (BELT, "seed: 1", (Drive(2e4, 0.0, 0.05),) * 2),
        (BELT, "transmission: {stiffness: 100, motor_mass: 0}", (Drive(2e4, 0.0, 0.05), RIGID)),
        ("motor_lag: 1 ms", "motor_lag: 0", (Drive(lag=1e-3), RIGID)),
        ("friction: 1", "transmission: {stiffness: 100, motor_mass: 199 g}", (RIGID, Drive(100.0, 0.0, 0.199))),
    ],
)
def test_the_mock_is_driven_as_the_device_where_it_does_not_differ(
    device: str, mock: str, drives: tuple[Drive, Drive]
) -> None:
    scene = parse_scene(_text(device, mock))
    assert (*scene.device.drives(1), *scene.mock_device.drive) == drives


@pytest.mark.parametrize(
    ("device", "mock", "fault"),
    [
        (
            "transmission: {stiffness: 9, motor_mass: 200 g}",
            "seed: 1",
            "motor_mass: found 200 g, expected less than 200",
        ),
        (BELT, "mass: 50 g", "mock: found 50 g (device.transmission.motor_mass), expected less than 50 g"),
        (
            BELT,
            "grips: [[0, 0.3], [1, 0.04]]",
            "mock: found 50 g (device.transmission.motor_mass), expected less than 40",
        ),
        (
            "travel: [-10 mm, 10 mm], transmission: {stiffness: 9, motor_mass: 50 g, backlash: 20 mm}",
            "seed: 1",
            "backlash: found 20 mm, expected less than 20 mm: the travel, or the motor never",
        ),
        (
            "transmission: {stiffness: 0, motor_mass: 50 g}",
            "seed: 1",
            "stiffness: found 0, expected a number > 0 (N/m)",
        ),
        ("transmission: {motor_mass: 50 g}", "seed: 1", "transmission: 'stiffness' is missing"),
        ("transmission: {stiffness: 9, motor_mass: [0, 0]}", "seed: 1", "motor_mass: found 2 numbers, expected 1"),
        (
            "transmission: {stiffness: 9, motor_mass: 0.1, sensor: belt}",
            "seed: 1",
            "sensor: found 'belt' (text), expected motor or handle",
        ),
        ("motor_lag: 2", "seed: 1", "motor_lag: found 2, expected a number from 0 to 1 (s)"),
        ("motor_lag: 2 mm", "seed: 1", "motor_lag: found 2 mm, expected a time (s)"),
        ("motor_lag: 0.001, hold: impulse", "hold: impulse", "motor_lag: found a motor lag with hold: impulse"),
        ("motor_lag: 0.001", "hold: impulse", "mock: found a motor lag with hold: impulse"),
        ("hold: impulse", "motor_lag: 0.001", "motor_lag: found a motor lag with hold: impulse"),
        (BELT + ", sampling: average", "seed: 1", "transmission: found a transmission with sampling: average"),
        ("motor_lag: 0.001, sensors: [velocity]", "seed: 1", "motor_lag: found a motor lag with sensors"),
        (BELT + ", correction: predictor", "seed: 1", "transmission: found a transmission with correction: predictor"),
    ],
)
def test_what_does_not_go_together_is_reported_once_where_it_stands(device: str, mock: str, fault: str) -> None:
    (found,) = faults_in(_text(device, mock))
    assert found.startswith(fault)


def test_a_damper_that_senses_the_velocity_does_not_go_with_a_belt() -> None:
    (found,) = faults_in(_text(BELT, damper=", damper: sensed"))
    assert found.startswith("transmission: found a transmission with a damper that senses the velocity (touch)")


def test_a_belt_is_refused_in_the_plane(faults: Callable[[str], list[str]]) -> None:
    plane = """version: 1
rate: 1000
space: 2
device: {mass: 0.2, transmission: {stiffness: 9, motor_mass: 0.1}, motor_lag: 0.001}
modules:
  hand: {type: device, channels: [0, 1]}
  post: {type: ground, position: [0, 0]}
  disc: {type: shape, between: [hand, post], form: {disc: 0.02}, stiffness: 2000}
"""
    found = [one.split(": ", 1)[1] for one in faults(plane)]
    assert len(found) == 2
    assert all("with space: 2, expected none" in one for one in found)


@pytest.mark.parametrize("device", ["hold: impulse", "transmission: {stiffness: 9, motor_mass: 0}, sampling: average"])
def test_without_motor_mass_and_lag_nothing_is_refused(device: str) -> None:
    assert faults_in(_text(f"{device}, motor_lag: 0, sensors: [velocity]")) == []
