"""`hapsim check`: what it reports of every kind of scene, and the keys that scripts rely on."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hapsim.errors import UsageError
from hapsim.prediction import predict
from hapsim.running import start
from hapsim.scene import load_scene

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]
Explained = Callable[[Path], Any]
Checked = Callable[[Path], dict[str, Any]]

SPRING = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 1000.0, "damping": 5.0}


def test_every_scene_is_reported_in_words_and_in_json(
    hapsim: Hapsim, scene_file: SceneFile, checked: Checked, every_scene: str
) -> None:
    told = hapsim("check", scene_file(every_scene))
    assert (told.status, told.err) == (0, "")
    assert "at 1000 Hz: " in told.out
    assert "nan" not in told.out
    document = checked(scene_file(every_scene))
    assert {"predicted", "stable", "dominant", "here", "spectral_radius", "rate_hz"} <= document.keys()
    assert document["predicted"] is None or document["predicted"].keys() >= {"k", "b", "frequency_hz", "damping_ratio"}
    assert all(len(pole) == 2 for pole in document["here"]["poles"])
    assert document["rate_hz"] == 1000
    largest = max(abs(complex(*pole)) for pole in document["here"]["poles"])
    assert document["spectral_radius"] == pytest.approx(largest, rel=1e-12)


@pytest.mark.parametrize("correction", ["none", "poles"])
def test_the_answer_fits_on_a_small_terminal_with_the_verdict_first(
    hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, correction: str
) -> None:
    path = Path(scene_file("spring", correction=correction).name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    answer, document = hapsim("check", path), hapsim("check", path, "--json").document
    lines = answer.out.splitlines()
    assert len(lines) <= 13
    assert "at 1000 Hz: stable" in lines[0]
    (row,) = (line.split() for line in lines if line.strip().startswith("hand: k"))
    assert [float(word) for word in row[2:5]] == pytest.approx(
        [1000.0, document["predicted"]["k"], document["predicted"]["steady_stiffness"]], rel=1e-5
    )
    for beginning in ("Smallest gain margin: unstable at ", "Wire: ", "Guards: force 10 N"):
        assert any(line.startswith(beginning) for line in lines)


def test_travel_and_origin_are_printed_and_a_band_that_is_too_narrow_is_refused(
    hapsim: Hapsim, scene_file: SceneFile, checked: Checked
) -> None:
    path = scene_file("spring")
    assert checked(path)["travel"] == {"limits_m": None, "margin_m": None, "origin_m": [0.0]}
    assert "Travel" not in hapsim("check", path).out
    path = scene_file("spring", travel=[-0.01, 0.11], origin="here")
    told = hapsim("check", path).words
    assert (
        "Travel: -0.01 to 0.11 m. Outside, the force fades to zero within 0.012 m (a stiffness of up to 833.3" in told
    )
    assert "Origin: position 0 is where the device is when it is armed." in told
    assert checked(path)["travel"] == {
        "limits_m": [[-0.01, 0.11]],
        "margin_m": [pytest.approx(0.012)],
        "origin_m": ["here"],
    }
    told = hapsim("check", scene_file("two_hands", travel=[[-0.01, 0.11], [-0.03, 0.03]])).words
    assert "Travel of channel 1: -0.03 to 0.03 m. Outside, the force fades to zero within 0.006 m (a stiffness" in told
    alike = hapsim("check", scene_file("two_hands", travel=[-0.01, 0.11], origin="here")).words
    assert alike.count("Travel of channels 0 and 1: ") == alike.count("Origin of channels 0 and 1: ") == 1
    refused = hapsim("check", scene_file("spring", travel=[-0.01, 0.11], travel_margin=0.0024), "--json").refusal
    assert "fades over 0.0024 m, a stiffness of 4167 N/m" in refused
    assert "is stable up to 4033 N/m; expected at least 0.00248 m" in refused


def test_what_makes_an_unstable_scene_stable_does(
    scene_file: SceneFile, checked: Checked, explained: Explained
) -> None:
    """The sentence, the table and JSON give the same damping range. The scene is stable in it and unstable just
    outside."""

    def scene(damping: float) -> Path:
        return scene_file("spring", touch={"stiffness": 4000.0, "damping": damping})

    (margin,) = checked(scene(5.0))["margins"].values()
    ((least, most),) = margin["stabilizing_damping_factors"]
    stiffness = [[0.0, margin["stiffness_factor"]]]
    assert (margin["damping_factor"], margin["stabilizing_stiffness_factors"]) == (None, stiffness)
    told = explained(scene(5.0))
    row = next(line for line in told.out.splitlines() if line.startswith("│") and " to " in line)
    low, high = (float(word) for word in row.split("│")[-2].split(" to "))
    assert least <= low < least * 1.001
    assert most * 0.999 < high <= most
    assert "0: no factor" not in told.words
    between = told.words.partition("where the damping is between ")[2].split(" N·s/m")[0]
    for factor, stable in ((low, True), (high, True), (least * 0.999, False), (most * 1.001, False)):
        assert checked(scene(5.0 * factor))["stable"] is stable, factor
    for damping in between.split(" and "):
        assert checked(scene(float(damping)))["stable"] is True, damping


def test_where_no_factor_makes_a_scene_stable_there_is_a_dash(
    scene_file: SceneFile, checked: Checked, explained: Explained
) -> None:
    path = scene_file("spring", touch={"stiffness": 4000.0, "damping": 0.0})
    told = explained(path)
    assert "(–: no factor)" in told.words
    assert [line.split("│")[-2].strip() for line in told.out.splitlines() if "or less │" in line] == ["–"]
    (margin,) = checked(path)["margins"].values()
    assert (margin["damping_factor"], margin["stabilizing_damping_factors"]) == (None, [])


@pytest.mark.parametrize("name", ["free", "damper"])
def test_a_hand_that_nothing_pulls_back_is_not_called_unstable(
    scene_file: SceneFile, explained: Explained, name: str
) -> None:
    told = explained(scene_file(name))
    assert "stable (hand moves freely; the rest 0.9" in told.words
    assert "There is no stiffness to have a margin." in told.out


@pytest.mark.parametrize(
    ("share", "ends"),
    [(0.05, ["free", "free"]), (0.05, ["fixed", "free"]), (0.5, ["free", "free"])],
    ids=["free", "hinged", "large"],
)
def test_a_bar_that_nothing_keeps_from_turning_is_not_called_unstable(
    hapsim: Hapsim, scene_file: SceneFile, large: int, share: float, ends: list[str]
) -> None:
    masses = int(share * large)
    bar = {"type": "string", "masses": masses, "mass": 0.001, "stiffness": 0, "ends": ends}
    limit = "at the limit between stable and unstable: something drifts"
    stiff = "Hz: unstable (spectral radius"
    for bending, verdict in ((50, limit), (400, stiff)):  # 400 is well above m/(4 T²)
        assert verdict in hapsim("check", scene_file("free", more={"bar": bar | {"bending": bending}})).out


@pytest.mark.parametrize("name", ["mass", "mass_on_channel_2", "hand_in_hand"])
def test_a_scene_with_masses_lists_modes_and_states_that_there_is_no_single_k_and_b(
    scene_file: SceneFile, checked: Checked, explained: Explained, name: str
) -> None:
    told = explained(scene_file(name)).words
    why = "is joined to another hand (wall, by touch)" if name == "hand_in_hand" else "also moves a mass of the scene ("
    assert f"hand {why}" in told
    assert "Modes" in told
    document = checked(scene_file(name))
    assert (document["predicted"], document["dominant"]) == (None, False)
    assert "hand" in document["parts"][0]["why"]
    assert document["modes"]


def chain(tmp_path: Path, masses: int, mass: float, damping: float, grown: float = 1.0) -> Path:
    """A hand, and a row of masses that it pulls. `grown`: times the stiffness of link 1."""
    row = ["hand", *(f"m{i}" for i in range(masses)), "wall"]
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    modules |= {name: {"type": "mass", "mass": mass} for name in row[1:-1]}
    for i in range(masses + 1):
        link = {"between": row[i : i + 2], "stiffness": 5000.0 * (grown if i == 1 else 1.0), "damping": damping}
        modules[f"l{i}"] = SPRING | link
    path = tmp_path / "many.yaml"
    device = {"mass": 0.2, "friction": 20.0}
    path.write_text(yaml.safe_dump({"version": 1, "rate": 1000, "device": device, "modules": modules}))
    return path


@pytest.mark.thorough
def test_a_large_scene_is_judged_by_some_of_its_poles_and_names_them(
    hapsim: Hapsim, checked: Checked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, large: int
) -> None:
    monkeypatch.setattr("hapsim.cli.check.predict", cache(predict))  # the same for words and JSON
    path = chain(tmp_path, large // 2, 0.1, 0.5)
    assert "poles were worked out: those nearest to 1, to -1" in hapsim("check", path).words
    document = checked(path)
    assert document["stable"] is True
    assert document["spectral_radius"] < 1.0
    assert document["here"]["poles_in_all"] > large
    assert "poles were worked out" in document["here"]["poles_method"]
    assert document["margins"]["l0"]["stiffness_factor"] > 1.0
    diverging = checked(chain(tmp_path, large // 2, 1e-9, 0.0))
    assert diverging["stable"] is False
    assert diverging["spectral_radius"] > 1.0


def test_a_gain_margin_is_printed_once(scene_file: SceneFile, checked: Checked, explained: Explained) -> None:
    told = explained(scene_file("spring")).out
    factor = checked(scene_file("spring"))["margins"]["touch"]["stiffness_factor"]
    assert f" {factor:.4g} " in told
    assert "the loop becomes unstable at" not in told
    # Of two links on one hand, the hand's margin is neither's.
    assert "Gain margin: the loop becomes unstable at" in explained(scene_file("spring", more={"more": SPRING})).out


def test_each_link_is_reported_with_its_gain_margin(checked: Checked, tmp_path: Path, explained: Explained) -> None:
    path = chain(tmp_path, 3, 0.1, 0.5)
    document = checked(path)
    assert document["here"]["poles_method"].startswith("every pole")
    assert set(document["margins"]) == {"l0", "l1", "l2", "l3"}
    assert "Gain margins" in explained(path).out
    factor = document["margins"]["l1"]["stiffness_factor"]
    for grown, stable in ((0.999 * factor, True), (1.001 * factor, False)):
        assert checked(chain(tmp_path, 3, 0.1, 0.5, grown))["stable"] is stable
    assert "For the scene to be stable" in explained(path).out


def test_a_hand_whose_dampers_are_of_several_kinds_has_no_single_k_and_b(
    scene_file: SceneFile, checked: Checked
) -> None:
    dampers = {"one": "centred", "other": "backward"}
    more = {name: SPRING | {"damping": 1.0, "damper": damper} for name, damper in dampers.items()}
    document = checked(scene_file("spring", more=more))
    assert (document["predicted"], document["stable"]) == (None, True)
    assert "has dampers of several kinds (other: backward, one: centred)" in document["parts"][0]["why"]["hand"]


def test_a_stiffness_beyond_reason_is_reported_without_a_warning(scene_file: SceneFile, checked: Checked) -> None:
    assert checked(scene_file("no_number"))["stable"] is False


def test_a_file_name_is_shown_as_it_is_written(hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path) -> None:
    """Square brackets mean something to the library that prints."""
    path = scene_file("spring").rename(tmp_path / "a[red]b[link].yaml")
    told = hapsim("check", path)
    assert told.status == 0
    assert "a[red]b[link].yaml" in told.out.replace("\n", "")


def test_assumptions_that_differ_in_a_name_alone_are_one(hapsim: Hapsim, tmp_path: Path) -> None:
    masses = "".join(
        f"  m{i}: {{type: cell, mass: 0.1, stiffness: 50, damping: 1}}\n"
        f"  pad{i}: {{type: buffer, between: [hand, m{i}], stiffness: 300}}\n"
        for i in range(3)
    )
    path = tmp_path / "pads.yaml"
    path.write_text(
        "version: 1\nrate: 1000\ndevice: {mass: 0.2}\nmodules:\n  hand: {type: device, channel: 0}\n" + masses
    )
    told = hapsim("check", path).words
    assert told.count("Assumed:") == 1
    assert "Assumed: pad0 touches all the time; " in told
    assert "The same holds for pad1, pad2." in told


def test_a_wire_that_is_too_slow_is_reported(hapsim: Hapsim, scene_file: SceneFile, checked: Checked) -> None:
    """A mock without a baud rate has no wire, and `check` says so."""
    verdict = "does not fit: use a higher baud rate or a lower rate."
    told = hapsim("check", scene_file("spring", baud=115200)).out
    assert "Wire: none (the mock). A UART at 115200 baud would not fit: 2.047 ms of 1 ms.\n" in told
    assert "does not fit" not in told
    told = hapsim("check", scene_file("spring", baud=115200, port="/dev/ttyNONE")).out
    assert f"Wire: on a UART an exchange takes 2.047 ms of 1 ms: {verdict}" in " ".join(told.split())
    assert checked(scene_file("spring", baud=115200))["wire_time"]["fits"] is False


def test_a_wire_that_costs_a_sample_is_predicted_at_the_delay_that_results(
    scene_file: SceneFile, checked: Checked, explained: Explained
) -> None:
    """23 bytes at 115200 baud take 1.997 ms: with the host's work they miss a tick at 500 Hz, and not at 480 Hz."""

    def wire(rate: float, delay: float) -> dict[str, Any]:
        path = scene_file("spring", rate=rate, baud=115200, port="/dev/ttyACM77", delay=delay)
        return checked(path) | {"text": explained(path).words}

    late, declared, fits = wire(500.0, 1.0), wire(500.0, 2.0), wire(480.0, 1.0)
    assert (late["wire_time"]["fits"], late["wire_time"]["delay_samples"]) == (False, 2)
    assert late["wire_time"]["predicted"] == declared["predicted"] | {"delay": 2.0}
    assert late["predicted"]["b"] > 1.5 * late["wire_time"]["predicted"]["b"]  # the declared delay is reported too
    assert 488.0 < late["wire_time"]["highest_rate_hz"] < 489.0
    assert "2 samples of delay. One sample below 488 Hz or above 117949 baud" in late["text"]
    assert f"b = {declared['predicted']['b']:.6g} N·s/m" in late["text"]
    assert (fits["wire_time"]["delay_samples"], fits["wire_time"]["predicted"]) == (1, None)
    assert "takes 1.997 ms for 11 + 12 bytes at 115200 baud and 0.05 ms for the host's work; " in fits["text"]
    assert "fits. The delay is one sample at rates up to 488 Hz" in fits["text"]
    assert "This is counted for a UART" in fits["text"]
    queueing = wire(1100.0, 1.0)  # 12 bytes take 1.04 ms
    assert (queueing["wire_time"]["delay_samples"], queueing["wire_time"]["predicted"]) == (None, None)
    assert "frames queue up" in queueing["text"]


def test_the_bound_of_the_force_is_stated_for_the_position_of_the_device(
    scene_file: SceneFile, checked: Checked, explained: Explained
) -> None:
    path = scene_file("spring")
    bounds = {"slew_limit": None, "soft_start_s": 0.0, "energy_limit": pytest.approx(0.2)}
    assert checked(path)["force_bounds"] == bounds
    told = explained(path).words
    assert "Force: at most 10 N, without a slew limit." in told
    assert "The force of the first sample acts at once." in told
    assert "A run ends if the scene gives the hand more than 0.2 J, or keeps" in told
    assert "slew_limit" not in told
    told = explained(scene_file("spring", clock="device")).words
    assert "With a device (`--port`), the slew limit is 10000 N/s, and" in told
    assert "the force of the first sample ramps up over 64 ms;" in told
    told = explained(scene_file("spring", clock="device", port="/dev/ttyACM0")).words
    assert "with a slew limit of 10000 N/s" in told
    assert "With a device" not in told
    assert "The force of the first sample ramps up over 64 ms; later changes" in told
    told = explained(scene_file("spring", clock="device", port="/dev/ttyACM0", slew_limit=5.0)).words
    assert "found 5 N/s, with which the force takes 2 s from zero to the force limit of 10 N" in told


def test_a_slew_limit_that_a_run_refuses_is_warned_of_and_not_called_stable(
    hapsim: Hapsim, scene_file: SceneFile, checked: Checked
) -> None:
    path = scene_file("spring", slew_limit=1e-12)
    refused = hapsim("run", path, "--duration", "0.01").refusal
    told = hapsim("check", path).words
    assert "Hz: stable without its slew limit: see the warning (spectral radius" in told
    count, slow = checked(path)["warnings"]
    assert refused.strip() in count
    assert count in told
    assert "the force takes 1e+13 s from zero" in slow
    with pytest.raises(UsageError, match=r"less than a count of the device's force"), start(load_scene(str(path))):
        pass
    expected = float(count.partition("at least ")[2].split(" ")[0])
    enough = checked(scene_file("spring", slew_limit=expected))["warnings"]
    assert [one for one in enough if "a count of" in one] == []
    assert checked(scene_file("spring", slew_limit=0.999 * expected))["warnings"][0] != enough[0]
    behind_a_port = checked(scene_file("spring", slew_limit=1e-12, port="/dev/ttyNONE"))
    assert not any("a count of" in one for one in behind_a_port["warnings"])
    assert checked(scene_file("spring"))["warnings"] == []


def test_run_reports_its_warnings_in_json_too(hapsim: Hapsim, scene_file: SceneFile, checked: Checked) -> None:
    path = scene_file("spring", slew_limit=5.0)
    answer = hapsim("run", path, "--duration", "0.01", "--json")
    document = checked(path)
    assert answer.document["warnings"] == document["warnings"]
    assert answer.document["warnings"][0] in answer.err
    (figures,) = re.findall(
        r"\((\S+) Hz\) has a quarter period of (\S+) ms; .* needs (\d+) N/s", document["warnings"][0]
    )
    swing = document["predicted"]["frequency_hz"]
    assert [float(figure) for figure in figures] == pytest.approx([swing, 250 / swing, 20 * np.pi * swing], rel=2e-3)


@pytest.mark.parametrize(
    ("name", "device", "told"),
    [
        (
            "spring",
            {"mass": 0.2, "friction": 1.0, "delay": 1},
            "0.2 kg, friction 1 N·s/m, delay 1 sample (1 ms), zero-order hold",
        ),
        ("spring", {"mass": 200, "delay": 0.001}, "200 kg, friction 1 N·s/m, delay 0.001 samples (0.001 ms)"),
        (
            "spring",
            {"delay": 0, "hold": "impulse", "sampling": "average", "stiffness": 50.0},
            "a spring of 50 N/m, no delay, impulse hold, averaged positions",
        ),
        ("two_hands", {"mass": [0.2, 0.3]}, "channel 0: 0.2 kg, friction 1 N·s/m; channel 1: 0.3 kg"),
    ],
)
def test_the_hand_and_device_of_a_prediction_are_stated(
    hapsim: Hapsim, scene_file: SceneFile, name: str, device: dict[str, Any], told: str
) -> None:
    assert told in hapsim("check", scene_file(name, **device)).words.partition("for a hand of ")[2]


def test_what_bounds_the_force_of_a_dead_host_is_what_a_run_asks_the_device_for(
    scene_file: SceneFile, checked: Checked, explained: Explained
) -> None:
    path = scene_file("spring")
    silence = checked(path)["host_silence"]
    asked = []

    def note(session: Any) -> None:
        asked.append(int(session._loop.control.time_to_live))

    with start(load_scene(str(path)), duration=0.01, on_arming=note):
        pass
    assert [silence["time_to_live_samples"]] == asked == [20]
    assert (silence["zero_force_after_s"], silence["latched_after_s"]) == (0.021, 0.101)
    told = explained(path).words
    assert "at most 21 ms (its time to live of 20 samples, and one more)" in told
    assert "After 101 ms (watchdog of 100 samples" in told
    assert "the device latches: zero force until it is armed again." in told


@pytest.mark.parametrize(("velocity", "limited"), [(0.01, False), (0.1, True)])
def test_measure_reports_where_the_force_was_limited(
    hapsim: Hapsim, scene_file: SceneFile, velocity: float, limited: bool
) -> None:
    path = scene_file("spring", force_limit=1.0)
    with path.open("a", encoding="utf-8") as file:
        file.write(f"mock: {{initial: {{velocity: {velocity}}}}}\n")
    said = hapsim("measure", path).words
    assert ("ticks were at the force limit: k and b hold for motions that stay below it" in said) == limited
    assert "at the slew limit" not in said


def test_the_sound_is_rendered_and_each_gain_named(hapsim: Hapsim, scene_file: SceneFile) -> None:
    ringing = {"type": "cell", "mass": 0.01, "stiffness": 4000.0, "velocity": 0.2}  # at 100 Hz
    path = scene_file("spring", more={"bell": ringing})
    pick_ups = "  {loud: {from: bell, of: velocity, gain: 0.5}, still: {from: hand, of: position}}"
    path.write_text(path.read_text().replace("rate: 1000.0", f"rate: 1000.0\nsubsteps: 20\nsound:\n{pick_ups}"))
    told = hapsim("check", path, "--explain").words
    assert "Sound: loud peaks at -20.0 dB in 2 s on the mock; gain: 2.51 makes it -6 dB." in told
    assert "Sound: loud, pitches when released: 100.7 Hz." in told
    assert "Sound: still is silent for 2 s: nothing moves hand unless a hand does." in told
    assert ", a sample 20 ticks: " in told
    peaks = hapsim("check", path, "--explain", "--json").document["sound_peaks"]
    assert peaks == {"loud": pytest.approx(0.1, rel=1e-3), "still": 0.0}


HELD = "  hand: {stiffness: 100, position: -0.03}"


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(("hand", "speed", "changed"), [(HELD, 0.5, True), ("", 0.5, True), ("", 0.01, False)])
def test_measure_reports_a_link_that_may_have_released_the_hand(
    hapsim: Hapsim, tmp_path: Path, hand: str, speed: float, changed: bool
) -> None:
    """The pick of the shipped string grips throughout a small motion of a free hand, and releases in a large one."""
    text = Path("configs/plucked_string.yaml").read_text("utf-8").replace("clock: device", "clock: lockstep")
    assert HELD in text
    path = tmp_path / "string.yaml"
    text = text if hand else text.replace(HELD, "").replace("mass: 2.0", "mass: 0.2")
    path.write_text(text.replace("velocity: 0.5", f"velocity: {speed}"), "utf-8")
    printed = hapsim("measure", path).words
    assert ("a link may have touched, released or slid during the record. k and b then mix" in printed) == changed


def test_a_linkage_s_figures_are_stated_to_hold_near_its_pose(hapsim: Hapsim, checked: Checked, tmp_path: Path) -> None:
    path = tmp_path / "linkage.yaml"
    text = Path("configs/boards/haply.yaml").read_text("utf-8")
    path.write_text(text, "utf-8")
    said = "k and b are valid near 0.019, 0.1 m (device.mass_at): elsewhere the device has another mass"
    assert said in hapsim("check", path).words
    assert said in checked(path)["assumptions"][0]
    path.write_text(text.replace("mass_at: [0.019, 0.1]", "mass_at: 0.05"), "utf-8")
    assert "near 0.05, 0.05 m" in checked(path)["assumptions"][0]
    path.write_text(re.sub("mass_at: .*", "", text), "utf-8")
    assert checked(path)["assumptions"] == []
    path.write_text(text.replace("mass_at: [0.019, 0.1]", "mass_at: [0.1]"), "utf-8")
    assert "mass_at: found 1 number, expected 2" in hapsim("check", path).err


def test_channels_that_nothing_uses_are_named(hapsim: Hapsim, scene_file: SceneFile) -> None:
    told = "a device with 3 channels, of which nothing uses 0 and 1"
    assert told in hapsim("check", scene_file("spring", more={"hand": {"type": "device", "channel": 2}})).words
    assert "nothing uses" not in hapsim("check", scene_file("spring")).out


@pytest.mark.parametrize("more", [(), ("--json",)])
def test_a_script_gets_a_status_for_an_unstable_scene(
    hapsim: Hapsim, scene_file: SceneFile, more: tuple[str, ...]
) -> None:
    for name, status in (("spring", 0), ("unstable", 2)):
        answer = hapsim("check", scene_file(name), "--require-stable", *more)
        assert (answer.status, answer.err) == (status, "")
        assert "stable" in answer.out
        assert hapsim("check", scene_file(name), *more).status == 0
