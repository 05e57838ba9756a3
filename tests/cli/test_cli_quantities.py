"""Options that take a quantity: with a unit of the scene's motion the result is that of the number in SI units; another
unit, and a bare number that no hand reaches, is refused before anything moves."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.errors import UsageError
from hapsim.scene import Scene

Hapsim = Callable[..., Any]

TOUCH = "{type: viscoelastic, between: [hand, wall], stiffness: 1000.0, damping: 5.0}\n"
SCENE = f"""\
version: 1
rate: 1000
device: {{clock: lockstep, motion: MOTION, mass: 0.2, friction: 1.0, force_limit: 8.0}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  touch: {TOUCH}"""
LINEAR: dict[str, tuple[str, float, str]] = {}
ROTARY: dict[str, tuple[str, float, str]] = {}
#: By the SI unit of a line, for each motion: a quantity, the same in SI units, and the words of a refusal.
for _unit, _linear, _rotary in (
    ("m", ("2mm", 0.002, "a length (m)"), ("0.2 deg", math.radians(0.2), "an angle (rad)")),
    ("N", ("500 mN", 0.5, "a force (N)"), ("500mN·m", 0.5, "a torque (N·m)")),
    ("kg", ("300g", 0.3, "a mass (kg)"), ("3000 kg·cm²", 0.3, "a moment of inertia (kg·m²)")),
    ("N/m", ("2N/mm", 2000.0, "a stiffness (N/m)"), ("2000000 mN·m/rad", 2000.0, "a stiffness (N·m/rad)")),
    ("N·s/m", ("4000 mN·s/m", 4.0, "a damping (N·s/m)"), ("4000mN·m·s/rad", 4.0, "a damping (N·m·s/rad)")),
    ("m/s", ("20 mm/s", 0.02, "a velocity (m/s)"), ("3deg/s", math.radians(3.0), "an angular velocity (rad/s)")),
):
    LINEAR[_unit], ROTARY[_unit] = _linear, _rotary

#: A command, its option, the unit that this one has on a line, and what of the document depends on it: of the first,
#: nothing in this scene.
OPTIONS = [
    ("check", "--at", "m", "predicted"),
    ("check", "--hand-mass", "kg", "parts"),
    ("check", "--hand-stiffness", "N/m", "parts"),
    ("measure", "--at", "m", "at_m"),
    ("measure", "--push", "N", "push_n"),
    ("measure --mass", "--hand-stiffness", "N/m", "felt_mass"),
    ("measure --impedance --duration 3", "--travel", "m", "impedance"),
    ("measure --impedance --duration 3", "--push", "N", "impedance"),
    ("identify --duration 0.4", "--push", "N", "force_n"),
    ("identify --duration 0.4", "--travel", "m", "travel_m"),
    ("couple", "--proxy-mass", "kg", "hands"),
    ("chart plane", "--mass", "kg", "hands"),
    ("chart plane", "--friction", "N·s/m", "hands"),
    ("chart plane", "--stiffness", "N/m", "hands"),
    ("chart plane", "--simulated-stiffness", "N/m", "hands"),
    ("chart plane", "--simulated-damping", "N·s/m", "hands"),
    ("chart transparency", "--mass", "kg", "hand"),
    ("chart force", "--speed", "m/s", "speed_m_s"),
]
each_option = pytest.mark.parametrize(("command", "option", "unit", "key"), OPTIONS)
each_motion = pytest.mark.parametrize("motion", ["linear", "rotary"])


@pytest.fixture
def scene(tmp_path: Path, motion: str) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.replace("MOTION", motion), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def without_option() -> dict[tuple[str, str], dict[str, Any]]:
    """Answers of commands without the option, by command and motion: each is asked once."""
    return {}


@pytest.mark.thorough(keep=3)
@pytest.mark.usefixtures("coarse_planes")
@pytest.mark.parametrize(
    ("motion", "command", "option", "unit", "key"),
    [(("linear", "rotary")[i % 2], *option) for i, option in enumerate(OPTIONS[1:])],
)
def test_a_quantity_is_its_number_in_si_units(
    hapsim: Hapsim,
    scene: Path,
    without_option: dict[tuple[str, str], dict[str, Any]],
    motion: str,
    command: str,
    option: str,
    unit: str,
    key: str,
) -> None:
    quantity, si, _ = (LINEAR if motion == "linear" else ROTARY)[unit]
    each = [hapsim(*command.split(), scene, f"{option}={value}", "--json") for value in (quantity, repr(si))]
    with_unit, bare = (one.document for one in each)
    if (command, motion) not in without_option:
        words = *command.split(), scene, *(["--hand-stiffness=1"] * ("--mass" in command))
        without_option[command, motion] = hapsim(*words, "--json").document
    assert [one.status for one in each] == [0, 0]
    assert with_unit[key] == bare[key] != without_option[command, motion][key]


@pytest.mark.thorough(keep=len(OPTIONS))
@each_motion
@each_option
def test_a_unit_of_another_motion_or_of_none_is_refused(
    hapsim: Hapsim, scene: Path, motion: str, command: str, option: str, unit: str, key: str
) -> None:
    here, there = (LINEAR, ROTARY) if motion == "linear" else (ROTARY, LINEAR)
    for wrong, expected in ((there[unit][0], here[unit][2]), ("3 s", LINEAR[unit][2])):
        answer = hapsim(*command.split(), scene, f"{option}={wrong}", "--json")
        assert answer.status == 2
        assert f"{option}: found {wrong}, expected {expected}, such as " in answer.sentence
        assert key not in answer.document
    assert f", or {ROTARY[unit][2]}, such as " in answer.sentence


@each_motion
def test_lists_and_ranges_have_a_unit_on_each_number(hapsim: Hapsim, scene: Path, motion: str) -> None:
    ours = "g" if motion == "linear" else "kg·cm²"
    low, high = ("200", "400") if motion == "linear" else ("2000", "4000")
    masses = hapsim("chart", "plane", scene, f"--mass={low}{ours},{high} {ours}", "--json").document["hands"]
    assert [one["mass"] for one in masses] == [0.2, 0.4]
    texts = f"{low}{ours}:{high}{ours}", "0.2:0.4"
    with_unit, bare = (hapsim("check", scene, f"--hand-mass={text}", "--json").document for text in texts)
    assert with_unit["parts"] == bare["parts"]
    second, expected = ("3 kg·m²", LINEAR["kg"][2]) if motion == "linear" else ("3 kg", ROTARY["kg"][2])
    for wrong in (second, "3 s"):
        mixed = hapsim("chart", "plane", scene, f"--mass={low}{ours},{wrong}", "--json")
        assert f"--mass: found {wrong}, expected " in mixed.sentence
        assert expected in mixed.sentence


@pytest.mark.parametrize(
    ("command", "motions", "expected"),
    [
        ("identify --channel 1 --push 50mN", "[linear, rotary]", "a torque (N·m), such as"),
        ("identify --channel 0 --push 50mN·m", "[linear, rotary]", "a force (N), such as"),
        ("measure --channel 1 --at 1mm", "[linear, rotary]", "an angle (rad), such as"),
        ("measure --impedance --push 50mN", "[linear, rotary]", "a torque (N·m), such as"),
        ("check --hand-mass 100g", "[linear, rotary]", "a moment of inertia (kg·m²), such as"),
        ("measure --hands --push 50mN", "rotary", "a torque (N·m), such as"),
    ],
)
def test_of_two_hands_each_that_an_option_is_for_judges_it(
    hapsim: Hapsim, tmp_path: Path, command: str, motions: str, expected: str
) -> None:
    path, end = tmp_path / "two.yaml", "wall" if "linear" in motions else "other"
    other = f"  other: {{type: device, channel: 1}}\n  touch: {TOUCH.replace('wall', end)}"
    text = SCENE.replace("MOTION", motions).replace(f"  touch: {TOUCH}", other)
    path.write_text(text + f"  hold: {TOUCH.replace('hand', 'other')}", encoding="utf-8")
    assert f" found {command.rsplit(maxsplit=1)[-1]}, expected {expected}" in hapsim(*command.split(), path).refusal


@each_motion
@pytest.mark.parametrize("command", ["identify", "measure --impedance"])
def test_a_bare_travel_that_no_hand_makes_is_refused(hapsim: Hapsim, scene: Path, motion: str, command: str) -> None:
    answer = hapsim(*command.split(), scene, "--travel", "115")
    si, meant = ("m", "write 115mm if you meant mm") if motion == "linear" else ("rad", "115deg if you meant degrees")
    assert answer.status == 2
    assert f"--travel: found 115, which is 115 {si}; " in answer.sentence
    assert meant in answer.sentence
    assert f", or 115{si}" in answer.sentence


@each_motion
@pytest.mark.parametrize("option", ["--push", "--travel"])
def test_a_number_that_is_not_finite_is_refused(hapsim: Hapsim, scene: Path, motion: str, option: str) -> None:
    unit = {"--push": {"linear": "N", "rotary": "N·m"}, "--travel": {"linear": "m", "rotary": "rad"}}[option][motion]
    for text in ("inf", f"1e999 {unit}"):
        refusal = hapsim("identify", scene, f"{option}={text}").refusal
        assert f"{option}: found {text}, expected a finite number" in refusal


@pytest.mark.parametrize("motion", ["rotary", pytest.param("linear", marks=pytest.mark.thorough)])
def test_a_probe_refuses_units_that_do_not_fit_the_device_before_it_pushes(
    hapsim: Hapsim, motion: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    announced = []

    def announce(words: str) -> None:
        announced.append(words)
        raise UsageError("what the test waits for; nothing is pushed")

    monkeypatch.setattr("hapsim.cli.probe.print_message", announce)
    device = {"clock": "device", "mass": 0.2, "motion": motion}
    modules = {"hand": {"type": "device", "channel": 0}}
    mock = assemble_mock(Scene.model_validate({"version": 1, "rate": 500.0, "device": device, "modules": modules}))
    here, there = (LINEAR, ROTARY) if motion == "linear" else (ROTARY, LINEAR)
    units = {"--push": "N", "--travel": "m", "--mass": "kg"}
    push, travel, mass = (f"{name}={here[unit][0]}" for name, unit in units.items())
    with serving(mock) as port:
        for name, unit in units.items():
            refusal = hapsim("probe", port, push, f"{name}={there[unit][0]}", "--only", "push").refusal
            assert f"{name}: found {there[unit][0]}, expected {here[unit][2]}, such as " in refusal
        far = hapsim("probe", port, push, "--travel=115", "--only", "push")
        assert (far.status, "--travel: found 115, which is 115 " in far.sentence) == (2, True)
        assert announced == []
        assert hapsim("probe", port, push, travel, mass, "--only", "push").status == 2
    (right,) = announced
    words = ("0.5 N", "2 mm") if motion == "linear" else ("0.5 N·m", "3.49066 mrad")
    assert f"at most {words[0]} to either side in short pulses, some seconds long, stopped if it moves" in right
    assert f"more than {words[1]}. Let it move freely." in right
