"""A device in admittance: what a scene says of it, and what does not go with it."""

from __future__ import annotations

import pytest

from hapsim.errors import SceneError
from hapsim.scene import Scene, parse_scene
from hapsim.scene.admittance import HandOfChannel, ServoOfChannel
from hapsim.scene.device import Device
from tests.device_texts import faults_in, text_of

MODE = "mode: admittance, simulated_mass: 200 g, assumed_hand: {stiffness: 2 N/mm}"


def _text(device: str, mock: str = "seed: 1", damper: str = "") -> str:
    return text_of(device, mock, damper) + "  other: {type: device, channel: 1}\n"


def _scene(device: str, mock: str = "seed: 1") -> Scene:
    return parse_scene(_text(f"{MODE}, {device}", mock))


def test_mass_and_friction_at_the_hand_are_the_simulated_ones() -> None:
    device = _scene("simulated_damping: [5, 6]").device
    assert device.is_admittance
    assert (device.masses(2), device.frictions(2), device.stiffnesses(2)) == ((0.2, 0.2), (5.0, 6.0), (0.0, 0.0))
    assert device.assumed_hands(2) == (HandOfChannel((2000.0, 2000.0), (0.0, 0.0), 0.0),) * 2
    assert device.servos(2) == (None, None)
    assert _scene("sensors: [velocity]").sensed == ("velocity", "hand_force")
    assert not Device(mass=0.2).is_admittance


def test_hands_are_spans_and_each_channel_has_its_own() -> None:
    hand = "assumed_hand: {stiffness: [100, {from: 1, to: 2}], damping: {from: 0, to: 5}, mass: [0, 10 g]}"
    scene = parse_scene(_text(f"mode: admittance, simulated_mass: [1, 2], {hand}, servo: {{bandwidth: [50 Hz, 20]}}"))
    first, second = scene.device.assumed_hands(2)
    assert first == HandOfChannel((100.0, 100.0), (0.0, 5.0), 0.0)
    assert second == HandOfChannel((1.0, 2.0), (0.0, 5.0), 0.01)
    assert scene.device.servos(2) == (ServoOfChannel(50.0, 1.0), ServoOfChannel(20.0, 1.0))
    assert parse_scene(scene.to_yaml()).document == scene.document


def test_commands_are_limited_by_the_motion_or_as_the_file_has_it() -> None:
    rotary = _scene("motion: [linear, rotary]").device
    assert (rotary.speed_limits(2), rotary.acceleration_limits(2)) == ((1.0, 20.0), (100.0, 2000.0))
    limited = _scene("speed_limit: 20 cm/s, acceleration_limit: 3").device
    assert (limited.speed_limits(2), limited.acceleration_limits(2)) == ((0.2, 0.2), (3.0, 3.0))


def test_the_mock_follows_as_the_device_where_it_does_not_differ() -> None:
    mock = _scene("servo: {bandwidth: 50 Hz}, force_limit: 4").mock_device
    assert mock.servo == (ServoOfChannel(50.0, 1.0),) * 2
    assert mock.sensed_force_limit == 40.0
    other = "servo: {bandwidth: 20}, hand: {mass: 10 g}, force_sensor: {limit: 20, quantum: 10 mN, fault: dead}"
    mock = _scene("servo: {bandwidth: 50 Hz}", other).mock_device
    assert mock.servo == (ServoOfChannel(20.0, 1.0),) * 2
    assert (mock.sensed_force_limit, mock.sensed_force_scale, mock.hand.mass) == (20.0, 0.01, 0.01)


@pytest.mark.parametrize(
    ("device", "fault"),
    [
        (
            "mode: admittance, assumed_hand: {stiffness: 1}",
            "device: 'simulated_mass' is missing, expected a number > 0",
        ),
        (
            "mode: admittance, simulated_mass: 1",
            "device: 'assumed_hand' is missing, expected a mapping such as {stiffness: 300, damping: 5}",
        ),
        ("rate: 3", "rate: unknown key"),
        ("friction: 1", "device: 'mass' is missing, expected a number > 0 (kg)"),
        (MODE.replace("200 g", "0"), "simulated_mass: found 0, expected a number > 0 (kg)"),
        (f"{MODE}, simulated_damping: -1", "simulated_damping: found -1, expected a number >= 0 (N·s/m)"),
        (f"{MODE}, servo: {{bandwidth: 0}}", "bandwidth: found 0, expected a number > 0 (Hz)"),
        (f"{MODE}, servo: {{bandwidth: [1, 2, 3]}}", "bandwidth: found 3 numbers, expected 2"),
        (f"{MODE}, simulated_damping: [1]", "simulated_damping: found 1 number, expected 2"),
        (
            MODE.replace("mode: admittance", "mode: [impedance, admittance]"),
            "mode: found a list, expected impedance or admittance, one for all channels of the device",
        ),
        (
            f"{MODE}, mass: 1",
            "mass: found a mass with mode: admittance, expected none: the mass at the hand is simulated_mass",
        ),
        (f"{MODE}, friction: 1", "friction: found a friction with mode: admittance"),
        (f"{MODE}, transmission: {{stiffness: 9, motor_mass: 1 g}}", "transmission: found a transmission with mode"),
        (f"{MODE}, motor_lag: 1 ms", "motor_lag: found a motor_lag with mode: admittance"),
        (f"{MODE}, law: board", "law: found board with mode: admittance, expected host"),
        (f"{MODE}, correction: poles", "correction: found poles with mode: admittance, expected none"),
        (f"{MODE}, correction: adaptive", "correction: found adaptive with"),
        (f"{MODE}, hold: ramp", "hold: found ramp with mode: admittance, expected zoh: commands are positions"),
        (f"{MODE}, sampling: average", "sampling: found average with mode: admittance"),
        (f"{MODE}, clock: host", "clock: found host with mode: admittance, expected device or lockstep"),
        ("mass: 1, servo: {bandwidth: 9}", "servo: found a servo without its mode; add device.mode: admittance"),
        ("mass: 1, simulated_mass: 9", "simulated_mass: found a simulated_mass without its mode"),
        ("mass: 1, assumed_hand: {stiffness: 1}", "assumed_hand: found an assumed_hand without its mode"),
        ("mass: 1, speed_limit: 9", "speed_limit: found a speed_limit without its mode"),
    ],
)
def test_what_does_not_go_with_the_mode_is_refused(device: str, fault: str) -> None:
    assert any(one.startswith(fault) for one in faults_in(_text(device))), faults_in(_text(device))


@pytest.mark.parametrize(
    ("device", "mock", "fault"),
    [
        (MODE, "mass: 1", "mass: found a mass with mode: admittance"),
        (MODE, "coulomb: 1", "coulomb: found a coulomb with mode: admittance"),
        (MODE, "hold: ramp", "hold: found ramp with mode: admittance"),
        ("mass: 1", "servo: {bandwidth: 9}", "servo: found a servo without its mode"),
        ("mass: 1", "hand: {mass: 1 g}", "mass: found a mass without its mode"),
        ("mass: 1", "force_sensor: {noise: 1 mN}", "noise: found a noise without its mode"),
        ("mass: 1", "force_sensor: {fault: dead}", "fault: found a fault without its mode"),
    ],
)
def test_what_does_not_go_with_the_mode_of_the_mock_is_refused(device: str, mock: str, fault: str) -> None:
    assert any(one.startswith(fault) for one in faults_in(_text(device, mock))), faults_in(_text(device, mock))


def test_a_sensed_velocity_and_the_plane_need_the_other_mode() -> None:
    (fault,) = faults_in(_text(MODE, damper=", damper: sensed"))
    assert fault.startswith("damper: found sensed with mode: admittance")
    plane = _text(MODE).split("modules")[0] + "space: 2\nmodules:\n  hand: {type: device, channels: [0, 1]}\n"
    with pytest.raises(SceneError, match="found admittance with space: 2, expected impedance"):
        parse_scene(plane)


def test_a_mode_that_is_none_is_the_only_fault() -> None:
    text = """version: 1
rate: 1000
device: {mode: admitance, simulated_mass: 0.2, assumed_hand: {stiffness: 2000}}
modules: {hand: {type: device, channel: 0}}
"""
    with pytest.raises(SceneError) as wrong:
        parse_scene(text, "a.yaml")
    (only,) = str(wrong.value).splitlines()
    assert only.endswith("did you mean 'admittance'?")


def test_a_noise_of_the_force_in_another_unit_is_refused() -> None:
    text = """version: 1
rate: 1000
device: {mode: admittance, simulated_mass: 0.2, assumed_hand: {stiffness: 2000}}
mock: {force_sensor: {noise: 10 kg}}
modules: {hand: {type: device, channel: 0}}
"""
    with pytest.raises(SceneError, match=r"found 10 kg, expected a force \(N rms\), such as 10 mN rms"):
        parse_scene(text, "a.yaml")
