"""Parts of a scene that do not fit together are errors, each where it stands."""

from collections.abc import Callable

import pytest

from hapsim.scene import parse_scene
from hapsim.scene.modules import MODULE_TYPES

OnlyFault = Callable[[str, str], str]
Faults = Callable[[str], list[str]]

NUMBER_OF_LIST = "one for each channel, up to the highest that a module holds; or write a single number for all"
A_NAME = "expected the name of a module of this scene"
TWO_NAMES = "expected the names of two modules, such as [hand, wall]"


@pytest.mark.parametrize(
    ("between", "told"),
    [
        ("[hand, wal]", f"7:47: between[1]: found 'wal', {A_NAME}; did you mean 'wall'?"),
        ("[hand, touch]", "7:47: between[1]: found 'touch', the link itself; expected a point to hold"),
        ("[hand, hand]", "7:40: between: found 'hand' at both ends, expected two different points"),
        ("[hand]", f"7:40: between: found a list of 1, {TWO_NAMES}"),
        ("[hand, wall, hand]", f"7:40: between: found a list of 3, {TWO_NAMES}"),
        (
            "hand, wall",
            f"7:40: between: found 'hand' (text), {TWO_NAMES}; write a list in brackets: [hand, wall]",
        ),
        ("hand", f"7:40: between: found 'hand' (text), {TWO_NAMES}"),
        ("[hand, true]", "7:47: between[1]: found true (a boolean), expected the name of a module"),
    ],
)
def test_a_link_has_to_join_two_points(only_fault: OnlyFault, between: str, told: str) -> None:
    assert only_fault("[hand, wall]", between) == told


def test_a_link_to_a_link_is_reported(only_fault: OnlyFault) -> None:
    assert only_fault("modules:\n", "modules:\n  l: {type: viscoelastic, between: [hand, touch], stiffness: 1}\n") == (
        "5:43: between[1]: found 'touch', which is a link; expected a point"
    )


def test_a_link_between_two_grounds_is_reported(faults: Faults, good: str) -> None:
    assert faults(good.replace("[hand, wall]", "[wall, floor]") + "  floor: {type: ground}\n") == [
        "7:40: between: found 'wall' and 'floor', which cannot move; expected at least one end that can"
    ]


def test_two_modules_on_one_channel_are_reported_at_the_second(faults: Faults, good: str) -> None:
    assert faults(good + "  left: {type: device, channel: 0}\n") == [
        "8:33: channel: found 0, which 'hand' already uses; expected an unused channel"
    ]


def test_a_scene_without_a_hand_is_reported(faults: Faults, good: str) -> None:
    without = "4:1: modules: found no module of type device, expected at least one for the hand to hold"
    assert faults(good.replace("type: device, channel: 0", "type: mass, mass: 1")) == [without]
    assert faults(good[: good.index("modules")] + "modules: {}") == [without]


@pytest.mark.parametrize(
    ("device", "told"),
    [
        ("{mass: [1, 2]}", f"3:16: mass: found 2 numbers, expected 1: {NUMBER_OF_LIST}"),
    ],
)
def test_a_list_of_the_device_has_one_number_per_channel(only_fault: OnlyFault, device: str, told: str) -> None:
    assert only_fault("{mass: 0.2}", device) == told


@pytest.mark.parametrize(
    ("device", "told"),
    [
        ("{mass: [0.2, -1]}", "3:22: mass[1]: found -1, expected a number > 0 (kg)"),
        ("{mass: 1}\nmock: {stiffness: [0, x]}", "4:23: stiffness[1]: found 'x' (text), expected a number >= 0 (N/m)"),
        (
            "{mass: 1}\nmock: {initial: {velocity: [0, .nan]}}",
            "4:32: velocity[1]: found .nan, expected a finite number (m/s)",
        ),
    ],
)
def test_of_a_list_with_a_faulty_number_the_length_is_not_reported(
    only_fault: OnlyFault, device: str, told: str
) -> None:
    assert only_fault("{mass: 0.2}", device) == told


def test_a_list_of_the_mock_has_one_number_per_channel(faults: Faults, good: str) -> None:
    text = good.replace("channel: 0", "channel: 1") + "mock: {friction: [1], initial: {velocity: [1, 2, 3]}}\n"
    assert faults(text) == [
        f"8:18: friction: found 1 number, expected 2: {NUMBER_OF_LIST}",
        f"8:43: velocity: found 3 numbers, expected 2: {NUMBER_OF_LIST}",
    ]


def test_a_fault_in_one_part_does_not_hide_how_the_others_fit(faults: Faults, good: str) -> None:
    text = good.replace("{mass: 0.2}", "{mass: [1, 2], delay: -1}").replace("wall]", "wal]")
    text = text.replace("stiffness: 2000", "stiffness: soft") + "  left: {type: device, channel: 0, side: 1}\n"
    assert [fault.split(": ")[:2] for fault in faults(text)] == [
        ["3:16", "mass"],
        ["3:31", "delay"],
        ["7:47", "between[1]"],
        ["7:64", "stiffness"],
        ["8:33", "channel"],
        ["8:36", "side"],
    ]


def test_a_link_to_a_faulty_module_is_no_fault_of_the_link(only_fault: OnlyFault) -> None:
    assert only_fault("type: ground", "type: wall") == (
        f"6:17: type: found 'wall' (text), expected {', '.join([*MODULE_TYPES][:-1])} or {[*MODULE_TYPES][-1]}"
    )


def test_in_a_very_large_scene_dangling_names_are_reported_quickly(faults: Faults, good: str) -> None:
    links = [f"  l{i}: {{type: viscoelastic, between: [hand, x{i}], stiffness: 1}}\n" for i in range(600)]
    told = faults(good + "".join(links))
    assert len(told) == 600
    assert told[-1] == "607:46: between[1]: found 'x599', expected the name of a module of this scene"


DETENT = "  it: {type: detent, between: [wall, hand], pitch: 1.0e-6, depth: 1"


@pytest.mark.parametrize(
    ("detent", "mock", "told"),
    [
        ("}", "4.0e-7", "found 1e-06 m: 2.5 counts of the encoder (mock.quantum: 4e-07 m); expected 4 or more"),
        (
            ", shape: notch, sharpness: 4}",
            "1.0e-7",
            "found 1e-06 m, a notch of 2.5e-07 m: 2.5 counts of the encoder (mock.quantum: 1e-07 m); expected 4 or "
            "more",
        ),
        (", shape: snap, sharpness: 4}", "2.5e-7", ""),
        (", shape: notch, sharpness: 2.5}", "1.0e-7", ""),
        (", shape: notch, sharpness: x}", "1.0e-6", "found 'x' (text), expected a number >= 1 (1)"),
        ("}", "x", "found 'x' (text), expected a number > 0 (m per count)"),
    ],
)
def test_a_detent_at_a_hand_is_wider_than_the_encoder_resolves(
    faults: Faults, good: str, detent: str, mock: str, told: str
) -> None:
    text = f"{good}{DETENT}{detent}\nmock: {{quantum: {mock}}}\n"
    if told:
        (fault,) = faults(text)
        assert fault.split(": ", 2)[2] == told
    else:
        parse_scene(text)


def test_a_detent_between_masses_and_one_before_a_port_may_be_as_narrow_as_it_is(faults: Faults, good: str) -> None:
    fine = f"{good}{DETENT}}}\nmock: {{quantum: 1.0e-3}}\n"
    parse_scene(fine.replace("[wall, hand]", "[wall, ball]").replace("  it:", "  ball: {type: mass, mass: 1}\n  it:"))
    assert len(faults(fine.replace("channel: 0", "channel: x"))) == 1  # and nothing of what it would resolve
    parse_scene(fine.replace("mass: 0.2}", "mass: 0.2, port: /dev/ttyACM0}"))


CUP = "  cup: {type: proxy, mass: 0.02, hand: hand, stiffness: 700}\n"
AT_CUP = "{type: %s, between: [cup, wall], %s}"
FIT = "expected a spring, damper, viscoelastic (damper: backward), buffer, click, a detent (shape: snap or notch) or"


@pytest.mark.parametrize(
    ("module", "sentence"),
    [
        (
            AT_CUP % ("friction", "force: 1, stiffness: 9"),
            "'cup', a proxy, at an end of a friction, which has a memory; ",
        ),
        (AT_CUP % ("plectrum", "stiffness: 9, release: 1"), "a proxy, at an end of a plectrum, which has a memory; "),
        (AT_CUP % ("detent", "pitch: 1, depth: 1"), "'cup', a proxy, at an end of a detent of shape: sine; "),
        (AT_CUP % ("viscoelastic", "stiffness: 9, damper: centred"), "end of a viscoelastic with damper: centred; "),
        (AT_CUP % ("nonlinear", "force_over_velocity: [[0, 0], [1, 1]]"), "nonlinear with force_over_velocity; "),
    ],
)
def test_a_link_that_cannot_end_on_a_proxy_is_reported(faults: Faults, good: str, module: str, sentence: str) -> None:
    (fault,) = faults(f"{good}{CUP}  it: {module}\n")
    assert f"9:{fault.split(':')[1]}: between: found " in fault
    assert f"{sentence}{FIT}" in fault


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("rate: 1000", "rate: 1000\nsubsteps: 2", "found 2 in a scene with a proxy, expected 1"),
        ("rate: 1000", "rate: 1000\nscheme: rk4", "found rk4 in a scene with a proxy, expected cordis"),
        ("mass: 0.2", "mass: 0.2, correction: poles", "found poles in a scene with a proxy, expected none"),
        ("hand: hand", "hand: hnd", "found 'hnd', expected the name of a module of type device; did you mean 'hand'?"),
        ("hand: hand", "hand: wall", "hand: found 'wall', expected the name of a module of type device"),
        ("  cup", CUP.replace("cup", "mug") + "  cup", "found 'hand', which 'mug' stands for; expected one"),
        (
            "  cup",
            "  thumb: {type: device, channel: 1}\n" + CUP.replace("cup", "mug").replace("hand: hand", "hand: thumb")
            + "  it: {type: spring, between: [cup, mug], stiffness: 1}\n  cup",
            "between: found 'cup' and 'mug'; expected a proxy at one end only",
        ),
        (
            "  cup",
            "  it: {type: detent, between: [cup, wall], pitch: 0.001, depth: 10, shape: snap, sharpness: 1}\n  cup",
            "mass: found 0.02 kg: links that fall by 40000 N/m push it to several places at once; expected a larger",
        ),
    ],
)  # fmt: skip
def test_what_a_proxy_cannot_do_is_reported(faults: Faults, good: str, old: str, new: str, sentence: str) -> None:
    text = good + CUP
    assert old in text
    (fault,) = faults(text.replace(old, new))
    assert sentence in fault


ON_BOARD = "{mass: 0.2, law: board}"


@pytest.mark.parametrize(
    ("device", "told"),
    [
        (
            "{mass: 1, board_rate: 8000}",
            "board_rate: found a board_rate without its law; add device.law: board, or omit board_rate",
        ),
        (
            "{mass: 1, board_delay: 2}",
            "board_delay: found a board_delay without its law; add device.law: board, or omit board_delay",
        ),
        (
            "{mass: 1, law: board, board_rate: 2500}",
            "board_rate: found 2500 Hz, expected a whole multiple of the rate, 1000 Hz",
        ),
        (
            "{mass: 1, law: board, board_rate: 400 Hz}",
            "board_rate: found 400 Hz, expected a whole multiple of the rate, 1000 Hz",
        ),
        (
            "{mass: 1, law: board, board_window: 11}",
            "board_window: found 11, longer than a sample; expected at most 10 local periods",
        ),
        (
            "{mass: 1, law: board, delay: 1.25}",
            "delay: found 1.25 samples with law: board, expected a whole number of local periods, such as 1.2: a line "
            "begins with one, 1/10 of a sample",
        ),
        (
            "{mass: 1, law: board, hold: ramp}",
            "hold: found ramp with law: board, expected zoh: the board holds each force for a local period",
        ),
        (
            "{mass: 1, law: board, sampling: average}",
            "sampling: found average with law: board, expected ideal: the board measures at an instant",
        ),
        (
            "{mass: 1, law: board, decimation: mean}",
            "decimation: found mean with law: board, expected last: a line answers one sample",
        ),
        (
            "{mass: 1, law: board, correction: predictor}",
            "correction: found predictor with law: board, whose force answers the board's own reading; expected none "
            "or poles",
        ),
        (
            "{mass: 1, law: board, motor_lag: 0.001}",
            "motor_lag: found a motor lag with law: board, expected one mass that the force moves at once",
        ),
        (
            "{mass: 1, law: board}\nmock: {hold: ramp}",
            "hold: found ramp with law: board, expected zoh: the board holds each force for a local period",
        ),
    ],
)
def test_what_the_law_on_the_board_excludes_is_reported(only_fault: OnlyFault, device: str, told: str) -> None:
    assert only_fault("{mass: 0.2}", device).split(": ", 1)[1] == told


def test_a_damper_at_a_hand_with_the_law_on_the_board_is_backward(faults: Faults, good: str) -> None:
    filtered = good.replace("{mass: 0.2}", ON_BOARD).replace("stiffness: 2000", "stiffness: 2000, damper: centred")
    (found,) = faults(filtered)
    assert "found centred at a hand with law: board" in found
    behind = filtered.replace("[hand, wall]", "[m, wall]") + "  m: {type: mass, mass: 1}\n"
    assert parse_scene(behind).device.law == "board"  # a mass has the loop's own samples


def test_the_board_steps_a_whole_number_of_times_in_a_sample(good: str) -> None:
    for device, board in {
        "law: board": (10, 1, 10),
        "law: board, board_rate: 20 kHz, board_delay: 0, board_window: 3": (20, 0, 3),
        "law: board, board_rate: 1000": (1, 1, 1),
        "law: host": None,
    }.items():
        scene = parse_scene(good.replace("{mass: 0.2}", f"{{mass: 0.2, {device}}}"))
        assert scene.device.board(scene.rate) == board
