"""`hapsim curve`: from a recording to a curve, a scene that runs, and a picture, in one command."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapsim as product
from hapsim.scene import load_scene
from hapsim.scene.curve_file import read_curve

sys.path.insert(0, str(Path(__file__).parents[1] / "curves"))

from recordings import press_at, release_at, stroke, text_of

GF = 9.80665e-3


@pytest.fixture
def curve(hapsim: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Any]:
    """Writes a recording with a head, and calls `hapsim curve` of it in its directory."""
    monkeypatch.chdir(tmp_path)

    def call(*words: object, head: str = "mm,gf", rows: tuple[Any, Any] | None = None) -> Any:
        Path("recording.csv").write_text(text_of(*(rows or stroke(noise=0.2)), head), encoding="utf-8")
        answer = hapsim("curve", "recording.csv", *words)
        assert "defect" not in answer.err
        return answer

    return call


def test_a_recorded_button_becomes_a_curve_and_a_scene_that_runs(curve: Callable[..., Any]) -> None:
    answer = curve("--new", "button.yaml", "--picture", "b.png", "--data", "b.csv", "--json")
    assert answer.status == 0, answer.err
    made = json.loads(answer.out)
    assert Path("button.csv").read_text("utf-8").startswith("mm,gf,gf\n")
    points, _ = read_curve("button.csv")
    np.testing.assert_allclose(points["press"], np.column_stack((made["distances_m"], made["forces_n"][0])), rtol=1e-8)
    assert made["stable"]
    assert made["strokes"] == 2
    assert len(made["distances_m"]) <= 9  # the branches have 6
    # The bound holds, of the written file, for each row that the device can render.
    mm, force = stroke(noise=0.2)
    half = 20 + 2 * 601 + 25
    off = []
    for part, name in ((slice(0, half + 25), "press"), (slice(half + 25, None), "release")):
        made_there = np.interp(mm[part], *(np.array(points[name]).T * [[1e3], [1.0 / GF]]))
        steep = [(1e3 * one["low"] <= mm[part]) & (mm[part] <= 1e3 * one["high"]) for one in made["steep"]]
        off.append(
            np.abs(made_there - force[part])[~np.any(steep, axis=0)] if steep else np.abs(made_there - force[part])
        )
    assert np.concatenate(off).max() * GF == pytest.approx(made["deviation_rendered"]["largest"], rel=1e-6)
    assert made["deviation_rendered"]["largest"] < made["within_n"] + 5.0 * 0.2 * GF
    scene = load_scene("button.yaml")
    assert scene.rate == 1000.0
    assert scene.modules["button"].force_over_distance.turn == pytest.approx(made["turn_m"], rel=1e-3)  # type: ignore[attr-defined]
    prediction = product.predict(scene)
    assert prediction.stable
    assert points["press"][0][1] == points["release"][0][1] == 0.0  # or a hand beyond it would drift away
    lockstep = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})})
    trace = product.run(lockstep, duration=0.2)
    assert trace.position.max() > 1e-3  # the mock's hand presses it
    assert Path("b.png").stat().st_size > 10_000
    columns = ["distance_m", *(f"{way}_{what}" for way in ("press", "release") for what in ("N", "felt_k_N_per_m"))]
    assert Path("b.csv").read_text("utf-8").splitlines()[0].split(",") == columns


def test_what_is_too_steep_for_the_device_is_named_with_what_would_help(curve: Callable[..., Any]) -> None:
    mm = np.linspace(0.0, 3.0, 601)
    force = press_at(mm) + 300.0 * np.maximum(mm - 2.8, 0.0)  # a stop of 3 kN/m more, gf over mm
    force += 1500.0 * np.maximum(mm - 2.8, 0.0)
    answer = curve("-o", "c.csv", "--json", rows=(mm, force))
    made = json.loads(answer.out)
    assert [one["buzzes"] for one in made["steep"]] == [True]
    (steep,) = made["steep"]
    assert steep["low"] == pytest.approx(2.8e-3, abs=3e-5)
    assert steep["slope"] == pytest.approx(np.gradient(force, mm)[-2] * GF * 1e3, rel=0.05)
    (branch,) = made["forces_n"]
    assert np.max(np.diff(branch) / np.diff(made["distances_m"])) <= made["steepest_n_m"] * (1.0 + 1e-9)
    assert branch[-1] == pytest.approx(force[-1] * GF, rel=0.01)  # the stop goes on until it pushes as hard
    assert made["stable"]
    text = curve("-o", "c.csv", rows=(mm, force)).out
    assert "which would buzz" in text
    # With what is said to help, all of it is rendered; with less it is not.
    base = Path("base.yaml")
    for factor, parts in ((1.02, 0), (0.9, 1)):
        rate = factor * made["needed_rate_hz"]
        base.write_text(product.scene.shipped.shipped_scene("first_touch").replace("rate: 1000 ", f"rate: {rate} "))  # type: ignore[attr-defined]
        again = json.loads(curve("--scene", "base.yaml", "--json", rows=(mm, force)).out)
        assert len(again["steep"]) == parts


def test_a_recorded_knob_answers_in_degrees_and_its_torque(
    curve: Callable[..., Any], hapsim: Callable[..., Any]
) -> None:
    degrees = np.concatenate((way := np.linspace(-45.0, 45.0, 361), way[::-1]))
    torque = 20.0 * np.sin(np.radians(24.0 * degrees)) + np.repeat([2.0, -2.0], 361)
    answer = curve("--new", "knob.yaml", head="deg,mN·m", rows=(np.round(degrees, 3), np.round(torque, 2)))
    assert answer.status == 0, answer.err
    assert "-45 to 45°" in answer.out
    assert "mN·m rms" in answer.out
    check = hapsim("check", "knob.yaml")
    assert check.status == 0
    assert "position  °" in check.out
    assert load_scene("knob.yaml").units(1.0, "N", 4) == "1000 mN·m"


@pytest.mark.thorough
def test_options_choose_bound_branches_and_turn(curve: Callable[..., Any]) -> None:
    fine, coarse = (json.loads(curve("--json", "--within", x).out) for x in ("0.3gf", "10gf"))
    assert len(fine["distances_m"]) > len(coarse["distances_m"])
    assert (fine["within_n"], coarse["within_n"]) == (pytest.approx(0.3 * GF), pytest.approx(10.0 * GF))
    assert json.loads(curve("--json", "--turn", "0.3mm").out)["turn_m"] == pytest.approx(3e-4)
    mean = json.loads(curve("--json", "--one-branch").out)
    x = np.array(mean["distances_m"]) * 1e3
    inner = (x > 0.3) & (x < 2.9)
    assert np.abs(np.array(mean["forces_n"][0]) / GF - 0.5 * (press_at(x) + release_at(x)))[inner].max() < 2.0
    assert mean["turn_m"] is None


@pytest.mark.parametrize(
    ("words", "head", "sentence"),
    [
        ([], "distance,force", "recording.csv:1: found 'distance,force', expected a head with the units"),
        (["--units", "gf"], "mm,gf", "recording.csv:1: found the columns gf, expected one of distances"),
        (["-o", "recording.csv"], "mm,gf", "this is the recording itself, and is not replaced"),
        (["--new", "here.yaml"], "mm,gf", "here.yaml: the file exists and is not replaced; name another"),
        (["-o", "c.txt"], "mm,gf", "c.txt: found the ending '.txt', expected .csv"),
        (["--scene", "knob_24"], "mm,gf", "found a rotary device, expected the recording's motion, linear"),
        (["--scene", "two_hands"], "mm,gf", "found several channels, expected a scene of one"),
        (["--within", "-1"], "mm,gf", "--within: found -1, expected a finite number of N above 0"),
        (["--turn", "1deg"], "mm,gf", "--turn: found 1deg"),
        (["a.csv", "b.csv"], "mm,gf", "found 3 recordings, expected one, or those of pressing and releasing"),
    ],
)
def test_what_cannot_be_done_is_refused_and_nothing_written(
    curve: Callable[..., Any], tmp_path: Path, words: list[str], head: str, sentence: str
) -> None:
    (tmp_path / "here.yaml").write_text("version: 1\n")
    answer = curve(*words, head=head)
    assert answer.status == 2
    assert sentence in answer.sentence
    assert sorted(one.name for one in tmp_path.iterdir()) == ["here.yaml", "recording.csv"]


def test_a_device_that_renders_no_spring_is_refused(curve: Callable[..., Any]) -> None:
    text = product.scene.shipped.shipped_scene("first_touch")  # type: ignore[attr-defined]
    Path("base.yaml").write_text(text.replace("friction: 1.0", "friction: 0.0").replace("damping: 5", "damping: 0"))
    answer = curve("--scene", "base.yaml")
    assert answer.status == 2
    assert "the device can render no spring: it needs friction, or its scene a damping" in answer.sentence


@pytest.mark.thorough
def test_a_board_gets_one_branch_which_it_can_follow(curve: Callable[..., Any], hapsim: Callable[..., Any]) -> None:
    text = product.scene.shipped.shipped_scene("first_touch")  # type: ignore[attr-defined]
    Path("base.yaml").write_text(text.replace("  delay: 1 ", "  law: board\n  delay: 1 "))
    made = json.loads(curve("--scene", "base.yaml", "--new", "b.yaml", "--json").out)
    assert (len(made["forces_n"]), made["turn_m"]) == (1, None)
    assert any("The board of the device follows one branch" in one for one in made["notes"])
    assert hapsim("run", "b.yaml", "--duration", "0.1").status == 0
