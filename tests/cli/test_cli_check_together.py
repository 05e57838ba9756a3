"""`check`, `measure`, `sweep` and the page of hands that move masses or each other say one thing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim import load_scene, predict
from hapsim.live.messages import Predict
from hapsim.live.predicted import predicted
from hapsim.sweeping.quantities import Task

FREE = """
version: 1
rate: 1000
device: {mass: 0.2, friction: 1.0, clock: lockstep}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  ball: {type: mass, mass: 1.0}
  far: {type: mass, mass: 2.0}
  touch: {type: viscoelastic, between: [hand, ball], stiffness: 2000, damping: 5}
  more: {type: viscoelastic, between: [ball, far], stiffness: 2000, damping: 5}
  hold: {type: viscoelastic, between: [far, wall], stiffness: 2000, damping: 5}
"""
Hapsim = Callable[..., Any]


def test_of_a_hand_with_a_motion_of_its_own_the_pair_is_shown_everywhere(hapsim: Hapsim) -> None:
    scene = load_scene("configs/held_string.yaml")
    (one,) = predict(scene, with_margins=False).parts
    own = one.own_motion
    assert own is not None
    out = hapsim("check", "configs/held_string.yaml").words
    assert f"hand: k {one.desired.k[0, 0]:.6g} {own.k:.6g} {one.static_stiffness[0, 0]:.6g} N/m" in out
    assert "Felt: k and b of its own oscillation. Desired: the same without sampling and delay" in out
    (document,) = hapsim("check", "configs/held_string.yaml", "--json").document["parts"]
    assert (document["k"], document["b"], document["reason"]) == ([[own.k]], [[own.b]], "")
    task = Task(scene.model_dump(mode="json"), ("predicted",))
    found, reason = task.at(scene)
    assert (found["predicted_k"], found["predicted_b"], reason) == (own.k, own.b, "")
    (shown,) = predicted(scene, {}, Predict(type="predict"))["felt"]
    assert (shown["hand"], shown["k"], shown["b"], shown["is_held"]) == ("hand", own.k, own.b, False)


def test_it_is_what_measure_finds(hapsim: Hapsim) -> None:
    answer = hapsim("measure", "configs/held_string.yaml")
    ((_, predicted_k, measured_k, *_),) = [row.split("│")[1:-1] for row in answer.out.splitlines() if "k  N/m" in row]
    assert float(measured_k) == pytest.approx(float(predicted_k), rel=1e-4)
    assert "Predicted: its own oscillation." in answer.words


def test_of_two_hands_it_is_shown_what_each_feels_of_the_other(hapsim: Hapsim) -> None:
    (one,) = predict(load_scene("configs/two_hands.yaml"), with_margins=False).parts
    out = hapsim("check", "configs/two_hands.yaml").words
    assert f"left of right: k {-one.desired.k[0, 1]:.6g} {-one.felt.k[0, 1]:.6g} 300 N/m" in out
    assert f"right: b {one.desired.b[1, 1]:.6g} {one.felt.b[1, 1]:.6g} N·s/m" in out


def test_of_a_hand_without_a_motion_of_its_own_its_modes_are_named(hapsim: Hapsim, tmp_path: Path) -> None:
    file = tmp_path / "free.yaml"
    file.write_text(FREE, encoding="utf-8")
    out = hapsim("check", str(file)).words
    words_of_modes = "it oscillates together with the parts that it moves (modes of 3.66, 8.8 and 18.1 Hz)"
    assert f"no single k and b describe what it feels, because {words_of_modes}" in out
    assert "A steady push meets 666.7 N/m; moved to and fro, the hand meets at 2 Hz" in out
    (document,) = hapsim("check", str(file), "--json").document["parts"]
    assert (document["k"], document["desired"]["k"]) == (None, None)
    assert [one["frequency_hz"] for one in document["moved"]] == [2.0, 8.0, 30.0]
    scene = load_scene(file)
    assert "predicted_k" not in Task(scene.model_dump(mode="json"), ("predicted",)).at(scene)[0]


def test_a_mass_that_swings_across_its_notches_is_named_with_its_swing(hapsim: Hapsim, tmp_path: Path) -> None:
    scene = tmp_path / "notches.yaml"
    scene.write_text(
        """
version: 1
rate: 1000
device: {mass: 0.1, friction: 1.0, delay: 1, force_limit: 10, clock: lockstep}
modules:
  hand: {type: device, channel: 0}
  floor: {type: ground}
  ball: {type: mass, mass: 0.05}
  link: {type: viscoelastic, between: [hand, ball], stiffness: 1500, damping: 0.5}
  notch: {type: detent, between: [ball, floor], pitch: 4 mm, depth: 1.5, shape: snap, sharpness: 2, damping: 0.1}
"""
    )
    answer = hapsim("check", scene)
    assert "Where it is unstable, ball swings by" in answer.words
    assert "Unstable while notch is swept across its period: the motion of ball grows" in answer.words
