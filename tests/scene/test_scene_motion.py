"""Rotary devices in a scene: the key, angles in degrees, and links between what turns and what does not."""

import math
from collections.abc import Callable

import pytest

from hapsim.live.messages import channels_of
from hapsim.measuring.pushes import pushes
from hapsim.prediction.force_bounds import fade_stiffness
from hapsim.scene import Scene, parse_scene

KNOB = """\
version: 1
rate: 1000
device: {motion: rotary, mass: 2e-5, travel: [-30 deg, 0.5], travel_margin: 2.0e+1 deg, origin: 5 deg}
mock: {initial: {position: 5 deg, velocity: -10 deg/s}, quantum: .09deg}
modules:
  knob: {type: device, channel: 0}
  frame: {type: ground, position: 15 deg}
  pick: {type: plectrum, between: [knob, frame], stiffness: 0.1, release: 3 deg}
  curve: {type: nonlinear, between: [knob, frame], force_over_distance: [[-1 deg, 0], [0.1, 1]]}
"""
PAIR = """\
version: 1
rate: 1000
device: {motion: [linear, rotary], mass: [0.2, 2e-5]}
modules:
  fader: {type: device, channel: 0}
  knob: {type: device, channel: 1}
  frame: {type: ground}
  bob: {type: mass, mass: 1e-6, position: 1 deg}
  slide: {type: spring, between: [fader, frame], stiffness: 50}
  turn: {type: spring, between: [frame, knob], stiffness: 0.05}
  hang: {type: spring, between: [bob, knob], stiffness: 0.01}
"""


def test_degrees_become_radians_wherever_a_scene_takes_a_length() -> None:
    scene = parse_scene(KNOB)
    device, mock = scene.device, scene.mock_device
    assert (device.travel, device.travel_margin, device.origin) == (
        (-math.pi / 6, 0.5),
        math.pi / 9,
        math.radians(5.0),
    )
    assert (mock.initial_position, mock.initial_velocity) == ((math.radians(5.0),), (math.radians(-10.0),))
    assert mock.quantum == (math.radians(0.09),)
    assert scene.grounds["frame"].position == math.radians(15.0)
    assert scene.links["pick"].release == math.radians(3.0)  # type: ignore[attr-defined]
    assert scene.links["curve"].force_over_distance[0] == (math.radians(-1.0), 0.0)  # type: ignore[attr-defined]


def test_an_angle_in_a_linear_scene_is_an_error_that_names_it(faults: Callable[[str], list[str]]) -> None:
    found = faults(KNOB.replace("motion: rotary, ", ""))
    assert len(found) == 9
    assert found[0] == (
        "3:31: travel[0]: found -30 deg, expected a length (m), such as 0.05 m or 50 mm, or device.motion: rotary"
    )
    (fault,) = faults(PAIR.replace("[bob, knob]", "[bob, fader]"))
    assert fault.startswith("8:43: position: found 1 deg, expected a length (m), such as 0.05 m or 50 mm")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("motion: rotary", "motion: rotory", "found 'rotory' (text), expected linear or rotary, or a list with one"),
        ("motion: rotary", "motion: [rotary, rotary]", "found 2 words, expected 1"),
    ],
)
def test_errors_have_the_units_of_what_turns(
    old: str, new: str, expected: str, faults: Callable[[str], list[str]]
) -> None:
    (fault,) = faults(KNOB.replace(old, new))
    assert expected in fault


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("stiffness: 0.01}", "stiffness: -1}", "stiffness: found -1, expected a number >= 0 (N·m/rad)"),
        (", stiffness: 0.05", "", "turn: 'stiffness' is missing, expected a number >= 0 (N·m/rad)"),
        ("1 deg", "1 dog", "(rad), such as 0.5 rad or 30 deg; did you mean 'deg'?"),
        ("2e-5]", "-1.0]", "mass[1]: found -1.0, expected a number > 0 (kg·m²)"),
        ("{type: ground}", "{type: ground, position: x}", "found 'x' (text), expected a number (m or rad)"),
    ],
)
def test_errors_have_the_units_of_the_module_or_channel_that_is_meant(
    old: str, new: str, expected: str, faults: Callable[[str], list[str]]
) -> None:
    (fault,) = faults(PAIR.replace(old, new))
    assert fault.endswith(expected)


def test_a_point_takes_the_motion_of_the_hand_it_hangs_on_and_a_link_has_one(
    faults: Callable[[str], list[str]],
) -> None:
    assert parse_scene(PAIR).device.motions(2) == ("linear", "rotary")
    (fault,) = faults(PAIR.replace("1 deg", "0") + "  both: {type: spring, between: [fader, bob], stiffness: 1}\n")
    assert fault == (
        "11:33: between: linear and rotary mixed on one link: found 'bob', which is linear and 'knob', which is "
        "rotary; expected two ends of one motion, or a ratio (device.motion has one for each channel)"
    )
    (fault,) = faults(PAIR.replace("[frame, knob]", "[fader, knob]"))
    assert fault.startswith("10:33: between: linear and rotary mixed on one link")


def device_of(motion: str, mass: float, friction: float) -> Scene:
    return parse_scene(
        "version: 1\nrate: 1000\n"
        f"device: {{motion: {motion}, mass: {mass}, friction: {friction}, travel: [-1, 1], clock: lockstep}}\n"
        "modules: {hand: {type: device, channel: 0}}\n"
    )


@pytest.mark.parametrize("inertia", [1e-5, 1e-3, 0.1])
def test_a_hand_at_a_knob_is_that_at_a_handle_with_the_inertia_in_place_of_the_mass(inertia: float) -> None:
    share = inertia / 0.5  # kg: that of a hand
    fades = fade_stiffness(device_of("rotary", inertia, share * 0.4), 0)
    assert fades == pytest.approx(share * fade_stiffness(device_of("linear", 0.5, 0.4), 0), rel=1e-9)
    (knob,), (handle,) = (channels_of(device_of(*one, 0.1)) for one in (("rotary", inertia), ("linear", 0.2)))
    assert knob.hand.stiffness == pytest.approx(inertia / 0.2 * handle.hand.stiffness)
    assert knob.hand.damping == pytest.approx(inertia / 0.2 * handle.hand.damping)
    assert knob.hand.reach == 0.5


def test_a_push_of_a_measurement_gives_a_knob_the_speed_of_angles() -> None:
    for motion, speed in (("linear", 0.1), ("rotary", 1.0)):
        scene = parse_scene(
            f"version: 1\nrate: 1000\ndevice: {{motion: {motion}, mass: 0.002, clock: lockstep}}\n"
            "modules: {hand: {type: device, channel: 0}}\n"
        )
        planned = pushes(scene, 0, 2.0, None)
        assert planned.force * planned.ticks / scene.rate == pytest.approx(0.002 * speed, rel=0.05)
