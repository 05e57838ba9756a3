"""`hapsim check`, `chart plane`, `sweep` and the page in admittance; and options that do not go with it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.live.messages import Predict
from hapsim.live.predicted import predicted
from hapsim.running.live_parameters import parameters_of
from hapsim.scene import load_scene
from tests.admittance_loops import Loop

Hapsim = Callable[..., Any]


@pytest.fixture
def free(tmp_path: Path) -> Path:
    """The file of a simulated mass alone."""
    path = tmp_path / "free.yaml"
    path.write_text(Loop().yaml)
    return path


@pytest.fixture
def spans(tmp_path: Path) -> Path:
    """The same in hands of which the stiffest shakes."""
    path = tmp_path / "spans.yaml"
    path.write_text(
        Loop().yaml.replace("assumed_hand: {stiffness: 2000.0", "assumed_hand: {stiffness: {from: 9, to: 9000}")
    )
    return path


def test_check_prints_the_felt_mass_and_how_far_it_is_stable(hapsim: Hapsim, free: Path) -> None:
    lines = hapsim("check", free).out
    assert "for a simulated mass of 0.2 kg, damping 5 N·s/m, in a hand of 2000 N/m, 0 N·s/m, followed exactly" in lines
    for words in ("0.198329", "2.99748", "0.002 kg or more", "2 to 401 N·s/m", "up to 5000 N/m (2.5 times this one)"):
        assert words in lines
    explained = hapsim("check", free, "--explain").out
    assert "0.198329" in explained
    for words in ("passivity", "law: board", "static"):
        assert words not in explained


def test_check_of_spans_has_a_row_for_each_hand_and_the_verdict_of_the_worst(hapsim: Hapsim, spans: Path) -> None:
    lines = hapsim("check", spans, "--require-stable")
    assert lines.status == 2
    assert "unstable" in lines.out
    for words in ("hand (9000 N/m, 0 N·s/m): m", "hand (9 N/m, 0 N·s/m): m", "stable with a simulated damping of 9 to"):
        assert words in lines.out
    document = hapsim("check", spans, "--json").document
    assert [one["stable"] for one in document["admittance"]] == [False, True]
    assert [one["hand_stiffness"] for one in document["admittance"]] == [9000.0, 9.0]
    assert document["parts"][0]["k"] is None


def test_the_next_command_measures_where_a_hand_holds_the_mock_and_runs_elsewhere(hapsim: Hapsim, free: Path) -> None:
    assert "Next: hapsim measure" in hapsim("check", free).out
    free.write_text(free.read_text().replace("mock: {hand: {stiffness: 2000.0", "mock: {hand: {stiffness: 0.0"))
    assert "Next: hapsim run" in hapsim("check", free).out


def test_a_run_is_refused_with_the_damping_that_this_hand_needs(hapsim: Hapsim, spans: Path) -> None:
    refusal = hapsim("run", spans, "--duration", "0.1").refusal
    assert "predicted unstable" in refusal
    assert "it is stable with a simulated damping of 9 to 404" in refusal


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["couple"], "found admittance, expected impedance: virtual couplings are derived for a device"),
        (["check", "--hand-mass", "0:1"], "--hand-mass: found a scene in admittance, expected the hand in the scene"),
        (["check", "--hand-stiffness", "0:1"], "--hand-stiffness: found a scene in admittance"),
        (["chart", "plane", "--mass", "1"], "--mass does not go with a scene in admittance"),
        (["chart", "plane", "--channel", "3"], "--channel 3: no hand there; hands are on: 0"),
        (["chart", "felt"], "hand is a simulated mass"),
        (["chart", "force"], "found admittance, expected impedance: the picture shows the stiffness that is felt"),
        (["chart", "transparency"], "found admittance, expected impedance: a force that is rendered has one"),
        (["measure", "--impedance"], "--impedance does not go with a scene in admittance"),
    ],
)
def test_what_is_about_forces_is_refused_in_words(hapsim: Hapsim, free: Path, command: list[str], words: str) -> None:
    options = command[2:] if command[0] == "chart" else command[1:]
    refusal = hapsim(*command[: len(command) - len(options)], free, *options).refusal
    assert words in " ".join(refusal.split())


def test_the_plane_of_masses_and_dampings_is_drawn(hapsim: Hapsim, free: Path, tmp_path: Path) -> None:
    picture, data = tmp_path / "plane.svg", tmp_path / "plane.csv"
    answer = hapsim("chart", "plane", free, "--picture", picture, "--data", data, "--to-damping", "8")
    assert "M = 0.2 kg, B = 5 N·s/m is felt as m = 0.198329 kg, b = 2.99748 N·s/m." in answer.out
    assert "simulated mass" in picture.read_text() or picture.stat().st_size > 10_000
    with data.open(newline="") as stream:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)]
    assert max(row["B_Ns_per_m"] for row in rows) == 8.0
    nearest = min(rows, key=lambda row: abs(row["M_kg"] - 0.2) + abs(row["B_Ns_per_m"] - 5.0))
    assert nearest["b_Ns_per_m"] == pytest.approx(nearest["B_Ns_per_m"] - 2.0, abs=0.01)
    assert {row["spectral_radius"] < 1.0 for row in rows if row["B_Ns_per_m"] < 1.95 and row["M_kg"] > 0.01} == {False}


def test_a_plane_has_a_reason_where_no_mass_is_felt(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "drifts.yaml"
    path.write_text(Loop(hand_stiffness=0.0).yaml)
    refusal = hapsim("chart", "plane", path, "--picture", tmp_path / "p.svg").refusal
    assert "no mass and damping is equivalent, because nothing holds the hand: it drifts" in refusal


def test_a_sweep_has_mass_and_damping_measured_as_predicted(hapsim: Hapsim, free: Path, tmp_path: Path) -> None:
    answer = hapsim(
        "sweep", free, "device.simulated_damping=4,6", "--out", tmp_path / "o.nc", "--duration", "0.4", "--json"
    )
    found = json.loads(answer.out)["variables"]
    for name in ("m", "b"):
        assert found[f"measured_{name}"]["median"] == pytest.approx(found[f"predicted_{name}"]["median"], rel=1e-6)
    assert "needed_friction" not in found


def test_the_page_has_the_felt_mass_in_words(free: Path) -> None:
    scene = load_scene(free)
    found = predicted(scene, parameters_of(scene, has_mock=False), Predict(type="predict"))
    assert found["why"] == {"hand": "M = 0.2 kg, B = 5 N·s/m is felt as m = 0.198329 kg, b = 2.99748 N·s/m"}
    assert (found["stable"], found["hands"], found["felt"]) == (True, [], [])


def test_when_the_host_dies_the_device_brakes(hapsim: Hapsim, free: Path) -> None:
    explained = hapsim("check", free, "--explain").out
    assert "If the host dies, the device brakes to rest at most 21 ms later" in explained
    assert "clock: host" not in explained
    silence = hapsim("check", free, "--json").document["host_silence"]
    assert silence["brakes_after_s"] == 0.021
    assert "zero_force_after_s" not in silence


def test_hands_in_which_it_is_stable_are_printed_once_for_a_span(hapsim: Hapsim, spans: Path) -> None:
    assert hapsim("check", spans).out.count("stable in hands of up to") == 1


def test_a_refusal_has_no_remedy_that_does_not_help(hapsim: Hapsim, spans: Path) -> None:
    refusal = hapsim("run", spans).refusal
    assert "no simulated mass is stable in this hand at this damping" in refusal
    assert "add mass" not in refusal


def test_an_undamped_mass_whose_limits_are_at_the_edge_of_stability_is_checked(hapsim: Hapsim, free: Path) -> None:
    text = "version: 1\nrate: 1000\ndevice: {mode: admittance, simulated_mass: 0.2, assumed_hand: {stiffness: 2000}}\n"
    free.write_text(f"{text}modules: {{hand: {{type: device, channel: 0}}}}\n")
    assert "unstable (spectral radius 1.00498756)" in hapsim("check", free).out
