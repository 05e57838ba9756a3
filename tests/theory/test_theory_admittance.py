"""Simulated masses whose position a device follows: theory and prediction beside a loop written out in SI units."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from hapsim.errors import UsageError
from hapsim.prediction import predict, predict_impedance
from hapsim.prediction.felt_mass import FeltMass, admittance_sentences, mass_plane
from hapsim.prediction.first_help import ways_to_stability
from hapsim.prediction.force_bounds import fade_stiffness
from hapsim.prediction.prediction import Prediction
from hapsim.prediction.verdict_words import predicted_for, verdict_words
from hapsim.prediction.virtual_coupling import virtual_couplings
from hapsim.prediction.warnings import warnings_about
from hapsim.scene import Scene, parse_scene
from hapsim.theory.network import poles_of
from hapsim.theory.plant import Drive
from hapsim.theory.sample import loop
from tests import thorough
from tests.admittance_loops import Loop, T, largest_errors

LOOPS = thorough.points(15, 100)


def scene_of(one: Loop, **device: Any) -> Scene:
    return parse_scene(one.yaml).changed({f"device.{key}": value for key, value in device.items()})


def prediction_of(one: Loop, **device: Any) -> Prediction:
    return predict(scene_of(one, **device), with_margins=False)


def felt(one: Loop) -> FeltMass:
    (found,) = prediction_of(one).felt_masses
    return found


@pytest.mark.parametrize(
    ("stiffness", "damping", "pairs"),
    [
        (2000.0, 0.0, [(0.197322702, 4.995778271), (0.198329472, 2.997479799), (0.201333018, 1.019057452)]),
        (2000.0, 1.0, [(0.196818022, 4.994920964), (0.196811183, 2.986365565), (0.198836693, 0.988232633)]),
        (300.0, 5.0, [(0.194932257, 4.998717625), (0.189825945, 4.690617622), (0.184778062, 4.373833374)]),
    ],
)
def test_the_felt_mass_and_damping_are_those_worked_out_elsewhere(
    stiffness: float, damping: float, pairs: list[tuple[float, float]]
) -> None:
    for delay, (m, b) in enumerate(pairs):
        found = felt(Loop(hand_stiffness=stiffness, hand_damping=damping, delay=float(delay)))
        assert (round(found.m, 9), round(found.b, 9)) == (m, b)
        # To first order in T.
        if damping == 0.0:
            assert found.b == pytest.approx(5.0 - delay * stiffness * T, abs=0.02)
            first = 0.2 - 5.0 * T / 2.0 + stiffness * T**2 * (6 * delay**2 - 1) / 12.0
            assert found.m == pytest.approx(first, rel=1e-3)


@pytest.mark.parametrize("stiffness", [10.0, 2000.0, 300_000.0])
def test_without_delay_and_damping_the_papers_second_table_is_turned_round(stiffness: float) -> None:
    found = felt(Loop(damping=0.0, delay=0.0, hand_stiffness=stiffness))
    m = stiffness * T**2 / (4.0 * math.asin(0.5 * T * math.sqrt(stiffness / 0.2)) ** 2)
    assert found.m == pytest.approx(m, rel=1e-10)
    assert found.b == pytest.approx(0.0, abs=1e-6)


def test_the_least_damping_and_the_stiffest_hand_are_those_worked_out_elsewhere() -> None:
    for delay, least in ((1.0, 2.0), (2.0, 3.980198020), (3.0, 5.922511329)):
        assert felt(Loop(delay=delay)).stable_damping[0] == pytest.approx(least, abs=1e-9)
    assert felt(Loop(delay=0.0)).stable_damping[0] == 0.0
    for delay, most in ((0.0, 790_000.0), (1.0, 5000.0), (2.0, 2515.624)):
        assert felt(Loop(delay=delay)).stable_hand_stiffness == pytest.approx(most, rel=1e-6)


@pytest.mark.parametrize(
    ("delay", "least"),
    [
        (0.0, {200.0: 2.1715}),
        (1.0, {200.0: 4.136, 100.0: 7.009, 50.0: 11.705, 20.0: 19.894, 10.0: 27.677}),
        (2.0, {200.0: 6.0632}),
    ],
)
def test_a_servo_needs_the_damping_worked_out_elsewhere(delay: float, least: dict[float, float]) -> None:
    for hertz, damping in least.items():
        digits = 4 if delay != 1.0 else 3
        found = felt(Loop(damping=1.1 * damping, delay=delay, servo_hz=hertz)).stable_damping[0]
        assert found == pytest.approx(damping, abs=0.51 * 10.0**-digits)


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.0])
def test_a_hand_beyond_the_force_sensor_may_weigh_about_the_simulated_mass(delay: float) -> None:
    heaviest = felt(Loop(delay=delay)).largest_hand_mass
    assert heaviest == pytest.approx(0.2 - 5.0 * T / 2.0, rel=3e-3)
    for share, is_stable in ((0.99, True), (1.01, False)):
        assert prediction_of(Loop(delay=delay, hand_mass=share * heaviest)).stable is is_stable


def test_random_loops_are_those_written_out() -> None:
    def predicted(one: Loop) -> tuple[float, float, float]:
        prediction = prediction_of(one)
        (found,) = prediction.felt_masses
        return prediction.spectral_radius_here, found.m, found.b

    (radius, m, b), pairs, unstable = largest_errors(range(LOOPS), predicted)
    assert radius < 1e-12
    assert max(m, b) < 1e-9
    assert pairs > 0.6 * LOOPS > 2 * unstable


def test_sparse_rows_are_the_same_loop() -> None:
    network = prediction_of(Loop("chain", servo_hz=80.0, links=((0.1, 500.0, 1.0), (0.1, 500.0, 1.0)))).network
    assert np.array_equal(loop(network, sparse=True).change.toarray(), loop(network).change)


def test_a_plane_of_masses_and_dampings_is_what_each_of_them_feels() -> None:
    one = Loop("spring", hand_damping=1.0, delay=1.5, servo_hz=120.0, links=((0.0, 300.0, 1.0),))
    masses, dampings = np.array([0.05, 0.3]), np.array([8.0, 15.0])
    plane = mass_plane(prediction_of(one).felt_masses[0], masses, dampings)
    for (i, damping), (j, mass) in product(enumerate(dampings.tolist()), enumerate(masses.tolist())):
        found = felt(replace(one, mass=mass, damping=damping))
        here = plane.m[i, j], plane.b[i, j], plane.spectral_radius[i, j]
        assert here == pytest.approx((found.m, found.b, found.spectral_radius), rel=1e-8)


def test_what_changes_a_force_does_not_go_with_a_simulated_mass() -> None:
    network = prediction_of(Loop()).network
    for changed, words in (
        ({"hold": "ramp"}, "zoh hold"),
        ({"sampling": "average"}, "ideal sampling"),
        ({"drives": [Drive(lag=0.001)]}, "followers takes no drives"),
        ({"followers": network.followers * 2}, "2 elements"),
    ):
        with pytest.raises(ValueError, match=words):
            replace(network, **changed)


def test_a_hand_has_a_reason_where_no_mass_and_damping_is_felt() -> None:
    assert felt(Loop(hand_stiffness=0.0)).reason == "nothing holds the hand: it drifts"
    assert "moves masses" in felt(Loop("chain", links=((0.1, 500.0, 1.0),))).reason
    creeping = felt(Loop(damping=100.0, hand_stiffness=300.0))  # two real poles are a pair, too
    assert creeping.m == pytest.approx(0.15, rel=0.1)
    assert creeping.b == pytest.approx(100.0, rel=0.01)


def test_a_free_simulated_mass_is_stable_and_drifts() -> None:
    prediction = prediction_of(Loop(hand_stiffness=0.0))
    assert prediction.stable
    assert prediction.spectral_radius == 1.0
    assert felt(Loop(hand_stiffness=0.0)).spectral_radius < 1.0


def test_the_worst_of_the_assumed_hands_decides_the_verdict() -> None:
    hand = {"stiffness": {"from": 100.0, "to": 4000.0}, "damping": {"from": 0.0, "to": 500.0}}
    prediction = prediction_of(Loop(delay=0.0), assumed_hand=hand)
    assert prediction.judge.is_stable  # in the stiffest hand with the least damping
    assert not prediction.stable
    assert prediction.verdict == "unstable"
    assert "while the hand has 4000 N/m and 500 N·s/m" in verdict_words(prediction)[2]
    assert len(prediction.in_other_hands) == 3
    assert "in a hand of 100 to 4000 N/m, 0 to 500 N·s/m" in predicted_for(prediction.scene)
    steady = prediction_of(Loop(), assumed_hand={"stiffness": {"from": 100.0, "to": 4000.0}})
    assert steady.stable
    assert list(steady.in_other_hands) == ["the hand has 100 N/m and 0 N·s/m"]


def test_sentences_about_how_far_a_hand_is_stable() -> None:
    prediction = prediction_of(Loop())
    (sentence,) = admittance_sentences(*prediction.felt_masses, prediction.scene.units)
    assert sentence == (
        "hand: stable in hands of up to 5000 N/m (2.5 times this one) and with up to 0.1975 kg of hand and handle "
        "beyond the force sensor, each with all else as it is"
    )
    shaken = prediction_of(Loop(hand_stiffness=20_000.0))
    first, _ = admittance_sentences(*shaken.felt_masses, shaken.scene.units)
    assert first == (
        "hand: no simulated mass is stable in this hand at this damping; it is stable with a simulated damping of 20 "
        "to 410 N·s/m"
    )
    assert shaken.shaking is not None
    (warning,) = [one for one in warnings_about(shaken.scene, shaken) if "unstable" in one]
    assert "oscillates with up to 1 m/s" in warning


def test_a_change_that_helps_is_of_the_simulated_mass() -> None:
    wall = Loop("spring", mass=0.01, hand_stiffness=300.0, links=((0.0, 60_000.0, 0.0),))
    assert "times the simulated mass" in ways_to_stability(prediction_of(wall))


def test_contacts_are_judged_in_each_state() -> None:
    wall = Loop("wall", links=((0.0, 1000.0, 2.0),))
    prediction = prediction_of(wall)
    assert prediction.states.count == 2
    assert prediction.stable
    stiff = replace(wall, links=((0.0, 900_000.0, 2.0),))  # more than the mass bears in a step
    assert "unstable" in (prediction_of(stiff).verdict, prediction_of(stiff).decisive[1].verdict)


def test_questions_about_forces_are_refused_in_words() -> None:
    scene = scene_of(Loop())
    with pytest.raises(UsageError, match="found admittance, expected impedance"):
        predict_impedance(scene, [10.0])
    with pytest.raises(UsageError, match="expected impedance: virtual couplings are derived for a device that renders"):
        virtual_couplings(scene)
    (part,) = predict(scene).parts
    assert part.any_hand.is_passive is None
    assert "renders forces" in part.any_hand.not_derived
    assert part.any_hand.worst_hand((0.0, 1.0), (0.0, 100.0)) is None
    assert part.felt.reason == "in admittance a hand feels a mass and a damping"
    assert part.rows == ()
    assert part.weight is None
    assert part.own_motion is None
    for numbers in (*part.at_frequencies, part.static_stiffness, part.desired.k):
        assert np.isnan(numbers).all()


def test_a_fading_force_is_as_steep_as_the_simulated_mass_bears() -> None:
    stiffest = fade_stiffness(scene_of(Loop()), 0)
    spring = Loop("spring", hand_stiffness=0.0, hand_damping=5.0, delay=0.0, links=((0.0, stiffest, 0.0),))
    for share, is_stable in ((0.999, True), (1.001, False)):
        one = replace(spring, links=((0.0, share * stiffest, 0.0),))
        assert bool(np.abs(poles_of(prediction_of(one).network)).max() < 1.0) is is_stable
