"""Measurements in admittance on the mock: the mass and the damping that a hand of known stiffness feels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hapsim.errors import UsageError
from hapsim.measuring.measure import measure
from hapsim.prediction import predict
from tests.admittance_scenes import scene_of

TABLE = {
    (2000.0, 0.0): ((0.197322702, 4.995778271), (0.198329472, 2.997479799), (0.201333018, 1.019057452)),
    (2000.0, 1.0): ((0.196818022, 4.994920964), (0.196811183, 2.986365565), (0.198836693, 0.988232633)),
    (300.0, 5.0): ((0.194932257, 4.998717625), (0.189825945, 4.690617622), (0.184778062, 4.373833374)),
}
"""m and b by stiffness and damping of the hand, of 0.2 kg and 5 N·s/m at 1 kHz, for delays of 0, 1 and 2 samples."""
CASES = [(hand, delay, pair) for hand, pairs in TABLE.items() for delay, pair in enumerate(pairs)]


@pytest.mark.parametrize(("hand", "delay", "pair"), CASES)
def test_the_hand_feels_the_mass_and_damping_of_the_table(
    hand: tuple[float, float], delay: int, pair: tuple[float, float]
) -> None:
    stiffness, damping = hand
    scene = scene_of(device={"delay": float(delay)}, hand={"stiffness": stiffness, "damping": damping})
    found = measure(scene, unstable=True)
    assert found.m == pytest.approx(pair[0], rel=1e-6)
    assert found.b == pytest.approx(pair[1], rel=1e-6)
    assert found.m_uncertainty < 1e-6
    assert (found.hand.stiffness, found.hand.damping) == hand


def test_without_delay_and_damping_it_is_table_2_of_the_paper_turned_round() -> None:
    scene = scene_of(device={"delay": 0.0, "simulated_damping": 0.0}, hand={"stiffness": 700.0})
    expected = 700.0 * 1e-6 / (4.0 * math.asin(0.5e-3 * math.sqrt(700.0 / 0.2)) ** 2)
    found = measure(scene, unstable=True)
    assert found.m == pytest.approx(expected, rel=1e-7)
    assert found.b == pytest.approx(0.0, abs=1e-5)


def test_a_spring_of_the_scene_adds_to_the_hand() -> None:
    """At delay 0 it pulls the mass as the hand does."""
    touch = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 700.0, "damping": 0.0}
    at_hand = measure(scene_of(device={"delay": 0.0}, hand={"stiffness": 2000.0}), unstable=True)
    both = measure(scene_of({"touch": touch}, device={"delay": 0.0}, hand={"stiffness": 1300.0}), unstable=True)
    assert (both.hand.stiffness, both.scene_stiffness) == (1300.0, 700.0)
    assert (both.m, both.b) == (pytest.approx(at_hand.m, rel=1e-6), pytest.approx(at_hand.b, rel=1e-6))


def test_a_wall_is_no_part_of_it_while_it_is_far_and_an_error_while_it_is_near() -> None:
    def measured(place: float, push: float | None = None) -> Any:
        wall = {"stop": {"type": "ground", "position": place}} | {
            "contact": {"type": "buffer", "between": ["hand", "stop"], "stiffness": 3000.0, "damping": 1.0}
        }
        return measure(scene_of(wall, mock={"initial": {"position": 0.0}}), unstable=True, push=push)

    assert measured(-0.1).m == pytest.approx(TABLE[2000.0, 0.0][1][0], rel=1e-6)
    with pytest.raises(UsageError, match="contact changed while the hand was pushed"):
        measured(-5e-4, push=2.5)
    gentler = measured(-5e-4)  # with the default push
    assert gentler.push_n < 2.5
    assert gentler.m == pytest.approx(TABLE[2000.0, 0.0][1][0], rel=1e-6)


def test_a_wall_on_which_the_hand_rests_adds_to_the_hand() -> None:
    wall = {"post": {"type": "ground"}, "buffer": {"type": "buffer", "between": ["hand", "post"], "stiffness": 1500.0}}
    scene = scene_of(
        wall,
        device={"simulated_damping": 15.0, "assumed_hand": {"stiffness": 500.0}},
        hand={"stiffness": 500.0, "position": -5e-3},
        mock={"initial": {"position": 0.0}},
    )
    found, (felt,) = measure(scene), predict(scene).felt_masses
    assert found.scene_stiffness == 1500.0
    assert (found.m, found.b) == (pytest.approx(felt.m, rel=1e-6), pytest.approx(felt.b, rel=1e-6))


@pytest.mark.parametrize(("mock", "delay"), [({"baud": 220_000}, 2), ({"misses": 0.02, "seed": 3}, 1)])
def test_a_slow_wire_is_a_delay_and_lost_commands_spoil_nothing(mock: dict[str, float], delay: int) -> None:
    found = measure(scene_of(mock=mock), unstable=True)
    assert (found.m, found.b) == tuple(pytest.approx(one, rel=1e-6) for one in TABLE[2000.0, 0.0][delay])


def test_the_record_is_that_of_the_run() -> None:
    found = measure(scene_of(), unstable=True, push=1.0)
    assert found.push_n <= 1.0
    assert np.ptp(found.trace.force[:, 0]) == pytest.approx(2.0 * found.push_n, rel=0.2)
    assert found.trace.command.shape == found.trace.position.shape


def test_it_is_measured_where_a_hand_holds_it() -> None:
    with pytest.raises(UsageError, match=r"mock\.hand: found no stiffness, expected a hand that holds the handle"):
        measure(scene_of(hand={"stiffness": 0.0}), unstable=True)
    with pytest.raises(UsageError, match=r"at: found 0\.001, expected none"):
        measure(scene_of(), at=1e-3)


def test_a_light_mass_is_pushed_within_the_limits_of_its_commands() -> None:
    """10 g: the push of an ordinary mass would ask for 250 m/s²; commands have 100 m/s²."""
    light = {"simulated_mass": 0.01, "simulated_damping": 1.0}
    scene = scene_of(device=light, hand={"stiffness": 100.0}, mock={"initial": {"position": 0.0}})
    (felt,) = predict(scene.changed({"device.assumed_hand.stiffness": 100.0})).felt_masses
    found = measure(scene, unstable=True)
    assert found.push_n <= 0.25
    assert (found.m, found.b) == (pytest.approx(felt.m, rel=1e-5), pytest.approx(felt.b, rel=1e-5))
    with pytest.raises(UsageError, match=r"was kept within device\.speed_limit, acceleration_limit or slew_limit"):
        measure(scene.changed({"mock.initial.position": 0.02}), unstable=True)
