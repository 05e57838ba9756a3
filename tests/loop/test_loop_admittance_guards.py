"""The guards of admittance: limits of commands, a wrong force sensor, a handle that does not follow, the energy."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.errors import GuardError
from hapsim.loop.guards.force_sensor import DEAD, DRIFTS, INVERTED, LEANS, SATURATED
from hapsim.loop.ring import SLEWED
from hapsim.prediction.timing import time_to_live_samples
from hapsim.running import run
from tests.admittance_scenes import scene_of

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools" / "bench"))

import force_sensor as bench

SPRING = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 500.0, "damping": 0.0}
FREE: dict[str, Any] = {"stiffness": 0.0}
SLOW: dict[str, Any] = {"speed_limit": 0.1, "acceleration_limit": 20.0}
COUNT_M = 2e-9


def run_ended(scene: Any, **options: Any) -> GuardError:
    """Returns the error that ends a run of this scene."""
    with pytest.raises(GuardError) as caught:
        run(scene, duration=3.0, **options)
    assert caught.value.exit_status == 4
    return caught.value


# Limits of commands


def test_no_command_is_faster_or_turns_faster_than_its_limits() -> None:
    trace = run(scene_of(device=SLOW, hand=FREE | {"force": 30.0}), duration=0.1)
    steps = np.diff(trace.command[:, 0])
    assert np.abs(steps).max() == pytest.approx(1e-4, abs=COUNT_M)
    assert np.abs(np.diff(steps)).max() == pytest.approx(2e-5, abs=2 * COUNT_M)
    assert (trace.flags[5:] & SLEWED > 0).all()
    assert trace.report.limited_commands == np.count_nonzero(trace.flags & SLEWED)


def test_a_gentle_push_meets_no_limit() -> None:
    trace = run(scene_of(device=SLOW, hand=FREE | {"force": 0.3}), duration=0.3)
    assert trace.report.limited_commands == 0


@pytest.mark.parametrize("push", [2.0, -2.0])
def test_a_push_against_the_end_of_the_travel_stops_there_as_gently_as_the_limit_asks_for(push: float) -> None:
    device = {"acceleration_limit": 20.0, "travel": [-0.03, 0.02], "travel_margin": 0.005}
    trace = run(scene_of(device=device, hand=FREE | {"force": push}), duration=0.6)
    ends = 0.025 if push > 0.0 else -0.035
    assert trace.report.ending == "done"
    assert trace.position[-1, 0] == pytest.approx(ends, abs=1e-6)
    assert np.abs(trace.position).max() <= abs(ends) + COUNT_M
    assert np.abs(np.diff(trace.command[:, 0], n=2)).max() <= 2e-5 + 2 * COUNT_M


def test_a_device_that_is_armed_outside_its_travel_may_come_in_and_not_go_out() -> None:
    device = {"travel": [-0.01, 0.01], "travel_margin": 0.001}
    at = {"initial": {"position": 0.02}}
    out = run(scene_of(device=device, hand=FREE | {"force": 2.0}, mock=at), duration=0.1)
    assert np.ptp(out.position) == 0.0
    back = run(scene_of(device=device, hand=FREE | {"force": -2.0}, mock=at), duration=0.1)
    assert back.position[-1, 0] < 0.01


def test_a_host_that_was_held_up_goes_on_from_where_the_braking_device_is() -> None:
    """PROTOCOL.md, section 6.2: in samples without a command the device goes on, and brakes behind the time to live."""
    scene = bench.scene_of()
    loop, lives, less = bench.armed(scene, judges_sign=False), time_to_live_samples(bench.RATE), 100.0 / bench.RATE**2
    commands = [0.0]
    for n in range(60):
        commands.append(bench.answer(loop, n, commands[-1], 2.5)[1])
    place, step = commands[-1], commands[-1] - commands[-2]
    for silent in range(1, lives + 3):
        step = max(step - less, 0.0) if silent > lives else step
        place += step
    assert step > 0.3 * less
    _, command = bench.answer(loop, 59 + lives + 3, place, 0.0)
    assert command - place == pytest.approx(step, abs=3e-5)  # within the rounding of these steps


def test_a_hand_too_stiff_for_the_mass_shakes_it_until_the_run_ends() -> None:
    device = {"acceleration_limit": 20.0}
    error = run_ended(scene_of(device=device, hand={"stiffness": 7000.0}), unstable=True)
    assert "hand shook at the limit of its acceleration, 20 m/s²: from one side to the other 16 times" in str(error)
    assert "smallest that do for an assumed_hand" in str(error)
    assert np.abs(error.trace.position).max() < 5e-3


def test_a_swing_at_the_limit_that_dies_away_goes_on() -> None:
    trace = run(scene_of(device={"acceleration_limit": 2.0}, mock={"initial": {"position": 5e-3}}), duration=2.0)
    assert trace.report.limited_commands > 20
    assert abs(trace.position[-1, 0]) < 1e-4


# Energy


def test_a_hand_that_swings_ever_farther_ends_the_run_by_its_energy() -> None:
    device = {"acceleration_limit": 1e4, "speed_limit": 100.0, "energy_limit": 0.05}
    error = run_ended(scene_of(device=device, hand={"stiffness": 6000.0}), unstable=True)
    assert error.trace.report.ending == "scene diverging"
    at = np.abs(error.trace.position).max()
    assert 0.5 * 6000.0 * at**2 == pytest.approx(0.05, rel=0.25)


@pytest.mark.parametrize("servo", [None, {"bandwidth": 100.0}])
def test_a_hand_within_its_limit_is_passive_however_it_swings(servo: Any) -> None:
    device = {"simulated_damping": 8.0 if servo else 2.1, "energy_limit": 1e-4, "servo": servo}
    trace = run(scene_of(device=device, mock={"initial": {"position": 5e-3}}), duration=1.0)
    assert trace.report.ending == "done"


def test_energy_that_a_spring_of_the_scene_holds_at_arming_may_come_out() -> None:
    device = {"energy_limit": 1e-3}
    scene = scene_of({"touch": SPRING}, device=device, hand={"position": 0.01}, mock={"initial": {"position": 0.01}})
    assert run(scene, duration=0.5).report.ending == "done"


# The force sensor


def nobody(**keys: Any) -> Any:
    return bench.play(bench.scene_of(), bench.Nobody(1), **{"seconds": 1.0} | keys)


def test_the_offset_at_arming_moves_nothing() -> None:
    outcome = nobody(sensor=lambda force, _t: force + 1.5)
    assert outcome.ending == "done"
    assert outcome.way < 0.003


def test_a_hand_that_leans_on_the_handle_at_arming_ends_the_run_before_anything_moves() -> None:
    outcome = nobody(sensor=lambda force, _t: force + 4.0)
    assert (outcome.why, outcome.way) == (LEANS, 0.0)
    assert "shows 4 N at arming, more than 5% of its range of 50 N: something presses on the handle" in outcome.sentence


def test_lost_positions_do_not_let_a_hand_that_leans_move_the_handle() -> None:
    """The host is held up for 70 ms after arming, and then each third position is lost."""
    loop = bench.armed(bench.scene_of())
    for number in (n for n in range(70, 200) if n % 3):
        code, command = bench.answer(loop, number, 0.0, 4.0)
        assert command == 0.0
        if code == bench.BAD_FORCE:
            break
    assert loop.record.force_sensor.why == LEANS


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("servo_hz", [0.0, 50.0])
@pytest.mark.parametrize("seed", [3, 8, 21])
def test_an_inverted_sensor_is_found_within_millimetres(servo_hz: float, seed: int) -> None:
    scene = bench.scene_of(servo_hz=servo_hz, damping=14.0 if servo_hz else 5.0)
    outcome = bench.play(scene, bench.Hand(seed), bench.FAULTS["inverted"](), seconds=1.0)
    assert outcome.why == INVERTED
    assert outcome.way < (0.04 if servo_hz else 0.01)
    assert "has the wrong sign: it pushes along each motion" in outcome.sentence


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("kind", ["usual", "violent"])
@pytest.mark.parametrize("servo_hz", [0.0, 50.0])
def test_a_right_sensor_is_tested_twice_or_so_and_then_never(kind: str, servo_hz: float) -> None:
    scene = bench.scene_of(servo_hz=servo_hz, damping=14.0 if servo_hz else 5.0)
    outcome = bench.play(scene, bench.Hand(5, kind), seconds=1.5)
    assert outcome.ending == "done"
    assert 2 <= outcome.tests <= 6


def test_a_sensor_that_keeps_its_count_while_the_handle_moves_is_dead() -> None:
    outcome = bench.play(bench.scene_of(), bench.Hand(2), bench.FAULTS["keeps its count"](), seconds=1.5)
    assert outcome.why == DEAD
    assert outcome.way < 0.06
    assert "counts while the handle moves: sensor or cable?" in outcome.sentence


def test_a_silent_sensor_without_a_hand_is_not_called_dead() -> None:
    """It has no noise, and the scene alone moves the handle."""
    scene = scene_of({"touch": SPRING}, hand=FREE, mock={"initial": {"position": 0.02}})
    trace = run(scene, duration=1.0, judges_sign=True)
    assert np.abs(trace.position[60:]).max() > 5e-3
    assert trace.report.ending == "done"


def test_a_sensor_at_the_end_of_its_range_ends_the_run_within_a_hundredth_of_a_second() -> None:
    outcome = bench.play(bench.scene_of(), bench.Hand(2), bench.FAULTS["at the end of its range"](), seconds=1.0)
    assert outcome.why == SATURATED
    assert outcome.seconds - bench.BEGINS_S < 0.012
    assert "is at the end of its range of 50 N" in outcome.sentence


def test_a_drifting_sensor_is_found_where_nobody_holds_the_handle() -> None:
    outcome = nobody(sensor=bench.FAULTS["drifts by 0.5 N/s"](), seconds=4.0)
    assert outcome.why == DRIFTS
    assert "as steadily as without a hand" in outcome.sentence


def test_the_mock_has_such_sensors() -> None:
    pulled = {"wall": {"type": "ground", "position": 0.01}, "touch": SPRING}
    scene = scene_of(pulled, mock={"initial": {}, "force_sensor": {"fault": "inverted"}})
    error = run_ended(scene, judges_sign=True)
    assert "the force sensor of hand has the wrong sign" in str(error)
    assert error.trace.report.force_tests == 2


# Following


class Runaway(bench.Handle):
    """A handle whose motor has the wrong sign."""

    def move(self, command: float) -> None:
        self.position, self._due = self.position + 0.05 * (self.position - self._due) + 1e-6, command


class Stuck(bench.Handle):
    """A handle, or its position sensor, that stands still."""

    def move(self, command: float) -> None:
        self._due = command


@pytest.mark.parametrize("handle", [Runaway, Stuck])
def test_a_handle_that_is_not_where_its_commands_lead_ends_the_run(handle: Any) -> None:
    outcome = bench.play(bench.scene_of(), bench.Hand(2), handle=handle(), seconds=1.0)
    assert outcome.ending == "commands not followed"
    assert outcome.way < 0.03
    assert "hand does not follow its commands" in outcome.sentence


def test_a_servo_of_half_the_declared_bandwidth_passes() -> None:
    scene = bench.scene_of(servo_hz=50.0, damping=20.0)
    assert bench.play(scene, bench.Hand(2), handle=bench.Handle(25.0), seconds=1.0).ending == "done"


def test_guards_of_forces_that_have_no_meaning_are_off() -> None:
    loop = bench.armed(bench.scene_of(), judges_energy=True)
    names = {hook.function.function.__name__ for hook in loop.hooks}
    assert not names & {"judge_signs", "judge_sensor", "lower_force"}
    assert {"limit_commands", "judge_force", "take_offset", "judge_following", "judge_energy", "find_leap"} <= names
