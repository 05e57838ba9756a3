"""A scene of a knob, and one of a knob and a fader: every command speaks of each in its units."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.cli.command_options import load
from hapsim.cli.live import _Words
from hapsim.cli.output import set_output_units, stdout
from hapsim.cli.status_command import show_status
from hapsim.errors import SceneError, UsageError
from hapsim.live.messages import channels_of
from hapsim.loop.counts import Progress
from hapsim.measuring.measure import measure
from hapsim.prediction.linear import linear_scene
from hapsim.prediction.plausibility import unlikely
from hapsim.recording.trace import load_trace
from hapsim.replaying.export import Columns
from hapsim.replaying.replay import Record
from hapsim.running.changed_scene import changed
from hapsim.running.live_parameters import parameters_of
from hapsim.scene import load_scene, parse_scene
from hapsim.units import LINEAR, MOTIONS, Units, Written, complete

Hapsim = Callable[..., Any]

KNOB = """\
version: 1
rate: 1000
device: {clock: lockstep, motion: rotary, mass: 2.0e-5, friction: 1.0e-4, force_limit: 0.05,
         travel: [-1.5, 1.5], origin: 0.02}
mock: {initial: {position: 0.1}}
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
DEGREES = complete([Written("rad", "°", 180.0 / math.pi)])
OF_A_LINE = re.compile(r"(?<![\w·])(N/m|N·s/m|N/s|kg|mm|m/s)(?![\w·²])|\d (m|N)(?![\w·])")


@pytest.fixture
def knob(tmp_path: Path) -> Path:
    path = tmp_path / "knob.yaml"
    path.write_text(KNOB, encoding="utf-8")
    return path


@pytest.mark.thorough(keep=5)
@pytest.mark.usefixtures("coarse_planes")
@pytest.mark.parametrize(
    "command",
    [
        "check",
        "check --at 5deg",
        "measure",
        "measure --explain --duration 0.2",
        "measure --impedance --duration 3",
        "identify --duration 0.4",
        "run --duration 0.1",
        "chart plane",
        "chart transparency",
        "chart force",
    ],
)
def test_every_command_describes_a_knob_in_its_units(command: str, knob: Path, hapsim: Hapsim, tmp_path: Path) -> None:
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
    told = hapsim("check", path).words
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


def test_the_walls_of_a_knob_and_a_fader_have_each_their_units(tmp_path: Path, hapsim: Hapsim) -> None:
    path = tmp_path / "pair.yaml"
    path.write_text(PAIR, encoding="utf-8")
    printed = hapsim("measure", path, "--impedance", "--duration", "3").out
    assert " or " not in printed.replace("transmission or a lagging", "")
    widths = printed.partition("Z-width: ")[2].partition("knob")
    assert [re.findall(r"\d (N\S*)", of_one)[:2] for of_one in widths[::2]] == [
        ["N/m", "N·s/m"],
        ["N·m/rad", "N·m·s/rad"],
    ]


def test_scripts_learn_the_motion_of_each_channel(knob: Path, hapsim: Hapsim) -> None:
    for command in ("check", "measure", "run --duration 0.05", "identify --duration 0.4"):
        assert json.loads(hapsim(*command.split(), knob, "--json").out)["motion"] == ["rotary"]


def test_the_status_of_a_knob_is_in_its_units(capsys: pytest.CaptureFixture[str]) -> None:
    show_status(stdout(), {"motion": ["rotary"], "force_n": [0.1], "position_m": [0.2]})
    show_status(stdout(), {"force_n": [0.1]})  # of an earlier version
    assert capsys.readouterr().out.splitlines()[:2] == ["force  N·m     0.1", "position  rad  0.2"]


def test_errors_are_in_the_units_of_the_scene_in_python_too(knob: Path) -> None:
    with pytest.raises(UsageError, match="push: found -1, expected a finite number of N·m above 0"):
        measure(knob, push=-1.0)
    assert load_scene(knob).units_of(0)(0.3, "m") == "0.3 rad"


CURVE = "  curve: {type: nonlinear, between: [knob, frame], force_over_distance: [[-1, 0.02], [0, 0.01], [1, -0.02]]}\n"


def test_a_module_has_the_units_of_the_channel_that_it_hangs_on() -> None:
    scene = parse_scene(PAIR + CURVE.replace("curve", "bend").replace("knob", "fader") + CURVE)
    each = {one.partition(" ")[0]: one.rpartition(" ")[2] for one in linear_scene(scene).assumptions}
    assert each == {"bend": "N/m", "curve": "N·m/rad"}
    units = {name: scene.units_at(name).name("N/m") for name in scene.modules}
    of_a_line, turning = ("fader", "slide", "bend"), ("knob", "turn", "curve")
    assert {units[name] for name in of_a_line} == {"N/m"}
    assert {units[name] for name in turning} == {"N·m/rad"}
    assert units["frame"] == "N/m or N·m/rad"
    with pytest.raises(UsageError, match=re.escape("slide.stiffness: found -1.0, expected a number >= 0 (N/m)")):
        changed(scene, {"slide": {"stiffness": -1.0}})
    assert parameters_of(scene, has_mock=True)["turn.damping"].unit == "N·m·s/rad"
    heavy = parse_scene(PAIR.replace("stiffness: 0.05", "stiffness: 5.0e+4"))
    assert any("turn.stiffness: found 50000 N·m/rad, more than" in one for one in unlikely(heavy))


def test_counts_in_degrees_too_coarse_for_a_detent_are_refused_with_a_sentence() -> None:
    detent = "  notch: {type: detent, between: [knob, frame], pitch: 2 deg, depth: 0.03, damping: 0.002}\n"
    with pytest.raises(SceneError, match=r"pitch: found 2°: 2 counts of the encoder \(mock\.quantum: 1°\)"):
        parse_scene(KNOB.replace("mock: {", "mock: {quantum: 1 deg, ") + detent)


@pytest.mark.parametrize(
    ("value", "unit", "linear", "rotary", "degrees", "both"),
    [
        (5.0, "N/m", "5 N/m", "5 N·m/rad", "5 N·m/rad", "5 N/m or N·m/rad"),
        (2.0, "N·s/m", "2 N·s/m", "2 N·m·s/rad", "2 N·m·s/rad", "2 N·s/m or N·m·s/rad"),
        (0.2, "kg", "0.2 kg", "0.2 kg·m²", "0.2 kg·m²", "0.2 kg or kg·m²"),
        (0.5, "m", "0.5 m", "0.5 rad", "28.6479°", "0.5 m or rad"),
        (0.003, "mm", "3 mm", "3 mrad", "0.171887°", "3 mm or mrad"),
        (2.0, "m/s", "2 m/s", "2 rad/s", "114.592°/s", "2 m/s or rad/s"),
        (1e-3, "mN", "1 mN", "1 mN·m", "1 mN·m", "1 mN or mN·m"),
        ("0.1, 0.2", "m", "0.1, 0.2 m", "0.1, 0.2 rad", "0.1, 0.2°", "0.1, 0.2 m or rad"),
    ],
)
def test_a_quantity_has_the_unit_of_its_motion(
    value: float | str, unit: str, linear: str, rotary: str, degrees: str, both: str
) -> None:
    every = LINEAR, Units.of(["rotary"]), Units.of(["rotary"], DEGREES), Units.of(MOTIONS, DEGREES)
    assert [units(value, unit) for units in every] == [linear, rotary, degrees, both]


def test_a_unit_alone_and_within_a_text_of_ours() -> None:
    turns = Units.of(["rotary"], DEGREES)
    assert (turns.name("m"), turns.name("m per count")) == ("°", "rad per count")
    assert turns.si.filled("points [‹m/s›, ‹N›], m of N") == "points [rad/s, N·m], m of N"
    assert Units.parse(["linear", "rotary"]).name("N") == "N or N·m"
    assert Units.parse(None) == Units.of([])


def test_check_of_a_knob_marks_where_the_hand_is_and_names_what_repeats(hapsim: Hapsim) -> None:
    told = hapsim("check", "knob_24", "--at", "15deg").out
    assert "detent repeats every 15°" in told
    (here,) = (line for line in told.splitlines() if line.rstrip().endswith("stable ←"))
    assert here.split()[:3] == ["11.25", "to", "18.75"]
    wrong = hapsim("check", "button", "--at", "-4.3").refusal
    assert "--at: found -4.3, which is -4.3 m; write -4.3mm if you meant mm" in wrong
    *in_mm, _next = hapsim("check", "button", "--at=-4.3mm").out.splitlines()
    *in_m, _next = hapsim("check", "button", "--at=-0.0043").out.splitlines()
    assert in_mm == in_m


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
    told = hapsim("check", "turn by 5 m.yaml").words
    assert told.startswith("turn by 5 m.yaml at 1000 Hz: stable")
    assert "knob also moves a mass of the scene (m, by N)" in told
    assert "times the stiffness of N" in told
    assert "a hand of 2e-05 kg·m², friction 0.0001 N·m·s/rad" in told
    answer = hapsim("run", "turn by 5 m.yaml", "--duration", "0.1", "--record", "a 5 m.trace")
    assert "Trace: a 5 m.trace" in answer.out
    assert Path("a 5 m.trace").exists()
    Path("turn by 5 m.yaml").write_text(NAMED.replace("DAMPING", "-1"), encoding="utf-8")
    told = hapsim("check", "turn by 5 m.yaml").err
    assert "turn by 5 m.yaml:8:" in told
    assert "damping: found -1, expected a number >= 0 (N·m·s/rad)" in told


IN_DEGREES = KNOB.replace("[-1.5, 1.5]", "[-90 deg, 1.5]").replace("position: 0.1", "position: 5°")


def test_a_scene_with_degrees_is_answered_in_degrees(hapsim: Hapsim, tmp_path: Path) -> None:
    scene, picture = tmp_path / "knob.yaml", tmp_path / "picture.svg"
    scene.write_text(IN_DEGREES, encoding="utf-8")
    told = hapsim("check", scene, "--at", "0.1").words
    assert "hand of 2e-05 kg·m², friction 0.0001 N·m·s/rad" in told
    assert "knob: k 0.05 " in told
    assert "Travel: -90 to 85.9437°. Outside, the force fades to zero within 17.5944°" in told
    assert "Origin: position 0 is where the device says 1.14592°" in told
    for command in ("measure", "chart force"):
        assert hapsim(*command.split(), scene, "--picture", picture).status == 0
        assert "(°)" in picture.read_text("utf-8")
        assert "rad)" not in picture.read_text("utf-8").replace("N·m/rad)", "").replace("N·m·s/rad)", "")
    far = hapsim("measure", scene, "--at", "1.6").refusal
    assert "at: found 91.6732°, beyond the travel" in far or "found 91.6732°, outside the travel of knob" in far


def test_programs_and_records_stay_in_rad_where_people_read_degrees(hapsim: Hapsim, tmp_path: Path) -> None:
    scenes = {name: tmp_path / f"{name}.yaml" for name in ("deg", "rad")}
    scenes["deg"].write_text(IN_DEGREES, encoding="utf-8")
    scenes["rad"].write_text(IN_DEGREES.replace("-90 deg", str(-math.pi / 2)).replace("5°", str(math.radians(5.0))))
    documents = [hapsim("check", path, "--json").out.replace(name + ".yaml", "") for name, path in scenes.items()]
    assert documents[0] == documents[1]
    scene = load_scene(scenes["deg"])
    assert (scene.units.name("m"), scene.units_of(0).si.name("m")) == ("°", "rad")
    assert scene.model_copy().units.name("m/s") == "°/s"
    assert load_scene(scenes["rad"]).written == ()


def test_a_record_of_a_scene_with_degrees_is_read_in_degrees(hapsim: Hapsim, tmp_path: Path) -> None:
    scene, record = tmp_path / "knob.yaml", tmp_path / "knob.trace"
    scene.write_text(IN_DEGREES, encoding="utf-8")
    assert hapsim("run", scene, "--duration", "0.1", "--record", record).status == 0
    assert load_trace(record).report.units_of(0)(math.pi, "m") == "180°"
    assert Record(record).scene.written == Columns(record).scene.written == DEGREES


def test_the_live_line_of_a_scene_with_degrees(tmp_path: Path) -> None:
    scene = tmp_path / "knob.yaml"
    scene.write_text(IN_DEGREES, encoding="utf-8")
    load(str(scene))
    progress = Progress(phase="running", position=(math.radians(12.0),), force=(0.25,))
    assert "+12.00° +0.250 N·m" in _Words("the mock device").of(progress)
    set_output_units(LINEAR)


def test_the_page_gets_values_in_si_units(knob: Path) -> None:
    (channel,) = channels_of(load_scene(knob))
    assert channel.unit_position == "rad"
    knob.write_text(IN_DEGREES, encoding="utf-8")
    (channel,) = channels_of(load_scene(knob))
    assert (channel.unit_position, channel.unit_force) == ("rad", "N·m")
    assert channel.travel == (-math.pi / 2, 1.5)
