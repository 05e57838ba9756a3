"""The force of a hand in the plane: limits, slew, soft start and tests keep its direction."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from frozen_device import FrozenDevice, after
from loop_rig import run_with_loop
from numpy.typing import NDArray
from plane_field import field_of, plane
from test_loop_slew import Host, limited_to

from firmware_protocol import schema
from hapsim.bringup.faults import Injector
from hapsim.bringup.faults.in_memory import in_memory
from hapsim.bringup.faults.injector import parse_script
from hapsim.errors import GuardError
from hapsim.loop.ring import FADED, LIMITED, SLEWED
from hapsim.recording.trace import Trace
from hapsim.running import Excitation, run

HEAVY: dict[str, Any] = {"mass": 1000.0}  # it stays where it is


def off_line(forces: NDArray[np.float64], direction: tuple[float, float]) -> float:
    """Returns how far the farthest force is from the line through 0 in this direction."""
    return float(np.abs(forces @ [-direction[1], direction[0]]).max() / math.hypot(*direction))


def test_a_force_beyond_a_limit_keeps_its_direction() -> None:
    with field_of(12.0, 5.0):
        trace, loop = run_with_loop(plane(HEAVY), duration=0.02, judges_energy=True)
    assert np.abs(trace.force_counts - [120.0 / 13.0, 50.0 / 13.0] / trace.force_scale).max() <= 1.5
    assert np.all(trace.flags & LIMITED)
    np.testing.assert_allclose(loop.record.history.decided[:2], trace.force[-1], rtol=1e-12)
    with field_of(-4.0, 9.1):
        trace = run(plane(HEAVY), duration=0.02)
    assert np.abs(trace.force_counts - [-4.0, 9.1] / trace.force_scale).max() <= 1.0
    assert not np.any(trace.flags & LIMITED)


def test_the_limit_is_a_circle_within_which_each_channel_is_too() -> None:
    with field_of(9.0, 9.0):
        trace = run(plane(HEAVY), duration=0.02)
    np.testing.assert_allclose(trace.force[-1], [10.0 / math.sqrt(2.0)] * 2, rtol=1e-8)
    assert np.all(trace.flags & LIMITED)
    assert trace.report.limited_ticks == trace.report.ticks


def test_two_hands_are_limited_each_by_itself() -> None:
    scene = plane(HEAVY)
    other = scene.modules["hand"].model_copy(update={"channels": (2, 3)})
    with field_of(30.0, 40.0):
        trace = run(
            scene.model_copy(update={"modules": {**scene.modules, "other": other}}),
            duration=0.02,
            excitation=Excitation(channel=3, force=8.0, ticks=1, every=1000, start=0, first=True),
        )
    np.testing.assert_allclose(trace.force[0], [6.0, 8.0, 0.0, 8.0], atol=1e-6)


def test_an_excitation_is_limited_with_the_force_and_what_is_cut_because_of_it_is_the_hand_s() -> None:
    pushes = Excitation(channel=1, force=12.0, ticks=1, every=1000, start=0, first=True)
    both = np.array([6.0, 20.0]) * 10.0 / math.hypot(6.0, 20.0)
    with field_of(6.0, 8.0):
        trace, loop = run_with_loop(plane(HEAVY), duration=0.001, excitation=pushes, judges_energy=True)
    np.testing.assert_allclose(trace.force[0], both, atol=1e-6)
    decided = loop.record.history.decided
    np.testing.assert_allclose(decided[:2], [6.0, 8.0], atol=1e-6)
    np.testing.assert_allclose(decided[schema.MAX_CHANNELS :][:2], both, atol=1e-6)


def test_a_step_is_shortened_as_a_vector() -> None:
    with field_of(6.0, -2.0):
        trace = run(plane({**HEAVY, "slew_limit": 400.0}), duration=0.05)
    assert off_line(trace.force / trace.force_scale, (6.0, -2.0)) <= 1.0
    steps = np.diff(trace.force, axis=0, prepend=0.0)
    assert np.abs(steps).max() <= 0.4 * (1.0 + 1e-12)
    np.testing.assert_allclose(steps[:14, 0], 0.4, rtol=1e-6)
    np.testing.assert_allclose(trace.force[15:], [[6.0, -2.0]] * 35, atol=1e-6)
    assert np.flatnonzero(trace.flags & SLEWED).tolist() == list(range(15))


def test_a_force_that_turns_leads_straight_from_the_one_before_to_the_next() -> None:
    loop = Host(in_plane=True, **limited_to(100))
    places = (-60, 80), (-360, 80), (-160, -320), (-360, -120)
    answers = (60, -80), (160, -80), (160, 20), (260, 70)
    assert tuple(loop.forces(number, *place) for number, place in enumerate(places)) == answers


@pytest.mark.parametrize("angle", [0.0, 0.6, 2.2])
def test_the_soft_start_keeps_the_direction_and_does_not_depend_on_the_frame(angle: float) -> None:
    def at(angle: float) -> Trace:
        c, s = math.cos(angle), math.sin(angle)
        initial = {"position": [0.004 * c, 0.004 * s], "velocity": [-0.3 * c - 0.2 * s, 0.2 * c - 0.3 * s]}
        with field_of(stiffness=1000.0):
            return run(plane({"soft_start": 0.05}, {"initial": initial}), duration=0.1)

    trace = at(angle)
    asked, u = trace.asked_force, np.minimum(trace.sample / 50.0, 1.0)
    left = 1.0 - u * u * (3.0 - 2.0 * u)
    share = np.clip(1.0 - left * (asked @ asked[0]) / (asked**2).sum(axis=1), 0.0, 1.0)
    np.testing.assert_allclose(trace.force, asked * share[:, None], rtol=0, atol=1e-7)
    assert not np.any(trace.force_counts[0])
    assert 10 < np.count_nonzero(trace.flags & SLEWED) <= 50
    straight = at(0.0)
    np.testing.assert_allclose(np.hypot(*trace.force.T), np.hypot(*straight.force.T), rtol=0, atol=2e-5)


def test_a_soft_start_ends_at_the_force_within_the_limit() -> None:
    with field_of(12.0, 5.0):
        trace = run(plane({**HEAVY, "soft_start": 0.05}), duration=0.06)
    u = np.minimum(trace.sample / 50.0, 1.0)
    wanted = np.outer(u * u * (3.0 - 2.0 * u), [120.0 / 13.0, 50.0 / 13.0])
    np.testing.assert_allclose(trace.force, wanted, rtol=0, atol=1e-6)


def test_a_test_of_a_sensor_lowers_the_whole_force() -> None:
    device = FrozenDevice(after(300), channels=2, frozen=(1,))
    hand = {"stiffness": 300.0, "damping": 20.0, "position": [0.003, 0.004]}
    with field_of(stiffness=1000.0):
        trace = run(
            plane({"energy_limit": 1e6}, {"hand": hand, "noise": 1e-7}),
            duration=1.2,
            between=device,
            judges_energy=True,
        )
    assert trace.report.sensor_tests >= 1
    assert trace.report.frozen.startswith("the position of hand.y ")
    lowered = trace.flags & FADED > 0
    share = trace.force[lowered] / trace.asked_force[lowered]
    np.testing.assert_allclose(share[:, 0], share[:, 1], rtol=0, atol=1e-6)
    assert share.min() == 0.0
    assert np.count_nonzero((share > 0.1) & (share < 0.9)) > 4


def circling(position: list[float], velocity: list[float], stiffness: float, **options: Any) -> Trace:
    """A hand that a spring presses onto a disc of 20 mm, and that circles it."""
    mock = {"hand": {"stiffness": stiffness}, "initial": {"position": position, "velocity": velocity}}
    with field_of(disc=2000.0, radius=0.02, damping=5000.0):
        return run(plane({"friction": 0.05}, mock), duration=1.0, judges_sign=True, **options)


def bouncing(seed: int, **options: Any) -> Trace:
    """A hand that flies against the disc somewhere, and bounces round it."""
    chance = np.random.default_rng(seed)
    angle, along, aside = chance.uniform(0.0, 2.0 * math.pi), chance.uniform(0.05, 0.5), chance.normal(0.0, 0.2)
    c, s = math.cos(angle), math.sin(angle)
    velocity = [aside * c - along * s, aside * s + along * c]
    return circling([0.02 * c, 0.02 * s], velocity, float(chance.choice([100.0, 300.0, 600.0])), **options)


@pytest.mark.parametrize("seed", range(6))
def test_the_force_of_a_disc_turns_with_the_hand_and_no_motor_is_blamed(seed: int) -> None:
    trace = bouncing(seed)
    assert trace.report.ending == "done"
    assert np.ptp(np.unwrap(np.arctan2(trace.position[:, 1], trace.position[:, 0]))) > 1.0
    assert np.any(np.abs(trace.asked_force) > 1.0)


@pytest.mark.parametrize("seed", range(6))
def test_motors_of_the_wrong_sign_are_found_on_a_disc(seed: int) -> None:
    inverted = '{"version": 1, "faults": [{"kind": "invert", "direction": "to_device", "at": 0}]}'
    with pytest.raises(GuardError, match=r"disagree in sign.* Or the motors of x and y are exchanged"):
        bouncing(seed, between=in_memory(Injector(parse_script(inverted)), 1e-3))


def test_a_hand_that_circles_a_disc_accelerates_against_its_force_and_passes_the_tests_that_release_it_whole() -> None:
    trace = circling([0.0177, 0.0], [0.0, 0.4], 300.0)
    assert trace.report.ending == "done"
    assert 1 <= trace.report.sign_tests <= 8  # two in each sector
    released = (trace.force_counts == 0) & (np.abs(trace.asked_force) > 0.1)
    assert np.count_nonzero(released[:, 0]) >= 6
    np.testing.assert_array_equal(released[:, 0] & (np.abs(trace.force[:, 1]) > 0.0), False)
    np.testing.assert_array_equal(released[:, 1] & (np.abs(trace.force[:, 0]) > 0.0), False)
