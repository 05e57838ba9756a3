"""A scene of a knob, and one of a knob and a fader: every command speaks of each in its units."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.cli.output import stdout
from hapsim.cli.status import show_status
from hapsim.errors import UsageError
from hapsim.measuring.measure import measure
from hapsim.scene import load_scene
from hapsim.units import LINEAR, Units

Hapsim = Callable[..., Any]

KNOB = """\
version: 1
rate: 1000
device: {clock: lockstep, motion: rotary, mass: 2.0e-5, friction: 1.0e-4, force_limit: 0.05,
         travel: [-90 deg, 90 deg], origin: 1 deg}
mock: {initial: {position: 5 deg}}
modules:
  knob: {type: device, channel: 0}
  frame: {type: ground}
  hold: {type: viscoelastic, between: [knob, frame], stiffness: 0.05, damping: 5.0e-4}
"""
PAIR = """\
version: 1
rate: 1000
device: {clock: lockstep, motion: [linear, rotary], mass: [0.2, 2.0e-5], friction: [1, 1.0e-4]}
modules:
  fader: {type: device, channel: 0}
  knob: {type: device, channel: 1}
  frame: {type: ground}
  slide: {type: viscoelastic, between: [fader, frame], stiffness: 500, damping: 2}
  turn: {type: viscoelastic, between: [knob, frame], stiffness: 0.05, damping: 5.0e-4}
"""
OF_A_LINE = re.compile(r"(?<![\w·])(N/m|N·s/m|N/s|kg|mm|m/s)(?![\w·²])|\d (m|N)(?![\w·])")


@pytest.fixture
def knob(tmp_path: Path) -> Path:
    path = tmp_path / "knob.yaml"
    path.write_text(KNOB, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "command",
    [
        "check",
        "check --at 5deg",
        "measure",
        "measure --explain --duration 0.2",
        "measure --impedance --duration 3",
        "identify --duration 1",
        "run --duration 0.1",
        "chart plane",
        "chart transparency",
        "chart force",
    ],
)
def test_every_command_speaks_of_a_knob_in_its_units(command: str, knob: Path, hapsim: Hapsim, tmp_path: Path) -> None:
    picture = tmp_path / "picture.svg"
    draws = [] if command.startswith(("check", "run", "identify")) else ["--picture", picture]
    told = hapsim(*command.split(), knob, *draws)
    assert told.status == 0, told.err
    said = told.out + told.err + (picture.read_text("utf-8") if draws else "")
    assert OF_A_LINE.search(re.sub(r'="[^"]*"', "", said)) is None
    expected = {"run": "rad", "chart": "N·m", "measure": "N·m·s/rad"}.get(command.split(maxsplit=1)[0], "kg·m²")
    assert expected in said


def test_a_knob_and_a_fader_have_each_their_units(tmp_path: Path, hapsim: Hapsim) -> None:
    path = tmp_path / "pair.yaml"
    path.write_text(PAIR, encoding="utf-8")
    told = " ".join(hapsim("check", path).out.split())
    assert "channel 0: 0.2 kg, friction 1 N·s/m; channel 1: 2e-05 kg·m², friction 0.0001 N·m·s/rad" in told
    assert re.search(r"fader: k +500 +\S+ +500 N/m ", told)
    assert re.search(r"knob: k +0.05 +\S+ +0.05 N·m/rad ", told)
    assert "Guards: force 10 N or N·m," in told
    of_knob = hapsim("measure", path, "--channel", "1", "--duration", "0.5").out
    assert "k  N·m/rad" in of_knob
    assert OF_A_LINE.search(of_knob) is None
    of_fader = hapsim("measure", path, "--channel", "0", "--duration", "0.5").out
    assert "k  N/m" in of_fader
    assert "rad" not in of_fader


def test_scripts_learn_the_motion_of_each_channel(knob: Path, hapsim: Hapsim) -> None:
    for command in ("check", "measure", "run --duration 0.05", "identify --duration 1"):
        assert json.loads(hapsim(*command.split(), knob, "--json").out)["motion"] == ["rotary"]


def test_the_status_of_a_knob_is_in_its_units(capsys: pytest.CaptureFixture[str]) -> None:
    show_status(stdout(), {"motion": ["rotary"], "force_n": [0.1], "position_m": [0.2]})
    show_status(stdout(), {"force_n": [0.1]})  # of an earlier version
    assert capsys.readouterr().out.splitlines()[:2] == ["force  N·m     0.1", "position  rad  0.2"]


def test_errors_are_in_the_units_of_the_scene_in_python_too(knob: Path) -> None:
    with pytest.raises(UsageError, match="push: found -1, expected a finite number of N·m above 0"):
        measure(knob, push=-1.0)
    assert load_scene(knob).units_of(0)("0.3 m") == "0.3 rad"


@pytest.mark.parametrize(
    ("line", "rotary", "both"),
    [
        ("k = 5 N/m, b = 2 N·s/m", "k = 5 N·m/rad, b = 2 N·m·s/rad", "k = 5 N/m or N·m/rad, b = 2 N·s/m or N·m·s/rad"),
        ("0.2 kg at 3 mm or 4 µm", "0.2 kg·m² at 3 mrad or 4 µrad", None),
        ("a number > 0 (m)", "a number > 0 (rad)", "a number > 0 (m or rad)"),
        ("points [m/s, N] in m, in N", "points [rad/s, N·m] in rad, in N·m", None),
        ("1e-9 m per count, 2 N per count", "1e-9 rad per count, 2 N·m per count", None),
        ("position  m", "position  rad", "position  m or rad"),
        ("$m$ = 2, K T²/m, a hand m, --push N, 3 ms", "$m$ = 2, K T²/m, a hand m, --push N, 3 ms", None),
        ("2 newton, 3 metres", "2 N·m, 3 radians", None),
    ],
)
def test_a_sentence_is_translated_unit_by_unit(line: str, rotary: str, both: str | None) -> None:
    turns, mixed = Units(["rotary"]), Units(["linear", "rotary"])
    assert (LINEAR(line), turns(line)) == (line, rotary)
    assert turns(str(turns(line))) == rotary
    if both is not None:
        assert mixed(line) == both
    assert mixed(str(mixed(line))) == mixed(line)


def test_check_of_a_knob_marks_where_the_hand_is_and_says_what_repeats(hapsim: Hapsim) -> None:
    told = hapsim("check", "knob_24", "--at", "15deg").out
    assert "detent repeats every 261.8 mrad" in told
    (here,) = (line for line in told.splitlines() if line.rstrip().endswith("stable ←"))
    assert here.split()[:3] == ["196.3", "to", "327.2"]
    wrong = hapsim("check", "button", "--at", "-4.3")
    assert wrong.status == 2
    assert "--at: found -4.3, which is -4.3 m; write -4.3mm if you meant mm" in wrong.err
    assert hapsim("check", "button", "--at=-4.3mm").out == hapsim("check", "button", "--at=-0.0043").out


NAMED = """\
version: 1
rate: 1000
device: {clock: lockstep, motion: rotary, mass: 2.0e-5, friction: 1.0e-4, force_limit: 0.05}
modules:
  knob: {type: device, channel: 0}
  frame: {type: ground}
  m: {type: mass, mass: 1.0e-5}
  N: {type: viscoelastic, between: [knob, m], stiffness: 0.05, damping: DAMPING}
  kg: {type: viscoelastic, between: [m, frame], stiffness: 0.05, damping: 5.0e-4}
"""


def test_names_that_look_like_units_stay_as_they_were_written(
    hapsim: Hapsim, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("turn by 5 m.yaml").write_text(NAMED.replace("DAMPING", "5.0e-4"), encoding="utf-8")
    told = " ".join(hapsim("check", "turn by 5 m.yaml").out.split())
    assert told.startswith("turn by 5 m.yaml at 1000 Hz: stable")
    assert "knob moves a mass of the scene too (m, by N)" in told
    assert "times the stiffness of N" in told
    assert "a hand of 2e-05 kg·m², friction 0.0001 N·m·s/rad" in told
    answer = hapsim("run", "turn by 5 m.yaml", "--duration", "0.1", "--record", "a 5 m.trace")
    assert "Trace: a 5 m.trace" in answer.out
    assert Path("a 5 m.trace").exists()
    Path("turn by 5 m.yaml").write_text(NAMED.replace("DAMPING", "-1"), encoding="utf-8")
    told = hapsim("check", "turn by 5 m.yaml").err
    assert "turn by 5 m.yaml:8:" in told
    assert "damping: found -1, expected a number >= 0 (N·m·s/rad)" in told


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("moves m by 5 m", "moves m by 5 rad"),
        ("at 3 N, (N, by m), m/s of N", "at 3 N·m, (N, by m), rad/s of N"),
        ("run at 5 m.trace: 5 m.trace 5 m", "run at 5 m.trace: 5 rad.trace 5 rad"),
        ("N·s/m and N/m, m 44%", "N·m·s/rad and N·m/rad, m 44%"),
    ],
)
def test_behind_a_number_a_unit_is_a_unit(text: str, told: str) -> None:
    assert Units(["rotary"], ["m", "N", "run at 5 m.trace", "wall"])(text) == told
    assert LINEAR.keeping(["m"])(text) == text
