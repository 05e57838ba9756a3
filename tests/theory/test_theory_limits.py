"""Stability limits, folds of the map, and reasons for no solution, against closed forms and the poles."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hapsim.theory import Configuration
from hapsim.theory.hand.configuration import stiffest_stable

MASS, RATE = 0.2, 1000.0
T = 1.0 / RATE
STIFFNESS_UNIT, DAMPING_UNIT = MASS / T**2, MASS / T

DAMPERS = {"backward": None, "centred": None, "filtered": 60.0, "sensed": None}
# Every second one: any three of their values meet.
CASES = [
    (hold, sampling, delay, damper, spring)
    for at_delay, delay in enumerate((0.0, 0.5, 1.0, 2.3))
    for at_damper, damper in enumerate(DAMPERS)
    for hold, sampling, spring in itertools.product(("zoh", "impulse"), ("ideal", "average"), (0.0, 0.05))
    if (at_delay + at_damper + (hold == "zoh") + (sampling == "ideal") + (spring > 0.0)) % 2
]


def configuration(**changed: object) -> Configuration:
    return Configuration(**({"mass": MASS, "rate": RATE} | changed))


def of_case(hold: str, sampling: str, delay: float, damper: str, spring: float) -> Configuration:
    return configuration(
        friction=2.0,
        hold=hold,
        sampling=sampling,
        delay=delay,
        damper=damper,
        cutoff=DAMPERS[damper],
        stiffness=spring * STIFFNESS_UNIT,
    )


class TestTheStableStiffness:
    def test_with_a_held_force_and_no_delay_it_is_known_in_closed_form(self) -> None:
        c = configuration(delay=0.0)
        beta = np.array([1e-9, 1e-4, 0.1, 2.0 * (np.sqrt(2.0) - 1.0), 1.5, 1.99])
        most = c.stable_stiffness(beta * DAMPING_UNIT)[1] / STIFFNESS_UNIT
        np.testing.assert_allclose(most, 2.0 * beta * (2.0 - beta) / (2.0 + beta), rtol=1e-9)
        assert most.max() == pytest.approx(12.0 - 8.0 * np.sqrt(2.0), rel=1e-12)

    def test_where_none_is_stable_there_is_none(self) -> None:
        c = configuration(delay=0.0)
        assert np.isnan(c.stable_stiffness([-1.0, 2.01 * DAMPING_UNIT, np.nan])).all()

    @pytest.mark.thorough(keep=10)
    @pytest.mark.parametrize("case", CASES, ids=str)
    def test_on_either_side_of_its_ends_the_poles_agree(self, case: tuple[str, str, float, str, float]) -> None:
        c = of_case(*case)
        B = np.linspace(-0.5, 1.2, 18) * DAMPING_UNIT * 0.5
        least, most = c.stable_stiffness(B)
        some = np.isfinite(most) & (most > least)
        assert some.any()
        width = (most - least)[some]
        for side, ends in ((-1.0, least[some]), (1.0, most[some])):
            step = 1e-4 * width
            inside, outside = ends - side * step, ends + side * step
            assert c.is_stable(inside, B[some]).all()
            assert (c.spectral_radius(outside, B[some]) > 1.0).all()

    def test_the_stable_damping_is_its_reverse(self) -> None:
        c = configuration(friction=1.0, delay=1.0)
        K = np.array([100.0, 2000.0, 2e4])
        least, most = c.stable_damping(K)
        assert (least < most).all()
        for B in (least, most):
            np.testing.assert_allclose(c.stable_stiffness(B)[1], K, rtol=1e-8)

    def test_scalars_give_scalars_and_arrays_keep_their_shape(self) -> None:
        c = configuration()
        assert np.ndim(c.stable_stiffness(1.0)[0]) == 0
        assert c.stable_damping(np.ones((2, 3)))[1].shape == (2, 3)
        assert [np.ndim(value) for value in configuration(friction=1.0).fold(700.0)] == [0] * 4


class TestTheStabilityLimit:
    @pytest.mark.parametrize("case", CASES, ids=str)
    def test_on_it_the_hand_swings_for_ever_at_the_frequency(self, case: tuple[str, str, float, str, float]) -> None:
        c = of_case(*case)
        frequency = np.geomspace(0.5, 450.0, 60)
        K, B = c.stability_limit(frequency)
        limits = np.isfinite(K)
        assert limits.any()
        poles = c.poles(K[limits], B[limits])
        pole = np.exp(2j * np.pi * frequency[limits] * T)
        assert np.abs(poles - pole[:, None]).min(axis=1).max() < 1e-9
        np.testing.assert_allclose(c.spectral_radius(K[limits], B[limits]), 1.0, atol=1e-9)

    def test_from_the_nyquist_frequency_on_there_is_none(self) -> None:
        assert np.isnan(configuration().stability_limit([500.0, 700.0])).all()


class TestTheFold:
    c = configuration(friction=1.0, delay=1.0)

    def curve(self) -> tuple[np.ndarray, ...]:
        K, B, k, b = self.c.fold(np.geomspace(100.0, 2000.0, 400))
        had = np.isfinite(K)
        assert had.sum() > 10
        return K[had], B[had], k[had], b[had]

    def test_what_is_felt_there_is_simulated_by_it(self) -> None:
        K, B, k, b = self.curve()
        again = self.c.simulated(k, b, dominant=False)
        np.testing.assert_allclose(again[0], K, rtol=1e-6)
        np.testing.assert_allclose(again[1], B, rtol=1e-6)

    def test_beyond_it_there_is_no_equivalent_and_before_it_there_is(self) -> None:
        K, B, _, _ = self.curve()
        stable = (K > 0) & self.c.is_stable(K, B)
        assert stable.any()
        assert self.c.dominant(K, 0.99 * B)[stable].all()
        assert not self.c.dominant(K, 1.01 * B)[stable].any()

    def test_without_delay_and_with_impulses_there_is_none(self) -> None:
        assert np.isnan(configuration(delay=0.0, hold="impulse").fold([1.0, 100.0])).all()


class TestTheImpedance:
    def test_beyond_the_nyquist_frequency_it_is_not_a_number(self) -> None:
        assert np.isnan(configuration().impedance(1.0, 1.0, [0.0, 500.0, 600.0])).all()


class TestReasons:
    c = configuration(friction=1.0, delay=1.0)

    def test_where_there_is_an_equivalent_no_reason_is_given(self) -> None:
        assert self.c.why_no_equivalent(2000.0, 5.0) == ""

    def test_each_nan_has_its_words(self) -> None:
        K, B = np.array([2000.0, 10.0, np.nan, 1e7]), np.array([5.0, 140.0, 1.0, 1.0])
        said = self.c.why_no_equivalent(K, B)
        assert (np.isnan(self.c.equivalent(K, B)[0]) == (said != "")).all()
        assert "not finite" in said[2]

    def test_a_creep_and_an_alternation_are_distinguished(self) -> None:
        ideal = configuration(delay=0.0, hold="impulse")
        assert "changes its sign" in ideal.why_no_equivalent(3.9 * STIFFNESS_UNIT, 1.5 * DAMPING_UNIT)
        late = configuration(delay=0.0)
        assert "motion creeps" in late.why_no_equivalent(0.01 * STIFFNESS_UNIT, 1.8 * DAMPING_UNIT)


def test_large_grids_are_worked_out_in_parts_and_come_out_the_same() -> None:
    c = configuration(friction=1.0, delay=1.0)
    K, B = np.geomspace(1.0, 1e5, 300)[:, None], np.linspace(-5.0, 150.0, 200)
    for method in (c.simulated, c.equivalent):
        whole = method(K, B)
        for i in (0, 151, 299):
            row = method(K[i], B)
            np.testing.assert_array_equal(whole[0][i], row[0])
            np.testing.assert_array_equal(whole[1][i], row[1])
    assert c.poles(K, B).shape == (300, 200, 4)


class TestWhereKAndBAreTied:
    """Impulses, no delay, no friction, a centred damper: at half the Nyquist frequency K + B = 2 has its pole at ±j."""

    c = configuration(delay=0.0, hold="impulse", damper="centred")

    def test_the_line_ends_what_is_stable(self) -> None:
        beta = np.array([0.003, 0.05, 0.3, 1.0])
        least, most = self.c.stable_stiffness(beta * DAMPING_UNIT)
        np.testing.assert_allclose(least, 0.0, atol=1e-9)
        np.testing.assert_allclose(most, (2.0 - beta) * STIFFNESS_UNIT, rtol=1e-9)
        most = self.c.stable_damping(0.1 * STIFFNESS_UNIT)[1]
        assert most == pytest.approx(1.9 * DAMPING_UNIT, rel=1e-9)


def test_a_long_delay_is_judged_too() -> None:
    c = configuration(friction=1.0, delay=60.0)
    _, most = c.stable_stiffness(0.0)
    assert most == pytest.approx(c.linear_stiffness_limit(0.0), rel=0.05)
    assert c.is_stable(0.999 * most, 0.0)
    assert not c.is_stable(1.001 * most, 0.0)


def test_a_spring_above_the_nyquist_frequency_is_not_taken_for_its_image() -> None:
    c = configuration(friction=1.0, stiffness=1.1 * np.pi**2 * STIFFNESS_UNIT)
    assert np.isnan(c.equivalent(0.0, 0.0)).all()
    assert not c.dominant(0.0, 0.0)
    assert "Nyquist" in c.why_no_equivalent(0.0, 0.0)


def test_a_device_with_a_spring_may_be_given_a_little_of_it_away() -> None:
    """A negative K is stable as long as it leaves something of the device's own spring."""
    c = configuration(friction=1.0, stiffness=500.0, delay=0.0)
    assert c.is_stable(-499.0, 0.0)
    assert not c.is_stable(-501.0, 0.0)
    least, _ = c.stable_stiffness(0.0)
    assert least == pytest.approx(-500.0, rel=1e-6)
    assert not configuration(friction=1.0).is_stable(-1e-12, 0.0)


@pytest.mark.parametrize("friction", [1e4, 1e6, 1e12])
@pytest.mark.parametrize(("delay", "share"), [(0.0, 2.0), (1.0, 1.0)])
def test_friction_that_stops_the_mass_within_a_sample_leaves_the_limit_of_an_integrator(
    friction: float, delay: float, share: float
) -> None:
    """Each sample moves it by f T/b0: z - 1 + K T/b0 z^-delay has its roots in the circle up to K T/b0 = 2, or 1."""
    hand = Configuration(mass=0.05, rate=1000.0, friction=friction, delay=delay)
    least, most = hand.stable_stiffness(0.0)
    assert (least, most) == pytest.approx((0.0, share * friction * 1000.0), rel=0.02)
    assert stiffest_stable(hand).stiffness == pytest.approx(most, rel=0.02)
