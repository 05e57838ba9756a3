"""Contacts, tables and friction are measured in the region about a position, and nowhere else."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import j1

import hapsim as package
from hapsim.errors import DeviceError, GuardError, UsageError
from hapsim.scene import Scene, load_scene, parse_scene
from tests import one_hand

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
NOTCH = [[-0.002, 0.0], [-0.001, -1.0], [0.001, 1.0], [0.002, 0.0]]
TOGGLE = [[-0.01, -4], [-0.005, 0], [-0.002, 1.5], [0.002, -1.5], [0.005, 0], [0.01, 5]]


def shipped(name: str, **device: Any) -> Scene:
    scene = load_scene(CONFIGS / f"{name}.yaml")
    return scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep", **device})})


def table(points: list[list[float]], *, device: str = "", damping: float = 4.0, **mock: Any) -> Scene:
    """A hand on a table and a damper."""
    return parse_scene(
        f"""
version: 1
rate: 1000
device: {{clock: lockstep, mass: 0.2, friction: 1, delay: 1{device}}}
mock: {json.dumps(mock)}
modules:
  knob: {{type: device, channel: 0}}
  frame: {{type: ground}}
  rub: {{type: damper, between: [knob, frame], damping: {damping}}}
  table: {{type: nonlinear, between: [knob, frame], force_over_distance: {points}}}
"""
    )


def rubbed(scene: Scene, **friction: float) -> Scene:
    """The scene with friction between knob and frame."""
    document = scene.model_dump(mode="json", exclude_none=True)
    document["modules"]["rubs"] = {"type": "friction", "between": ["knob", "frame"]} | friction
    return parse_scene(json.dumps(document))


def swinging_stop() -> Scene:
    """A stop that is unstable on the mock's belt, which the scene does not declare."""
    mock = {"motor_lag": 5e-4, "coulomb": 0.05, "quantum": 1e-5}
    mock |= {"transmission": {"stiffness": 8000.0, "damping": 0.5, "motor_mass": 0.05}}
    device = {"mass": 0.15, "friction": 0.8, "force_limit": 4.0}
    return one_hand.scene_of({"stop": one_hand.touch(3000.0, 4.0, "buffer")}, device=device, mock=mock)


def agrees(scene: Scene, measured: Any, channel: int = 0, within: float = 1e-5) -> None:
    """k and b are those that are predicted for the place."""
    felt = next(
        one for one in package.predict(scene, with_margins=False, at=measured.at_m).felt if one.channel == channel
    )
    assert abs(measured.k / felt.k - 1.0) < within
    assert abs(measured.b - felt.b) < within * 2.0 * math.sqrt(felt.k * measured.mass)


@pytest.mark.thorough(keep=5)
@pytest.mark.parametrize(
    ("scene", "at"),
    [
        (shipped("wall"), None),
        (shipped("wall"), -0.002),
        (shipped("four_keys"), -0.001),
        (shipped("four_keys"), -0.005),
        (shipped("four_keys"), -0.0105),
        (table(NOTCH), None),
        (table(TOGGLE), -0.004),
        (table(TOGGLE), 0.007),
        (table(NOTCH, hand={"force": 1.5}), 0.0003),
        (shipped("first_touch"), 0.002),
    ],
    ids=["wall", "deep", "key", "lower", "bottom", "notch", "toggle", "over", "gravity", "linear"],
)
def test_a_region_feels_as_predicted(scene: Scene, at: float | None) -> None:
    measured = package.measure(scene, at=at)
    agrees(scene, measured)
    assert abs(measured.trace.position[0, 0] - measured.at_m) < 2e-6
    assert not measured.left_region
    assert measured.k_uncertainty < 1e-5 * measured.k


def test_the_shipped_wall_gives_what_its_file_states() -> None:
    measured = package.measure(shipped("wall"))
    assert measured.k == pytest.approx(1549, abs=0.5)
    assert measured.b == pytest.approx(2.78, abs=0.005)
    assert measured.at_m < 0.0


def test_friction_of_the_scene_is_measured_where_it_sticks() -> None:
    scene = rubbed(table(NOTCH), force=0.2, stiffness=800, damping=1)
    measured = package.measure(scene, at=0.0002)
    agrees(scene, measured)
    assert measured.k > 1500.0


def test_a_push_that_leaves_the_region_is_halved_until_it_stays() -> None:
    """Counts of 1 µm ask for much of the notch, and a device of half the mass swings in time with the pushes."""
    scene = table(
        [[-0.0004, 0.0], [-0.0002, -0.2], [0.0002, 0.2], [0.0004, 0.0]], quantum=1e-6, damping=0.6, mass=0.104
    )
    measured = package.measure(scene)
    left = [one for one in measured.attempts if one.left]
    assert left
    assert "table went from" in left[0].left
    for before, after in zip(left, measured.attempts[1:], strict=False):
        assert after.push_n == pytest.approx(0.5 * before.push_n)
    assert not measured.left_region
    assert abs(measured.trace.position).max() < 0.0002


def test_a_push_that_is_named_is_not_changed_and_what_it_leaves_is_reported() -> None:
    measured = package.measure(table(NOTCH), push=3.0)
    assert (measured.push_n, len(measured.attempts)) == (3.0, 1)
    assert measured.left_region == "table went from piece 2 to level"


DETENT = """
version: 1
rate: 2000
device: {clock: lockstep, mass: 5.0e-5, friction: 0.0005, delay: 1, force_limit: 0.2, motion: rotary}
mock: {initial: {position: 0.02}, quantum: 1.0e-9}
modules:
  knob: {type: device, channel: 0}
  frame: {type: ground}
  clicks: {type: detent, between: [knob, frame], pitch: 15 deg, depth: 0.03, shape: sine}
  brake: {type: damper, between: [knob, frame], damping: 0.002}
"""


def test_a_smooth_notch_is_measured_at_rest_and_a_large_swing_is_not_blamed_on_the_device() -> None:
    scene = parse_scene(DETENT)
    for at in (None, math.radians(15.0), 0.03):
        agrees(scene, package.measure(scene, at=at), within=2e-5 if at else 1e-5)
    assert "its slope changes" in package.measure(scene, push=0.003).left_region


def test_the_command_leads_pushes_and_reports_the_result(hapsim: Any, tmp_path: Path) -> None:
    path, picture = tmp_path / "knob.yaml", tmp_path / "ring.csv"
    path.write_text(DETENT, encoding="utf-8")
    ran = hapsim("measure", path, "--at", "15 deg", "--data", picture)
    assert "at 15°" in ran.out
    rows = np.genfromtxt(picture, delimiter=",", names=True)
    rest, envelope = rows["rest_position_m"], rows["predicted_envelope_m"]
    assert rest == pytest.approx(math.radians(15.0), abs=1e-6)
    assert (np.abs(rows["position_m"] - rest) < 1.05 * envelope + 2e-9).all()
    found = hapsim("measure", path, "--at", "15 deg", "--push", "0.02", "--json").document
    assert found["push_n"] == 0.02
    assert found["at_m"] == pytest.approx(math.radians(15.0))
    assert [one["push_n"] for one in found["attempts"]] == [0.02]
    assert found["left_region"]
    told = hapsim("measure", path, "--push", "0.02").out
    assert "do not describe the device" in " ".join(told.split())
    assert "not as the scene declares it" not in told
    wrong = hapsim("measure", path, "--at", "a notch")
    assert (wrong.status, "--at: found 'a notch', expected a position" in wrong.err) == (2, True)


def test_noise_asks_for_larger_pushes() -> None:
    scene = shipped("wall")
    scene = scene.model_copy(update={"mock": scene.mock.model_copy(update={"quantum": 1e-6, "noise": 1e-6})})
    measured = package.measure(scene, at=-0.005)
    agrees(scene, measured, within=5.0 * measured.k_uncertainty / measured.k)
    assert measured.k_uncertainty < 1e-3 * measured.k
    quiet = package.measure(shipped("wall"), at=-0.005)
    assert measured.push_n > 10.0 * quiet.push_n


def test_dry_friction_of_the_device_leaves_the_place_and_reports_its_uncertainty() -> None:
    measured = package.measure(shipped("wall").model_copy(update={"mock": table(NOTCH, coulomb=0.02).mock}), at=-0.003)
    assert abs(measured.trace.position[0, 0] + 0.003) < 1e-5
    assert abs(measured.k - 1549.0) < max(4.0 * measured.k_uncertainty, 0.05 * 1549.0)


@pytest.mark.parametrize(
    ("scene", "at", "says"),
    [
        (table(NOTCH), 0.0015, "has a snap: it pushes the hand away with -1000 N/m"),
        (table(NOTCH), 0.005, "nothing holds the hand"),
        (table(NOTCH), 0.001, "the hand is on the edge"),
        (shipped("wall"), -0.01, "asks for 15 N, more than the force limit of 10 N"),
        (table(NOTCH, device=", travel: [-0.01, 0.01], travel_margin: 0.1"), 0.02, "at: found 0.02 m"),
        (table(NOTCH, quantum=1e-4), None, "no push within this region .* Choose the middle of a wider region"),
        (swinging_stop(), -0.001, "reached the force limit, so the loop may swing .* farther from the edge with --at"),
        (shipped("held_string", travel=(-0.01, 0.01), travel_margin=0.1), 0.02, "at: found 0.02 m"),
    ],
    ids=["snap", "free", "edge", "limit", "travel", "counts", "swings", "string"],
)
def test_where_no_hand_can_be_measured_it_reports_why(scene: Scene, at: float | None, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        package.measure(scene, at=at)


def test_a_region_that_noise_fills_is_refused_after_all_pushes() -> None:
    scene = table([[-4e-5, 0.0], [-2e-5, -0.02], [2e-5, 0.02], [4e-5, 0.0]], quantum=1e-9, noise=2e-5)
    with pytest.raises(UsageError, match="no push within this region"):
        package.measure(scene)


def test_a_hand_that_does_not_arrive_is_not_measured() -> None:
    scene = table(NOTCH, hand={"stiffness": 1e6, "damping": 100.0})
    with pytest.raises(UsageError, match=r"but ended at .* m\. Dry friction"):
        package.measure(scene, at=0.0005)


@pytest.mark.parametrize("share", [0.01, 0.045, 0.1])
def test_a_sine_detent_is_softer_the_wider_it_swings(share: float) -> None:
    """The period of a free swing gives the first harmonic's stiffness, 2 J1(a)/a."""
    notch = {"notch": {"type": "detent", "between": ["hand", "wall"], "pitch": 0.01, "depth": 1.0}}
    device = {"mass": 0.05, "friction": 0.0, "delay": 0.0, "hold": "impulse", "force_limit": 100.0}
    mock = {"initial": {"position": 0.01 * share}}
    scene = one_hand.scene_of(notch, rate=8000.0, device=device, mock=mock)
    x = package.run(scene, duration=0.5).position[:, 0]
    falls = np.flatnonzero((x[:-1] > 0.0) & (x[1:] <= 0.0))
    passes = falls + x[falls] / (x[falls] - x[falls + 1])
    angular = 2.0 * np.pi * 8000.0 * (passes.size - 1) / (passes[-1] - passes[0])
    a = 2.0 * np.pi * share
    assert 0.05 * angular**2 / (2.0 * np.pi / 0.01) == pytest.approx(2.0 * j1(a) / a, rel=3e-4)


@pytest.mark.parametrize(
    ("scene", "quantum"),
    [(table(NOTCH), 2e-5), (shipped("button"), 1e-5), (shipped("knob_24"), 2.0 * math.pi / 2**14)],
    ids=["notch", "button", "knob"],
)
def test_coarse_counts_are_noise_within_the_stated_uncertainty(scene: Scene, quantum: float) -> None:
    mock = (scene.mock or table(NOTCH).mock).model_copy(update={"quantum": quantum})
    scene = scene.model_copy(update={"mock": mock})
    measured = package.measure(scene)
    felt = package.predict(scene, with_margins=False, at=measured.at_m).felt[0]
    assert abs(measured.k - felt.k) < 4.0 * measured.k_uncertainty < 0.08 * felt.k
    assert abs(measured.b - felt.b) < 4.0 * measured.b_uncertainty < 0.15 * felt.b


def test_a_correction_that_predicts_is_measured_in_its_region() -> None:
    """A predictor's force also follows from the pushes; that does not show that a link opened."""
    scene = shipped("wall", correction="predictor")
    agrees(scene, package.measure(scene))
    assert "stop went from" in package.measure(scene, push=4.0).left_region


def test_friction_that_slides_on_a_curve_leaves_its_region() -> None:
    measured = package.measure(rubbed(parse_scene(DETENT), force=0.001, stiffness=2.0, damping=0.0), push=0.003)
    assert measured.left_region == "rubs slid"


def test_a_place_many_detents_away_is_refused_in_words() -> None:
    with pytest.raises(UsageError, match="detent: found more than 4000 edges"):
        package.predict(shipped("knob_24"), at=1000.0)


def test_what_ends_a_guided_way_is_not_blamed_on_the_scene_or_a_hand() -> None:
    """A mass of a tenth of the declared one: the guide is too stiff for it."""
    light = {"mass": 0.005}
    for guards, error, says in (
        ({}, DeviceError, "left the range of its counts"),
        (
            {"energy_limit": 0.16, "slew_limit": 8000.0},
            GuardError,
            "while the hand was led to -0.001 m, by a force bes",
        ),
    ):
        scene = shipped("button", **guards)
        scene = scene.model_copy(update={"mock": scene.mock.model_copy(update=light)})
        with pytest.raises(error, match=says):
            package.measure(scene, at=-0.001)


def test_late_forces_are_not_blamed_on_the_region() -> None:
    scene = shipped("wall")
    scene = scene.model_copy(update={"mock": scene.mock.model_copy(update={"misses": 0.3})})
    with pytest.raises(UsageError, match="had their force too late"):
        package.measure(scene)
