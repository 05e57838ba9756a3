"""The mock's mass on a spring, against the exponential of the matrix of m x'' + b x' + k x = F, for which no regime is
special; under Coulomb friction, against a search for every stop."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from bodies import (
    ROUNDING,
    anything,
    body_of,
    decades,
    exactly_on_spring,
    forces,
    frictions,
    masses,
    move,
    passage,
    positions,
    positive,
    sizes,
    spring_sizes,
    state_of,
    stiffnesses,
    velocities,
)

RATIOS = [0.0, 1e-9, 0.3, 1 - 1e-9, 1 - 1e-15, 1.0, 1 + 1e-15, 1 + 1e-9, 1.06, 1.07, 1.5, 50.0, 1e5]
PHASES = [1e-9, 1e-4, 1e-2, 0.6, 1.0, 1.999999, 2.000001, 2.5, 30.0, 1000.0]


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("phase", PHASES)
def test_on_a_spring_all_is_exact_for_every_damping_ratio_and_interval(ratio: float, phase: float) -> None:
    m, t = 0.1, 1e-3
    k = m * (phase / t) ** 2
    b = 2 * ratio * math.sqrt(k * m)
    for force, x, v in ((-1.7, 0.03, 0.4), (0.0, 0.02, 0.0), (0.0, 0.0, -0.3), (2.5, 0.0, 0.0)):
        body = body_of(m, b, position=x, velocity=v, stiffness=k)
        move(body, force, t)
        difference = np.abs(state_of(body) - exactly_on_spring(m, b, k, force, x, v, t))
        assert (difference <= ROUNDING * spring_sizes(m, b, k, force, x, v, t)).all()


@pytest.mark.parametrize("t", [1e-12, 1e-6, 1e-3, 0.3])
@pytest.mark.parametrize("k", [1e-18, 1e-6, 0.3, 7.0])
@pytest.mark.parametrize("b", [0.0, 1e-12, 1e-3, 0.3, 2.0, 100.0, 1e4])
def test_from_rest_no_digit_of_position_and_area_is_lost_however_small_they_are(b: float, k: float, t: float) -> None:
    body = body_of(1.0, b, stiffness=k)
    move(body, 3.0, t)
    np.testing.assert_allclose(state_of(body), exactly_on_spring(1.0, b, k, 3.0, 0.0, 0.0, t), rtol=ROUNDING)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(st.floats(0.0, 12.0), st.floats(0.01, 9.0))
@example(0.01, 0.0101)  # where a formula by exponentials would have lost four digits
@example(0.2, 0.01)
@example(4.0, 4.0)  # where the series ends
@example(4.0, math.nextafter(4.0, 5.0))
@example(math.nextafter(4.0, 5.0), 4.0)
@example(math.nextafter(4.0, 5.0), 0.01)
@example(4.8, 5.12)  # where two decays are no longer taken as close
def test_from_rest_no_digit_is_lost_where_one_formula_takes_over_from_another(b: float, k: float) -> None:
    body = body_of(1.0, b, stiffness=k)
    move(body, 1.0, 1.0)
    np.testing.assert_allclose(state_of(body), exactly_on_spring(1.0, b, k, 1.0, 0.0, 0.0, 1.0), rtol=ROUNDING)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(masses, frictions, stiffnesses, forces, positions, velocities, decades(-9, 1))
def test_on_a_spring_all_is_exact_whatever_the_body(
    m: float, b: float, k: float, force: float, x: float, v: float, t: float
) -> None:
    body = body_of(m, b, position=x, velocity=v, stiffness=k)
    move(body, force, t)
    difference = np.abs(state_of(body) - exactly_on_spring(m, b, k, force, x, v, t))
    assert (difference <= ROUNDING * spring_sizes(m, b, k, force, x, v, t)).all()


@settings(max_examples=80, deadline=None, derandomize=True)
@given(masses, frictions, st.one_of(st.just(0.0), decades(-3, 2)), forces, positions, velocities, decades(-9, 2))
def test_a_spring_that_goes_to_zero_leaves_the_free_mass(
    m: float, b: float, coulomb: float, force: float, x: float, v: float, t: float
) -> None:
    free = body_of(m, b, coulomb, x, v)
    move(free, force, t)
    size = sizes(m, b, abs(force) + coulomb, x, v, t)
    assume(coulomb == 0.0 or abs(abs(force) - coulomb) > 1e-3 * coulomb)
    for softness in (1e-16, 1e-100):
        soft = body_of(m, b, coulomb, x, v, softness * m / t**2)
        move(soft, force, t)
        what_the_spring_does = 1.01 * softness * size[0] * np.array([1.0, 1.0 / t, t])
        assert (np.abs(state_of(soft) - state_of(free)) <= 10 * ROUNDING * size + what_the_spring_does).all()


@pytest.mark.parametrize("b", [0.0, 0.1, 8.0, 8e3])
@pytest.mark.parametrize("coulomb", [0.0, 0.5])
def test_a_mass_that_rests_where_the_spring_holds_the_force_stays_there_to_the_last_bit(
    b: float, coulomb: float
) -> None:
    body = body_of(0.25, b, coulomb, 0.75, stiffness=64.0)
    for _ in range(10):
        move(body, 48.0, 0.125)
    assert state_of(body).tolist() == [0.75, 0.0, 0.9375]


def stops_of(
    m: float, b: float, k: float, coulomb: float, force: float, x: float, v: float, t: float
) -> tuple[np.ndarray, int]:
    """Position, velocity, area after `t`, and how often the mass came to rest: it looks for every zero of the velocity.

    Steps of a twentieth of the shortest time constant until the velocity has changed its sign, then Newton's method.
    """
    with mp.workdps(40):
        state, left, stops = mp.matrix([x, v, 0, 0]), mp.mpf(t), 0
        step = 1 / (20 * (mp.sqrt(mp.mpf(k) / m) + mp.mpf(b) / m))
        onward = passage(m, b, k, step)
        while left > 0:
            pull = force - k * state[0]
            if state[1] == 0 and abs(pull) <= coulomb:
                state[2] += left * state[0]
                break
            sign = mp.sign(state[1] if state[1] != 0 else pull)
            state[3] = force - coulomb * sign
            gone, there = step, onward * state
            while gone < left and there[1] * sign > 0:
                gone, there = gone + step, onward * there
            if there[1] * sign <= 0:
                for _ in range(7):
                    gone -= there[1] * m / (there[3] - b * there[1] - k * there[0])
                    there = passage(m, b, k, gone) * state
            if gone >= left:
                state = passage(m, b, k, left) * state
                break
            state, left, stops = mp.matrix([there[0], 0, there[2], 0]), left - gone, stops + 1
        return np.array([float(value) for value in state[:3]]), stops


@pytest.mark.parametrize("ratio", [0.0, 0.02, 0.4, 1 - 1e-9, 1.0, 1 + 1e-9, 1.3, 3.0])
@pytest.mark.parametrize("seed", range(5))
def test_on_a_spring_dry_friction_follows_every_stop_of_an_independent_search(ratio: float, seed: int) -> None:
    random = np.random.default_rng([seed, int(100 * ratio)])
    m, frequency = 10 ** random.uniform(-1, 0.5), 10 ** random.uniform(-0.5, 1.5)
    k = m * frequency**2
    b = 2 * ratio * math.sqrt(m * k)
    coulomb, force = random.uniform(0.01, 0.2) * k, random.uniform(-1, 1) * k
    x, v = random.uniform(-2, 2), random.choice([0.0, random.uniform(-3, 3) * frequency])
    t = random.uniform(1, 12) / frequency
    body = body_of(m, b, coulomb, x, v, k)
    move(body, force, t)
    expected, _ = stops_of(m, b, k, coulomb, force, x, v, t)
    size = spring_sizes(m, b, k, abs(force) + coulomb, x, v, t)
    assert (np.abs(state_of(body) - expected) <= 3 * ROUNDING * size).all()


def test_the_search_that_dry_friction_on_a_spring_is_held_against_sees_many_stops() -> None:
    assert stops_of(1.0, 0.02, 1.0, 0.05, 0.0, 1.0, 0.0, 12.0)[1] == 3
    assert stops_of(1.0, 2.0, 1.0, 0.05, 0.0, 1.0, -9.0, 12.0)[1] == 1
    assert stops_of(1.0, 2.0, 1.0, 0.05, 0.0, 1.0, 0.0, 12.0)[1] == 0


def test_dry_friction_takes_the_same_from_every_half_swing_until_the_mass_sticks() -> None:
    m, k, coulomb = 0.5, 32.0, 2.4  # half a period of pi/8 s, about +-0.075 m: 0.15 m less each time
    body = body_of(m, 0.0, coulomb, 1.0, stiffness=k)
    centres = [0.075, -0.075] * 3 + [0.075]
    move(body, 0.0, 7.5 * math.pi / 8)
    assert body["velocity"] == 0
    assert body["position"] == pytest.approx(-(1 - 7 * 0.15), abs=1e-14)
    assert body["area"] == pytest.approx((sum(centres) + 0.5 * body["position"]) * math.pi / 8, abs=1e-14)
    move(body, 0.0, 1e3)
    assert body["position"] == pytest.approx(-(1 - 7 * 0.15), abs=1e-14)


@pytest.mark.parametrize("b", [0.0, 4.0, 8.0, 400.0])
@pytest.mark.parametrize("force", [-3.0, 0.0, 20.0])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_mass_at_rest_sticks_within_the_friction_band_of_the_spring_and_only_there(
    b: float, force: float, side: float
) -> None:
    m, k, coulomb = 1.0, 16.0, 2.0
    edge = (force + side * coulomb) / k
    for place in (force / k, edge - side * 1e-9):
        body = body_of(m, b, coulomb, place, stiffness=k)
        for t in (1e-6, 1.0, 1e6):
            move(body, force, t)
        assert (body["position"], body["velocity"]) == (place, 0.0)
        assert body["area"] == pytest.approx(place * (1e-6 + 1.0 + 1e6), rel=1e-15)
    body = body_of(m, b, coulomb, edge + side * 1e-3, stiffness=k)
    move(body, force, 0.1)
    assert body["velocity"] * side < 0
    move(body, force, 1e4)
    assert abs(force - k * body["position"]) <= coulomb * (1 + 1e-12)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    masses,
    st.floats(0.0, 4.0),
    st.floats(0.1, 20.0),
    decades(-2, 0),
    st.floats(-1.0, 1.0),
    st.floats(-2.0, 2.0),
    st.floats(-2.0, 2.0),
    st.floats(0.0, 1.0),
)
def test_on_a_spring_dry_friction_knows_neither_left_from_right_nor_one_interval_from_two(
    m: float, ratio: float, phase: float, coulomb: float, force: float, x: float, v: float, cut: float
) -> None:
    k, t = m, phase  # the frequency is 1
    b = 2 * ratio * m
    one, other, parts = (body_of(m, b, coulomb * k, s * x, s * v, k) for s in (1.0, -1.0, 1.0))
    move(one, force * k, t)
    move(other, -force * k, t)
    move(parts, force * k, cut * t)
    move(parts, force * k, t - cut * t)
    size = spring_sizes(m, b, k, (abs(force) + coulomb) * k, x, v, t)
    assert (state_of(one) == -state_of(other)).all()
    assert (np.abs(state_of(one) - state_of(parts)) <= 1e-12 * size).all()


@settings(max_examples=150, deadline=None, derandomize=True)
@given(positive, st.floats(min_value=0.0), positive, st.floats(min_value=0.0), anything, anything, anything, positive)
@example(1.0, 0.0, 1.0, 1e-310, 0.0, 1.0, 0.0, 1e300)
@example(1e-300, 1.0, 1.0, 1.0, 1e300, 0.0, 1e300, 1.0)
@example(1.0, 0.0, 1e300, 1e-9, 0.0, 1.0, 1.0, 1e9)
@example(1.0, 2.0, 1.0, 1e-9, 1.0, 1.0, 0.0, 1.0)
def test_no_number_makes_the_motion_on_a_spring_hang_or_raise(
    m: float, b: float, k: float, coulomb: float, force: float, x: float, v: float, t: float
) -> None:
    move(body_of(m, b, coulomb, x, v, k), force, t)


@pytest.mark.parametrize("coulomb", [1e-14, 1e-100, 5e-324])
def test_dry_friction_of_almost_nothing_hardly_slows_thousands_of_swings_within_one_interval(coulomb: float) -> None:
    body, freed = body_of(1.0, 0.0, coulomb, 0.25, 1.0, 4.0), body_of(1.0, 0.0, 0.0, 0.25, 1.0, 4.0)
    move(body, 0.0, 2e3)
    move(freed, 0.0, 2e3)
    np.testing.assert_allclose(state_of(body), state_of(freed), rtol=0, atol=1e-9)
