"""`hapsim check`: what it reports of every kind of scene, and the keys that scripts rely on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hapsim.errors import UsageError
from hapsim.running import start
from hapsim.scene import load_scene

FELT = {"k", "b", "frequency_hz", "damping_ratio"}


def test_every_scene_is_reported_in_words_and_in_json(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], every_scene: str
) -> None:
    told = hapsim("check", scene_file(every_scene))
    assert (told.status, told.err) == (0, "")
    assert "at 1000 Hz: " in told.out
    assert "nan" not in told.out
    answer = hapsim("check", scene_file(every_scene), "--json")
    assert (answer.status, answer.err) == (0, "")
    document = answer.document
    assert {"predicted", "stable", "dominant", "poles", "spectral_radius", "rate_hz"} <= document.keys()
    assert document["predicted"] is None or document["predicted"].keys() >= FELT
    assert all(len(pole) == 2 for pole in document["poles"])
    assert document["rate_hz"] == 1000
    largest = max(abs(complex(*pole)) for pole in document["poles"])
    assert document["spectral_radius"] == pytest.approx(largest, rel=1e-12)


@pytest.mark.parametrize("correction", ["none", "poles"])
def test_the_answer_fits_on_a_small_terminal_with_the_verdict_first(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, correction: str
) -> None:
    path = scene_file("spring", correction=correction)
    monkeypatch.setenv("COLUMNS", "80")
    answer, document = hapsim("check", path), hapsim("check", path, "--json").document
    lines = answer.out.splitlines()
    assert len(lines) <= 13
    assert "at 1000 Hz: stable" in lines[0] + lines[1]
    (row,) = (line.split() for line in lines if line.strip().startswith("hand: k"))
    assert [float(word) for word in row[2:5]] == pytest.approx(
        [1000.0, document["predicted"]["k"], document["predicted"]["steady_stiffness"]], rel=1e-5
    )
    assert any(line.startswith("Smallest gain margin: unstable at ") for line in lines)
    assert any(line.startswith("Wire: ") for line in lines)
    assert any(line.startswith("Guards: force 10 N") for line in lines)


def test_a_spring_is_predicted_with_its_k_and_b(hapsim: Callable[..., Any], scene_file: Callable[..., Path]) -> None:
    document = hapsim("check", scene_file("spring"), "--json").document
    k, b = document["predicted"]["k"], document["predicted"]["b"]
    assert document["stable"]
    assert document["dominant"]
    # To first order a held and delayed spring loses K T (1 + 1/2) of its damping.
    assert b == pytest.approx(5 + 1 - 1.5, rel=0.05)
    slowest = next(complex(*pole) for pole in document["poles"])
    s = np.log(slowest) * 1000
    assert k == pytest.approx(0.2 * abs(s) ** 2, rel=1e-6)
    assert b == pytest.approx(-2 * 0.2 * s.real, rel=1e-6)


def test_travel_and_origin_are_printed_and_a_band_that_is_too_narrow_is_refused(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path]
) -> None:
    path = scene_file("spring")
    assert hapsim("check", path, "--json").document["travel"] == {
        "limits_m": None,
        "margin_m": None,
        "origin_m": [0.0],
    }
    assert "Travel" not in hapsim("check", path).out
    document = yaml.safe_load(path.read_text())
    document["device"] |= {"travel": [-0.01, 0.11], "origin": "here"}
    path.write_text(yaml.safe_dump(document, sort_keys=False))
    told = hapsim("check", path).out.replace("\n", " ")
    assert (
        "Travel: -0.01 to 0.11 m. Outside, the force fades to zero within 0.012 m (a stiffness of up to 833.3" in told
    )
    assert "Origin: position 0 is where the device is when it is armed." in told
    assert hapsim("check", path, "--json").document["travel"] == {
        "limits_m": [[-0.01, 0.11]],
        "margin_m": [pytest.approx(0.012)],
        "origin_m": ["here"],
    }
    document["device"]["travel_margin"] = 0.0024
    path.write_text(yaml.safe_dump(document, sort_keys=False))
    refused = hapsim("check", path, "--json")
    assert refused.status == 2
    assert "fades over 0.0024 m, which is a stiffness of 4167 N/m" in refused.sentence
    assert "renders up to 4033 N/m; expected at least 0.00248 m" in refused.sentence


def test_an_unstable_scene_is_reported_as_such_and_is_no_failure(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path]
) -> None:
    told = hapsim("check", scene_file("unstable"))
    assert told.status == 0
    assert "unstable (spectral radius 1.14" in told.out
    assert "It becomes stable where the stiffness is" in told.out
    assert hapsim("check", scene_file("unstable"), "--json").document["stable"] is False


def test_what_makes_an_unstable_scene_stable_does(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], explained: Callable[[Path], str]
) -> None:
    """In the sentence, in the table and in JSON: the damping between two factors, just outside them not."""
    path = scene_file("spring")
    scene = yaml.safe_load(path.read_text())
    link = next(module for module in scene["modules"].values() if module["type"] == "viscoelastic")
    link |= {"stiffness": 4000.0, "damping": 5.0}

    def check(damping: float) -> Any:
        link["damping"] = damping
        path.write_text(yaml.safe_dump(scene))
        return hapsim("check", path, "--json").document

    document = check(5.0)
    (margin,) = document["margins"].values()
    ((least, most),) = margin["stabilizing_damping_factors"]
    assert (margin["damping_factor"], margin["stabilizing_stiffness_factors"]) == (
        None,
        [[0.0, margin["stiffness_factor"]]],
    )
    told = explained(path)
    row = next(line for line in told.splitlines() if line.startswith("│") and " to " in line)
    low, high = (float(word) for word in row.split("│")[-2].split(" to "))
    assert least <= low < least * 1.001
    assert most * 0.999 < high <= most
    assert "0: no factor" not in told.replace("\n", " ")
    between = told.replace("\n", " ").partition("where the damping is between ")[2].split(" N·s/m")[0]
    for factor, stable in ((low, True), (high, True), (least * 0.999, False), (most * 1.001, False)):
        assert check(5.0 * factor)["stable"] is stable, factor
    for damping in between.split(" and "):
        assert check(float(damping))["stable"] is True, damping


def test_where_no_factor_makes_a_scene_stable_there_is_a_dash(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], explained: Callable[[Path], str]
) -> None:
    path = scene_file("spring")
    scene = yaml.safe_load(path.read_text())
    link = next(module for module in scene["modules"].values() if module["type"] == "viscoelastic")
    link |= {"stiffness": 4000.0, "damping": 0.0}
    path.write_text(yaml.safe_dump(scene))
    told = explained(path)
    assert "(–: no factor does it)" in " ".join(told.split())
    assert [line.split("│")[-2].strip() for line in told.splitlines() if "or less │" in line] == ["–"]
    (margin,) = hapsim("check", path, "--json").document["margins"].values()
    assert (margin["damping_factor"], margin["stabilizing_damping_factors"]) == (None, [])


@pytest.mark.parametrize("name", ["free", "damper"])
def test_a_hand_that_nothing_pulls_back_is_not_called_unstable(
    scene_file: Callable[..., Path], explained: Callable[[Path], str], name: str
) -> None:
    told = explained(scene_file(name))
    assert "at the limit between stable and unstable: something drifts" in told
    assert "There is no stiffness to have a margin." in told


@pytest.mark.parametrize("masses", [10, 700])
@pytest.mark.parametrize("ends", [["free", "free"], ["fixed", "free"]], ids=["free", "hinged"])
def test_a_bar_that_nothing_keeps_from_turning_is_not_called_unstable(
    hapsim: Callable[..., Any], tmp_path: Path, masses: int, ends: list[str]
) -> None:
    bar = {"type": "string", "masses": masses, "mass": 0.001, "stiffness": 0, "bending": 50, "ends": ends}
    scene = {"version": 1, "rate": 1000, "device": {"clock": "lockstep", "mass": 0.2, "friction": 1.0}}
    path = tmp_path / "bar.yaml"
    path.write_text(yaml.safe_dump(scene | {"modules": {"hand": {"type": "device", "channel": 0}, "bar": bar}}))
    assert "at the limit between stable and unstable: something drifts" in hapsim("check", path).out
    bar["bending"] = 400  # well above m/(4 T²)
    path.write_text(yaml.safe_dump(scene | {"modules": {"hand": {"type": "device", "channel": 0}, "bar": bar}}))
    assert "Hz: unstable (spectral radius" in hapsim("check", path).out


@pytest.mark.parametrize("name", ["mass", "mass_on_channel_2", "hand_in_hand"])
def test_a_scene_with_masses_lists_modes_and_says_that_there_is_no_single_k_and_b(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], explained: Callable[[Path], str], name: str
) -> None:
    told = explained(scene_file(name))
    why = "is tied to another hand (wall, by touch)" if name == "hand_in_hand" else "moves a mass of the scene too ("
    assert f"hand {why}" in told.replace("\n", " ")
    assert "Modes" in told
    document = hapsim("check", scene_file(name), "--json").document
    assert document["predicted"] is None
    assert document["dominant"] is False
    assert "hand" in document["coupled_device_points"]
    assert document["modes"]


@pytest.mark.parametrize("name", ["channel_3", "mass_on_channel_2"])
def test_channels_that_the_scene_does_not_touch_are_no_part_of_its_stability(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], name: str
) -> None:
    document = hapsim("check", scene_file(name), "--json").document
    assert document["stable"] is True
    assert document["spectral_radius"] < 0.999
    assert not any("channel" in point for mode in document["modes"] for point in mode["participation"])


def test_two_hands_are_predicted_each_for_itself(hapsim: Callable[..., Any], scene_file: Callable[..., Path]) -> None:
    points = hapsim("check", scene_file("two_hands"), "--json").document["device_points"]
    alone = hapsim("check", scene_file("spring"), "--json").document["predicted"]
    assert points["hand"]["k"] == alone["k"]
    assert points["other"]["stiffness"] == 500


def chain(tmp_path: Path, masses: int, mass: float, damping: float) -> Path:
    """A hand, and a row of masses that it pulls."""
    row = ["hand", *(f"m{i}" for i in range(masses)), "wall"]
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    modules |= {name: {"type": "mass", "mass": mass} for name in row[1:-1]}
    for i in range(masses + 1):
        link = {"type": "viscoelastic", "between": row[i : i + 2], "stiffness": 5000.0, "damping": damping}
        modules[f"l{i}"] = link
    path = tmp_path / "many.yaml"
    device = {"mass": 0.2, "friction": 20.0}
    path.write_text(yaml.safe_dump({"version": 1, "rate": 1000, "device": device, "modules": modules}))
    return path


def test_a_large_scene_is_judged_by_some_of_its_poles_and_says_by_which(
    hapsim: Callable[..., Any], tmp_path: Path
) -> None:
    told = hapsim("check", chain(tmp_path, 600, 0.1, 0.5))
    assert "poles were worked out: those nearest to 1, to -1" in told.out.replace("\n", " ")
    document = hapsim("check", chain(tmp_path, 600, 0.1, 0.5), "--json").document
    assert document["stable"] is True
    assert document["spectral_radius"] < 1.0
    assert document["poles_in_all"] > 1200
    assert "poles were worked out" in document["poles_method"]
    assert document["margins"]["l0"]["stiffness_factor"] > 1.0


def test_a_large_scene_that_diverges_is_called_unstable(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    document = hapsim("check", chain(tmp_path, 600, 1e-9, 0.0), "--json").document
    assert document["stable"] is False
    assert document["spectral_radius"] > 1.0


def test_a_gain_margin_is_said_once(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], explained: Callable[[Path], str]
) -> None:
    told = explained(scene_file("spring"))
    factor = hapsim("check", scene_file("spring"), "--json").document["margins"]["touch"]["stiffness_factor"]
    assert f" {factor:.4g} " in told
    assert "the loop becomes unstable at" not in told
    path = scene_file("spring")  # of two links on one hand, the hand's margin is neither's
    document = yaml.safe_load(path.read_text())
    document["modules"]["more"] = document["modules"]["touch"]
    path.write_text(yaml.safe_dump(document))
    assert "Gain margin: the loop becomes unstable at" in explained(path)


def test_each_link_is_reported_with_its_gain_margin(
    hapsim: Callable[..., Any], tmp_path: Path, explained: Callable[[Path], str]
) -> None:
    path = chain(tmp_path, 3, 0.1, 0.5)
    document = hapsim("check", path, "--json").document
    assert document["poles_method"].startswith("every pole")
    assert set(document["margins"]) == {"l0", "l1", "l2", "l3"}
    assert "Gain margins" in explained(path)
    factor = document["margins"]["l1"]["stiffness_factor"]
    text = path.read_text()
    for grown, stable in ((0.999 * factor, True), (1.001 * factor, False)):
        scene = yaml.safe_load(text)
        scene["modules"]["l1"]["stiffness"] *= grown
        path.write_text(yaml.safe_dump(scene))
        assert hapsim("check", path, "--json").document["stable"] is stable
    assert "For the scene to be stable" in explained(path)


def test_a_hand_whose_dampers_are_of_several_kinds_has_no_single_k_and_b(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path]
) -> None:
    path = scene_file("spring")
    scene = yaml.safe_load(path.read_text())
    link = next(module for module in scene["modules"].values() if module["type"] == "viscoelastic")
    for name, damper in (("one", "centred"), ("other", "backward")):
        scene["modules"][name] = link | {"damping": 1.0, "damper": damper}
    path.write_text(yaml.safe_dump(scene))
    document = hapsim("check", path, "--json").document
    assert document["predicted"] is None
    assert document["stable"] is True
    assert "has dampers of several kinds (one: centred, " in document["coupled_device_points"]["hand"]


def test_a_stiffness_beyond_reason_is_reported_without_a_warning(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path]
) -> None:
    answer = hapsim("check", scene_file("no_number"), "--json")
    assert (answer.status, answer.err) == (0, "")
    assert answer.document["stable"] is False


def test_a_file_name_is_shown_as_it_is_written(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], tmp_path: Path
) -> None:
    """Square brackets mean something to the library that prints."""
    path = scene_file("spring").rename(tmp_path / "a[red]b[link].yaml")
    told = hapsim("check", path)
    assert told.status == 0
    assert "a[red]b[link].yaml" in told.out.replace("\n", "")


def test_a_wire_that_is_too_slow_is_reported(hapsim: Callable[..., Any], scene_file: Callable[..., Path]) -> None:
    told = hapsim("check", scene_file("spring", baud=115200))
    assert "does not fit: a higher baud rate, or a lower rate" in told.out
    assert hapsim("check", scene_file("spring", baud=115200), "--json").document["wire_time"]["fits"] is False


def test_a_wire_that_costs_a_sample_is_predicted_at_the_delay_that_results(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], explained: Callable[[Path], str]
) -> None:
    """23 bytes at 115200 baud take 1.997 ms: with the host's work they miss a tick at 500 Hz, and not at 480 Hz."""
    path = scene_file("spring", baud=115200, port="/dev/ttyNONE")
    scene = yaml.safe_load(path.read_text())

    def wire(rate: float, delay: float) -> dict[str, Any]:
        path.write_text(yaml.safe_dump(scene | {"rate": rate, "device": scene["device"] | {"delay": delay}}))
        document: dict[str, Any] = hapsim("check", path, "--json").document
        return document | {"text": explained(path).replace("\n", " ")}

    late, declared, fits = wire(500.0, 1.0), wire(500.0, 2.0), wire(480.0, 1.0)
    assert (late["wire_time"]["fits"], late["wire_time"]["delay_samples"]) == (False, 2)
    assert late["wire_time"]["predicted"] == declared["predicted"] | {"delay": 2.0}
    assert late["predicted"]["b"] > 1.5 * late["wire_time"]["predicted"]["b"]  # the declared delay is reported too
    assert 488.0 < late["wire_time"]["highest_rate_hz"] < 489.0
    assert "2 samples of delay. One sample below 488 Hz or above 117949 baud" in late["text"]
    assert f"b = {declared['predicted']['b']:.6g} N·s/m" in late["text"]
    assert (fits["wire_time"]["delay_samples"], fits["wire_time"]["predicted"]) == (1, None)
    assert "fits. One sample of delay, up to 488 Hz" in fits["text"]
    assert "This is counted for a UART" in fits["text"]
    queueing = wire(1100.0, 1.0)  # 12 bytes take 1.04 ms
    assert (queueing["wire_time"]["delay_samples"], queueing["wire_time"]["predicted"]) == (None, None)
    assert "frames queue up" in queueing["text"]


def test_what_bounds_the_force_is_told_for_where_the_device_is(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], tmp_path: Path, explained: Callable[[Path], str]
) -> None:
    path = scene_file("spring")
    assert hapsim("check", path, "--json").document["force_bounds"] == {
        "slew_limit": None,
        "soft_start_s": 0.0,
        "energy_limit": pytest.approx(0.2),
    }
    told = explained(path).replace("\n", " ")
    assert "Force: at most 10 N; it changes as fast as the scene asks" in told
    assert "what the scene asks for in the very first sample comes at once." in told
    assert "A run ends where the scene gives the hand more than 0.2 J, or goes on" in told
    assert "slew_limit" not in told
    document = yaml.safe_load(path.read_text())
    document["device"] |= {"clock": "device"}
    in_hand = tmp_path / "on_the_mock.yaml"
    in_hand.write_text(yaml.safe_dump(document))
    told = explained(in_hand).replace("\n", " ")
    assert "Behind a port (`--port`) the force changes by at most 10000 N/s, and" in told
    assert "in the very first sample comes along a ramp of 50 ms." in told
    document["device"] |= {"port": "/dev/ttyACM0"}
    in_hand = tmp_path / "in_hand.yaml"
    in_hand.write_text(yaml.safe_dump(document))
    told = explained(in_hand).replace("\n", " ")
    assert "it changes by at most 10000 N/s" in told
    assert "Behind a port" not in told
    assert "in the very first sample comes along a ramp of 50 ms (what is asked for later" in told
    document["device"]["slew_limit"] = 5.0
    in_hand.write_text(yaml.safe_dump(document))
    told = explained(in_hand).replace("\n", " ")
    assert "found 5 N/s, with which the force takes 2 s from zero to the force limit of 10 N" in told


def test_a_slew_limit_that_a_run_refuses_is_warned_of_and_not_called_stable(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path]
) -> None:
    path = scene_file("spring", slew_limit=1e-12)
    refused = hapsim("run", path, "--duration", "0.01")
    assert refused.status == 2
    told = hapsim("check", path).out.replace("\n", " ")
    assert "Hz: stable without its slew limit: see the warning (spectral radius" in told
    document = hapsim("check", path, "--json").document
    count, slow = document["warnings"]
    assert refused.err.strip() in count
    assert count in told
    assert "the force takes 1e+13 s from zero" in slow
    expected = float(count.partition("at least ")[2].split(" ")[0])
    enough = hapsim("check", scene_file("spring", slew_limit=expected), "--json").document["warnings"]
    assert [one for one in enough if "a count of" in one] == []
    assert (
        hapsim("check", scene_file("spring", slew_limit=0.999 * expected), "--json").document["warnings"][0]
        != enough[0]
    )
    with pytest.raises(UsageError, match=r"less than a count of the device's force"), start(load_scene(str(path))):
        pass
    behind_a_port = hapsim("check", scene_file("spring", slew_limit=1e-12, port="/dev/ttyNONE"), "--json").document
    assert not any("a count of" in one for one in behind_a_port["warnings"])
    assert hapsim("check", scene_file("spring"), "--json").document["warnings"] == []


def test_run_tells_its_warnings_in_json_too(hapsim: Callable[..., Any], scene_file: Callable[..., Path]) -> None:
    path = scene_file("spring", slew_limit=5.0)
    answer = hapsim("run", path, "--duration", "0.01", "--json")
    assert answer.document["warnings"] == hapsim("check", path, "--json").document["warnings"]
    assert answer.document["warnings"][0] in answer.err


def test_the_hand_and_device_of_a_prediction_are_told(
    scene_file: Callable[..., Path], explained: Callable[[Path], str]
) -> None:
    def line(name: str = "spring", **device: Any) -> str:
        told: str = " ".join(explained(scene_file(name, **device)).split())
        return told.partition("for a hand of ")[2].partition(" What the hand")[0]

    assert line(mass=0.2, friction=1.0, delay=1) == ("0.2 kg, friction 1 N·s/m, delay 1 sample (1 ms), zero-order hold")
    assert line(mass=200, delay=0.001).startswith("200 kg, ")
    assert "delay 0.001 samples (0.001 ms)" in line(delay=0.001)
    assert line(delay=0, hold="impulse", sampling="average", stiffness=50.0).endswith(
        "a spring of 50 N/m, no delay, impulse hold, averaged positions"
    )
    several = line("two_hands", mass=[0.2, 0.3])
    assert "channel 0: 0.2 kg" in several
    assert "channel 1: 0.3 kg" in several


def test_what_bounds_the_force_of_a_dead_host_is_what_a_run_asks_the_device_for(
    hapsim: Callable[..., Any], scene_file: Callable[..., Path], explained: Callable[[Path], str]
) -> None:
    path = scene_file("spring")
    scene = load_scene(str(path))
    silence = hapsim("check", path, "--json").document["host_silence"]
    asked = []

    def note(session: Any) -> None:
        asked.append(int(session._loop.control.time_to_live))

    with start(scene, duration=0.01, on_arming=note):
        pass
    assert [silence["time_to_live_samples"]] == asked == [20]
    assert (silence["zero_force_after_s"], silence["latched_after_s"]) == (0.021, 0.101)
    told = explained(path).replace("\n", " ")
    assert "at most 21 ms (20 samples' time to live, and one more)" in told
    assert "after 101 ms (watchdog of 100 samples" in told
    assert "the device latches: zero force until it is armed again." in told


def test_a_device_beyond_all_numbers_is_a_sentence(hapsim: Callable[..., Any], scene_file: Callable[..., Path]) -> None:
    answer = hapsim("check", scene_file("spring", mass=1e-300, friction=0.5))
    assert answer.status == 2
    assert "0.5 N·s/m of friction and a spring of 0 N/m on 1e-300 kg" in " ".join(answer.sentence.split())
