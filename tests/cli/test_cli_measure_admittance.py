"""`hapsim measure` of a scene in admittance."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.recording.trace import load_trace

Hapsim = Callable[..., Any]
SCENE = """version: 1
rate: 1000
device:
  clock: lockstep
  mode: admittance
  simulated_mass: 0.2
  simulated_damping: 5
  assumed_hand: {stiffness: 1700}
mock: {hand: {stiffness: 2000, damping: 1}}
modules:
  hand: {type: device, channel: 0}
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "mass.yaml"
    path.write_text(SCENE)
    return path


def test_it_prints_mass_and_damping_with_the_prediction_for_the_same_hand(hapsim: Hapsim, scene: Path) -> None:
    answer = hapsim("measure", scene)
    assert answer.status == 0
    for words in ("0.196811", "2.98636", "simulated", "predicted", "2000 N/m and 1 N·s/m (mock.hand)"):
        assert words in answer.out
    document = hapsim("measure", scene, "--json").document
    predicted, measured = document["predicted"], document["measured"]
    assert predicted["m"] == pytest.approx(0.196811183, rel=1e-8)
    assert measured["m"] == pytest.approx(predicted["m"], rel=1e-6)
    assert measured["b"] == pytest.approx(predicted["b"], rel=1e-6)
    assert (measured["hand_stiffness"], measured["hand_damping"]) == (2000.0, 1.0)
    assert document["ending"] == "done"


def test_it_records_the_run(hapsim: Hapsim, scene: Path, tmp_path: Path) -> None:
    assert hapsim("measure", scene, "--record", tmp_path / "m.trace").status == 0
    assert load_trace(tmp_path / "m.trace").position.size > 2000


@pytest.mark.parametrize("option", ["--impedance", "--hands", "--mass", "--methods"])
def test_what_has_no_meaning_in_it_is_refused(hapsim: Hapsim, scene: Path, option: str) -> None:
    assert f"{option} does not go with a scene in admittance" in hapsim("measure", scene, option).refusal


def test_a_scene_that_no_hand_holds_is_refused(hapsim: Hapsim, scene: Path) -> None:
    scene.write_text(SCENE.replace("stiffness: 2000, ", ""))
    assert "mock.hand: found no stiffness, expected a hand that holds the handle" in hapsim("measure", scene).refusal


def test_each_channel_is_predicted_in_its_own_hand(hapsim: Hapsim, scene: Path) -> None:
    """In the hand of the arm, the knob would be unstable."""
    text = SCENE.replace("simulated_mass: 0.2", "simulated_mass: [2e-4, 0.2]\n  motion: [rotary, linear]")
    text = text.replace("simulated_damping: 5", "simulated_damping: [0.01, 5]")
    text = text.replace("mock: {hand: {stiffness: 2000, damping: 1}}", "mock: {hand: {stiffness: [2, 500]}}")
    scene.write_text(f"{text}  arm: {{type: device, channel: 1}}\n".replace("stiffness: 1700", "stiffness: 2"))
    document = hapsim("measure", scene, "--channel", 1, "--duration", 1, "--json").document
    assert document["predicted"]["hand_stiffness"] == 500.0
    assert document["measured"]["m"] == pytest.approx(document["predicted"]["m"], rel=1e-6)


def test_hands_that_a_link_joins_feel_no_mass_and_damping(hapsim: Hapsim, scene: Path) -> None:
    other = "  other: {type: device, channel: 1}\n"
    tie = "  tie: {type: viscoelastic, between: [hand, other], stiffness: 300, damping: 1}\n"
    scene.write_text(SCENE.replace("simulated_mass: 0.2", "simulated_mass: [0.2, 0.2]") + other + tie)
    assert f"Next: hapsim run {scene}" in hapsim("check", scene).out
    measured = hapsim("measure", scene, "--json").document["measured"]
    assert (measured["m"], measured["b"], measured["dominant"]) == (None, None, False)
    assert measured["reason"].startswith("it is joined to another hand")
