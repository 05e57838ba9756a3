"""`hapsim identify`: what it says before it pushes, what it prints, and what it writes."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.device.mock import assemble_mock
from hapsim.measuring.identify_device import identify_device
from hapsim.measuring.identify_transmission import identify_transmission
from hapsim.scene import Known, load_scene, parse_scene
from hapsim.scene.shipped import shipped_scene

Hapsim = Callable[..., Any]


MOCK = "mock:\n  mass: 0.15\n  friction: 1.6\n  delay: 1.4\n  coulomb: 0.1\n"
WRONG = shipped_scene("first_touch.yaml").replace("clock: device ", "clock: lockstep ").replace("mock:\n", MOCK, 1)
"""The first scene in virtual time, of which the mock is another device than the file says."""


@pytest.fixture
def wrong_scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(WRONG, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def found_once() -> dict[str, Any]:
    scenes = parse_scene(WRONG), parse_scene(BELT)
    return {
        "identify_device": identify_device(scenes[0], duration=1.0),
        "identify_transmission": identify_transmission(scenes[1], duration=13.0),
    }


@pytest.fixture
def known(found_once: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Every identification finds what WRONG and BELT have, at once: for tests of what is shown and written of it."""
    for name, found in found_once.items():
        monkeypatch.setattr(f"hapsim.cli.identify.{name}", lambda *_, found=found, **__: found)


def test_it_announces_what_it_will_do_and_shows_declared_and_found(hapsim: Hapsim, wrong_scene: Path) -> None:
    before = wrong_scene.read_bytes()
    answer = hapsim("identify", wrong_scene, "--duration", 1, "--force", 2)
    assert answer.status == 0
    assert answer.err.startswith(
        "Pushing channel 0 of the built-in mock to both sides with at most 2 N. This takes about 1 s, "
    )
    assert "more than 5 mm from where it is now" in answer.err
    row = next(line for line in answer.out.splitlines() if "mass  kg" in line)
    assert [cell.strip() for cell in row.split("│")][2] == "0.2"
    assert "-25 %" in row
    assert re.search(r"It has dry friction, 0\.(0999|1000)\d* N", answer.out)
    assert "`mock.coulomb`" in answer.out
    assert "The file was not changed: --write writes" in answer.out
    assert wrong_scene.read_bytes() == before


@pytest.mark.usefixtures("known")
def test_values_written_are_those_of_the_scene(hapsim: Hapsim, wrong_scene: Path) -> None:
    answer = hapsim("identify", wrong_scene, "--duration", 1, "--write", "--json")
    assert answer.status == 0
    document = answer.document
    assert document["declared"] == {"mass": 0.2, "friction": 1.0, "stiffness": 0.0, "delay": 1.0}
    assert document.keys() >= {
        "identified",
        "force_n",
        "travel_m",
        "peak_m",
        "drives",
        "residual_m",
        "misfit",
        "written",
    }
    assert document["misfit"] is None
    for name, truth in {"mass": 0.15, "friction": 1.6, "delay": 1.4, "coulomb": 0.1, "stiffness": 0.0}.items():
        found = document["identified"][name]
        assert abs(found["value"] - truth) < 4.5 * found["uncertainty"] < 1e-2
    device = load_scene(wrong_scene).device
    written = document["written"]
    assert isinstance(device.mass, Known)
    assert written == {
        "mass": device.mass.model_dump(),
        "friction": device.friction,
        "delay": device.delay,
    }
    assert device.sensors == ()
    assert document["acceleration_sensor"]["age"] is None, "no force begins to act at a sample"
    assert device.mass.value == pytest.approx(0.15, rel=1e-5)
    stated = document["identified"]["mass"]["uncertainty"]
    assert device.mass.uncertainty == pytest.approx(stated, rel=0.05)  # to two digits, and the value to the same place
    assert re.search(r"mass: \{value: 0\.15\d*, uncertainty: \d\.\de-0\d\}", wrong_scene.read_text(encoding="utf-8"))
    assert "# kg, moving part and hand" in wrong_scene.read_text(encoding="utf-8")


@pytest.mark.usefixtures("known")
def test_it_prints_what_stands_in_the_file_and_each_number_with_its_unit(hapsim: Hapsim, wrong_scene: Path) -> None:
    text = wrong_scene.read_text(encoding="utf-8")
    wrong_scene.write_text(text.replace("mass: 0.2 ", "mass: 200 g ", 1), encoding="utf-8")
    answer = hapsim("identify", wrong_scene, "--duration", 1, "--write")
    line = next(line for line in answer.out.splitlines() if line.startswith("Wrote into `device` of "))
    mass = r"mass: \{value: 15\S+ g, uncertainty: \S+ g\}"
    found = re.search(rf": ({mass}), (friction: \S+), (delay: \S+)\.$", line)
    assert found, line
    for entry in found.groups():
        assert re.search(rf"\n  {re.escape(entry)}\s", wrong_scene.read_text(encoding="utf-8"))
    assert re.search(r"at simulated \(K, B\) of \(\S+ N/m, \S+ N·s/m\), \(", answer.out)


def test_the_age_of_an_acceleration_that_the_scene_reads_is_written(hapsim: Hapsim, wrong_scene: Path) -> None:
    text = wrong_scene.read_text(encoding="utf-8").replace("  delay: 1.4\n", "")
    text = text.replace("device:\n", "device:\n  sensors: [velocity, acceleration]  # of the motor\n", 1)
    wrong_scene.write_text(text.replace("mock:\n", "mock:\n  acceleration_age: 1\n", 1), encoding="utf-8")
    answer = hapsim("identify", wrong_scene, "--duration", 1, "--write")
    assert re.search(
        r"^Its acceleration sensor shows (1\.0|0\.9)\S+ times the .*, and an age of 1\.$", answer.out, re.M
    )
    assert "Warning: the sensed acceleration is that just before a force begins to act: found device." in answer.out
    device = load_scene(wrong_scene).device
    assert device.sensors == ("velocity", "acceleration")
    assert device.acceleration_age == 1
    assert "\n  sensors: [velocity, acceleration]  # of the motor\n" in wrong_scene.read_text(encoding="utf-8")
    answer = hapsim("identify", wrong_scene, "--duration", 1, "--json")
    assert answer.document["acceleration_sensor"]["age"] == 1
    assert answer.document["acceleration_sensor"]["scale"]["value"] == pytest.approx(1.0, abs=1e-3)


def test_a_sensor_of_a_wrong_scale_is_named_and_not_written(
    hapsim: Hapsim, wrong_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assemble = assemble_mock.assemble_mock

    def wrong(scene: Any) -> Any:
        mock = assemble(scene)
        mock.converters["acceleration_quantum"] *= 0.5  # it sends twice the counts
        return mock

    monkeypatch.setattr(assemble_mock, "assemble_mock", wrong)
    answer = hapsim("identify", wrong_scene, "--duration", 1, "--write")
    assert re.search(r"^Warning: the sensed acceleration is 2 times that of the motion: its scale is", answer.out, re.M)
    assert load_scene(wrong_scene).device.sensors == ()


@pytest.mark.usefixtures("known")
def test_a_span_of_masses_stays(hapsim: Hapsim, wrong_scene: Path) -> None:
    text = wrong_scene.read_text(encoding="utf-8")
    wrong_scene.write_text(text.replace("mass: 0.2 ", "mass: {from: 0.1, to: 0.4} ", 1), encoding="utf-8")
    answer = hapsim("identify", wrong_scene, "--duration", 1, "--write")
    assert answer.status == 0
    assert "The mass stays: the file gives a span for it" in answer.out
    device = load_scene(wrong_scene).device
    assert device.mass_spans(1) == ((0.1, 0.4),)
    assert device.delay == pytest.approx(1.4, abs=1e-4)


@pytest.mark.usefixtures("known")
def test_the_residual_is_drawn_and_printed_in_numbers(hapsim: Hapsim, wrong_scene: Path) -> None:
    picture, data = wrong_scene.with_name("left.svg"), wrong_scene.with_name("left.csv")
    answer = hapsim("identify", wrong_scene, "--duration", 1, "--picture", picture, "--data", data)
    assert answer.status == 0
    assert "position residual" not in answer.out
    assert picture.read_text(encoding="utf-8").lstrip().startswith("<?xml")
    rows = np.genfromtxt(data, delimiter=",", names=True)
    assert rows.dtype.names == (
        "run",
        "time_s",
        "position_m",
        "position_residual_m",
        "velocity_m_s",
        "force_residual_N",
    )
    assert set(rows["run"]) == {0, 1, 2}
    assert np.std(rows["position_residual_m"]) == pytest.approx(1e-9 / np.sqrt(12.0), rel=0.1)
    windows = rows[np.isfinite(rows["force_residual_N"])]
    assert 50 < windows.size < rows.size
    assert np.max(np.abs(windows["force_residual_N"])) < 1e-3


@pytest.mark.parametrize(
    ("options", "status", "sentence"),
    [
        (("--force", 20), 2, "force: found 20 N, expected above 0 N, and at most the force_limit, 10 N"),
        (("--channel", 4), 2, "channel 4: the scene has nothing there"),
        (("--travel", 1e-5), 4, "beyond the allowed 0.01 mm"),
        (("--mock", "--port", "/dev/null", "--write"), 2, "found both, expected one of them"),
    ],
)
def test_what_goes_wrong_is_a_sentence_and_a_status(
    hapsim: Hapsim, wrong_scene: Path, options: tuple[Any, ...], status: int, sentence: str
) -> None:
    before = wrong_scene.read_bytes()
    answer = hapsim("identify", wrong_scene, *options, "--json")
    assert answer.status == status
    assert sentence in answer.sentence
    assert wrong_scene.read_bytes() == before


@pytest.mark.usefixtures("known")
def test_a_transmission_of_the_scene_needs_its_option_to_be_identified(hapsim: Hapsim, wrong_scene: Path) -> None:
    text = wrong_scene.read_text(encoding="utf-8").replace("device:\n", "device:\n  motor_lag: 1e-4\n", 1)
    wrong_scene.write_text(text, encoding="utf-8")
    answer = hapsim("identify", wrong_scene, "--duration", 1)
    assert "motor lag is no part of this fit of one mass; --transmission fits it." in answer.words
    assert "--write writes" not in answer.out


def test_the_mock_of_a_device_with_a_port_is_not_written_in_its_place(hapsim: Hapsim, wrong_scene: Path) -> None:
    text = wrong_scene.read_text(encoding="utf-8").replace("device:\n", "device:\n  port: /dev/ttyACM9\n", 1)
    wrong_scene.write_text(text, encoding="utf-8")
    refusal = hapsim("identify", wrong_scene, "--mock", "--write").refusal
    assert "what is found of the mock is not its device's" in refusal


BELT = """version: 1
rate: 1000
device:
  clock: lockstep
  mass: 200 g   # with a hand
  delay: 1
mock:
  mass: 0.15
  friction: 1
  quantum: 2e-6
  motor_lag: 2e-4
  transmission: {stiffness: 20000, damping: 1.5, motor_mass: 0.05}
modules:
  hand: {type: device, channel: 0}
"""


@pytest.mark.usefixtures("known")
def test_a_transmission_is_shown_drawn_and_written(hapsim: Hapsim, tmp_path: Path) -> None:
    path, data = tmp_path / "belt.yaml", tmp_path / "belt.csv"
    path.write_text(BELT, encoding="utf-8")
    options = ("--transmission", "--duration", 13, "--write")
    answer = hapsim("identify", path, *options, "--picture", tmp_path / "belt.svg", "--data", data)
    assert answer.status == 0
    assert "Let go of it: no hand may hold it" in answer.err
    assert re.search(r"motor's mass  g +│ +0 │ +(49\.9|50\.0)\d* .*│ +\+50 │", answer.out)
    assert re.search(r"spring of its own  N/m +│ +0 │ .*│ +agrees │", answer.out)
    assert "Motor and handle are two masses: one mass leaves errors of" in answer.out
    assert "The position is the motor's: it hardly moves at 71." in answer.out
    assert "stays that of device and hand" in answer.out
    assert (tmp_path / "belt.svg").stat().st_size > 10_000
    rows = np.genfromtxt(data, delimiter=",", names=True)
    apart = rows["measured_re_m_per_N"] - rows["two_masses_re_m_per_N"]
    assert np.median(np.abs(apart) / rows["uncertainty_m_per_N"]) < 2.0
    scene = load_scene(path)
    drive = scene.device.drives(1)[0]
    assert drive.stiffness == pytest.approx(20000.0, rel=0.02)
    assert drive.motor_mass == pytest.approx(0.05, rel=0.02)
    assert drive.lag == pytest.approx(2e-4, abs=1e-5)
    assert scene.device.masses(1) == (0.2,)
    assert "mass: 200 g   # with a hand" in path.read_text(encoding="utf-8")


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mock:\n", "mock:\n  hand: {stiffness: 300, damping: 3}\n", "is a hand on it? If not, correct that value"),
        ("mass: 200 g", "mass: 100 g", "is a hand on it? If not, `device.mass` is too small"),
        ("motor_mass: 0.05", "motor_mass: 0.05, sensor: handle", "cannot tell the motor's mass from the stiffness"),
    ],
    ids=["held", "heavier than with a hand", "sensor at the handle"],
)
def test_no_transmission_is_written_that_a_hand_or_the_sensor_hides(
    hapsim: Hapsim, tmp_path: Path, old: str, new: str, words: str
) -> None:
    path = tmp_path / "belt.yaml"
    path.write_text(BELT.replace(old, new), encoding="utf-8")
    answer = hapsim("identify", path, "--transmission", "--duration", 13, "--write")
    assert answer.status == 0
    assert words in answer.out
    assert load_scene(path).device.transmission is None


@pytest.mark.thorough
def test_a_declared_motor_behind_a_sensor_at_the_handle_is_neither_found_nor_written(
    hapsim: Hapsim, tmp_path: Path
) -> None:
    path, belt = tmp_path / "belt.yaml", "transmission: {stiffness: 20 N/mm, motor_mass: 25 g, sensor: handle}"
    text = BELT.replace("motor_mass: 0.05", "motor_mass: 0.05, sensor: handle")
    path.write_text(text.replace("  delay: 1\n", f"  delay: 1\n  friction: 0.5\n  {belt}\n"), encoding="utf-8")
    answer = hapsim("identify", path, "--transmission", "--duration", 13, "--write")
    assert "motor's mass  g" not in answer.out
    assert "motor lag hold for the declared motor's mass, 25 g, which is not found and not written" in " ".join(
        answer.out.split()
    )
    assert re.search(r"friction  N·s/mm +│ +0\.0005 │ .*│ +\+\d+ % │", answer.out)
    assert "Dry friction adds to the friction that is found" in answer.out
    drive = load_scene(path).device.drives(1)[0]
    assert drive.motor_mass == 0.025
    assert drive.stiffness == pytest.approx(20000.0 * (0.025 * 0.125) / (0.05 * 0.1), rel=0.02)
    assert "motor_mass: 25 g" in path.read_text("utf-8")


@pytest.mark.usefixtures("known")
def test_the_document_of_a_transmission_has_the_evidence(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "belt.yaml"
    path.write_text(BELT, encoding="utf-8")
    document = hapsim("identify", path, "--transmission", "--duration", 13, "--json").document
    assert (document["masses"], document["sensor"], document["written"]) == (2, "motor", None)
    assert document["one_mass_error"] > 4.0 * document["two_masses_error"]
    assert document["identified"]["resonance_hz"]["value"] == pytest.approx(123.28, rel=0.01)


ADMITTANCE = """
version: 1
rate: 1 kHz
device:
  mode: admittance
  simulated_mass: 0.2 kg
  simulated_damping: 20 N·s/m
  assumed_hand: {stiffness: 300 N/m}
  servo: {bandwidth: 60 Hz, damping: 0.9}  # as guessed
  clock: lockstep
mock:
  servo: {bandwidth: 45 Hz, damping: 1.1}
  hand: {mass: 0.05 kg}
modules:
  hand: {type: device, channel: 0}
"""


def test_in_admittance_it_commands_chirps_and_writes_the_servo(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "servo.yaml"
    path.write_text(ADMITTANCE, encoding="utf-8")
    answer = hapsim("identify", path, "--duration", 4, "--write")
    assert answer.status == 0
    assert answer.err.startswith("Commanding chirps to channel 0 of the built-in mock, less than 5 mm to both sides.")
    assert "servo's bandwidth  Hz" in answer.out
    assert "Wrote into `device` of" in answer.out
    written = re.search(r"servo: \{bandwidth: (.*) Hz, damping: (.*)\}  # as guessed", path.read_text(encoding="utf-8"))
    assert written
    assert [*map(float, written.groups())] == pytest.approx([45.0, 1.1], rel=1e-3)
    refusal = hapsim("identify", path, "--transmission").refusal
    assert "--transmission: found with device.mode: admittance, whose servo is identified; omit it" in refusal
