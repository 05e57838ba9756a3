"""The mock's mass in continuous time, free or on a spring, against the exponential of the matrix of
m x'' + b x' + k x = F, for which no regime is special; under Coulomb friction, against a search for every stop."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hapsim.device.mock.motion import strike
from tests.thorough import points

sys.path.insert(0, str(Path(__file__).parent))
from bodies import (
    ROUNDING,
    anything,
    body_of,
    decades,
    exactly,
    forces,
    frictions,
    masses,
    move,
    passage,
    positions,
    positive,
    sizes,
    state_of,
    stiffnesses,
    times,
    velocities,
)

RATIOS = [0.0, 1e-9, 0.3, 1 - 1e-9, 1 - 1e-15, 1.0, 1 + 1e-15, 1 + 1e-9, 1.06, 1.07, 1.5, 50.0, 1e5]
PHASES = [1e-9, 1e-4, 1e-2, 0.6, 1.0, 1.999999, 2.000001, 2.5, 30.0, 1000.0]
FREE = [0.0, 1e-9, 1e-3, 0.0999, 0.1, 0.1001, 1.0, 30.0, 1e4, 1e9]
LONG = [1e-9, 1e-4, 1e-3, 0.99, 1.0, 1.01, 50.0]
MASS, STEP = 0.1, 1e-3
REGIMES = [(b, 0.0, t) for b in FREE for t in LONG] + [
    (2 * ratio * MASS * phase / STEP, MASS * (phase / STEP) ** 2, STEP) for ratio in RATIOS for phase in PHASES
]
FREE_OR_HELD = st.one_of(st.tuples(st.just(0.0), times), st.tuples(stiffnesses, decades(-9, 1)))
"""(stiffness, interval)."""


def require_exact(m: float, b: float, k: float, force: float, x: float, v: float, t: float) -> None:
    body = body_of(m, b, position=x, velocity=v, stiffness=k)
    move(body, force, t)
    difference = np.abs(state_of(body) - exactly(m, b, k, force, x, v, t))
    assert (difference <= ROUNDING * sizes(m, b, k, force, x, v, t)).all()


@pytest.mark.thorough(keep=20)
@pytest.mark.parametrize(("b", "k", "t"), REGIMES)
def test_position_velocity_and_area_are_exact_in_every_regime(b: float, k: float, t: float) -> None:
    for force, x, v in ((-1.7, 0.03, 0.4), (0.0, 0.02, 0.0), (0.0, 0.0, -0.3), (2.5, 0.0, 0.0)):
        require_exact(MASS, b, k, force, x, v, t)


@settings(max_examples=points(60, 180), deadline=None, derandomize=True)
@given(masses, frictions, FREE_OR_HELD, forces, positions, velocities)
@example(1.0, 1.0, (0.0, 1.0), 1.0, 0.0, 0.0)  # where the series ends
@example(1.0, math.nextafter(1.0, 2.0), (0.0, 1.0), 1.0, 0.0, 0.0)
@example(1e-4, 1e6, (0.0, 1e4), -1e5, 0.0, 1e3)
def test_position_velocity_and_area_are_exact_whatever_the_body(
    m: float, b: float, held: tuple[float, float], force: float, x: float, v: float
) -> None:
    require_exact(m, b, held[0], force, x, v, held[1])


def require_every_digit_from_rest(b: float, k: float, force: float, t: float) -> None:
    body = body_of(1.0, b, stiffness=k)
    move(body, force, t)
    np.testing.assert_allclose(state_of(body), exactly(1.0, b, k, force, 0.0, 0.0, t), rtol=ROUNDING)


@pytest.mark.parametrize("t", [1e-12, 1e-6, 1e-3, 0.3])
@pytest.mark.parametrize("k", [1e-18, 1e-6, 0.3, 7.0])
@pytest.mark.parametrize("b", [0.0, 1e-12, 1e-3, 0.3, 2.0, 100.0, 1e4])
def test_from_rest_no_digit_of_position_and_area_is_lost_however_small_they_are(b: float, k: float, t: float) -> None:
    require_every_digit_from_rest(b, k, 3.0, t)


@settings(max_examples=points(40, 80), deadline=None, derandomize=True)
@given(st.floats(0.0, 12.0), st.floats(0.01, 9.0))
@example(0.01, 0.0101)  # where a formula by exponentials would have lost four digits
@example(0.2, 0.01)
@example(4.0, 4.0)  # where the series ends
@example(4.0, math.nextafter(4.0, 5.0))
@example(math.nextafter(4.0, 5.0), 4.0)
@example(math.nextafter(4.0, 5.0), 0.01)
@example(4.8, 5.12)  # where two decays are no longer taken as close
def test_from_rest_no_digit_is_lost_where_one_formula_takes_over_from_another(b: float, k: float) -> None:
    require_every_digit_from_rest(b, k, 1.0, 1.0)


@pytest.mark.parametrize(("coulomb", "stiffness"), [(0.0, 0.0), (0.5, 0.0), (0.0, 300.0), (0.5, 300.0)])
def test_the_push_of_a_hand_comes_to_the_force(coulomb: float, stiffness: float) -> None:
    held, free = (body_of(0.2, 1.0, coulomb, 0.01, 0.3, stiffness, push) for push in (2.5, 0.0))
    move(held, -1.25, 0.004)
    move(free, 1.25, 0.004)
    assert state_of(held).tolist() == state_of(free).tolist()


def test_an_impulse_changes_the_momentum_and_nothing_else() -> None:
    body = body_of(0.25, 3.0, 0.5, position=0.1, velocity=-2.0)
    strike(body, 0.75)
    assert state_of(body).tolist() == [0.1, 1.0, 0.0]


@settings(max_examples=points(40, 80), deadline=None, derandomize=True)
@given(
    masses,
    frictions,
    st.one_of(st.just(0.0), decades(-3, 2)),
    st.one_of(st.just(0.0), stiffnesses),
    forces,
    positions,
    velocities,
    decades(-9, 1),
)
def test_what_moves_next_to_it_makes_no_difference_to_a_body(
    m: float, b: float, coulomb: float, k: float, force: float, x: float, v: float, t: float
) -> None:
    others = [
        body_of(1.0),
        body_of(1.0, coulomb=1.0),
        body_of(1.0, stiffness=1.0),
        body_of(1.0, 1.0, 1.0, stiffness=1.0),
    ]
    alone = body_of(m, b, coulomb, x, v, k)
    move(alone, force, t)
    for beside in ([other] for other in others):
        body = body_of(m, b, coulomb, x, v, k)
        move(body, force, t, beside)
        assert state_of(body).tolist() == state_of(alone).tolist()


# Dry friction.


def stops_of(
    m: float, b: float, k: float, coulomb: float, force: float, x: float, v: float, t: float
) -> tuple[np.ndarray, int]:
    """Position, velocity, area after `t`, and how often the mass came to rest: it looks for every zero of the velocity.

    Steps of a twentieth of the shortest time constant until the velocity has changed its sign, then Newton's method.
    """
    with mp.workdps(40):
        state, left, stops = mp.matrix([x, v, 0, 0]), mp.mpf(t), 0
        rate = mp.sqrt(mp.mpf(k) / m) + mp.mpf(b) / m
        step = min(left, 1 / (20 * rate)) if rate else left
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


def require_every_stop(
    m: float, b: float, k: float, coulomb: float, force: float, x: float, v: float, t: float
) -> np.record:
    body = body_of(m, b, coulomb, x, v, k)
    move(body, force, t)
    expected, _ = stops_of(m, b, k, coulomb, force, x, v, t)
    size = sizes(m, b, k, abs(force) + coulomb, x, v, t)
    assert (np.abs(state_of(body) - expected) <= 3 * ROUNDING * size).all()
    return body


@pytest.mark.thorough(keep=12)
@pytest.mark.parametrize("ratio", [0.0, 0.02, 0.4, 1 - 1e-9, 1.0, 1 + 1e-9, 1.3, 3.0])
@pytest.mark.parametrize("seed", range(5))
def test_on_a_spring_dry_friction_follows_every_stop_of_an_independent_search(ratio: float, seed: int) -> None:
    random = np.random.default_rng([seed, int(100 * ratio)])
    m, frequency = 10 ** random.uniform(-1, 0.5), 10 ** random.uniform(-0.5, 1.5)
    k = m * frequency**2
    coulomb, force = random.uniform(0.01, 0.2) * k, random.uniform(-1, 1) * k
    x, v = random.uniform(-2, 2), random.choice([0.0, random.uniform(-3, 3) * frequency])
    require_every_stop(m, 2 * ratio * math.sqrt(m * k), k, coulomb, force, x, v, random.uniform(1, 12) / frequency)


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("seed", range(12))
def test_a_free_mass_pushed_about_under_dry_friction_follows_it_too(seed: int) -> None:
    random = np.random.default_rng(seed)
    m, b = 10 ** random.uniform(-1, 0.5), random.choice([0.0, 10 ** random.uniform(-2, 1)])
    coulomb, x, v = random.uniform(0.2, 1.5), random.uniform(-1, 1), random.uniform(-2, 2)
    stuck = 0
    for _ in range(12):
        force, t = random.uniform(-3, 3), 10 ** random.uniform(-2, 0.3)
        body = require_every_stop(m, b, 0.0, coulomb, force, x, v, t)
        x, v, stuck = float(body["position"]), float(body["velocity"]), stuck + (body["velocity"] == 0)
    assert stuck < 12


def test_the_search_that_dry_friction_is_held_against_sees_many_stops() -> None:
    assert stops_of(1.0, 0.02, 1.0, 0.05, 0.0, 1.0, 0.0, 12.0)[1] == 3
    assert stops_of(1.0, 2.0, 1.0, 0.05, 0.0, 1.0, -9.0, 12.0)[1] == 1
    assert stops_of(1.0, 2.0, 1.0, 0.05, 0.0, 1.0, 0.0, 12.0)[1] == 0
    assert stops_of(2.0, 0.0, 0.0, 1.0, -5.0, 0.0, 3.0, 3.0)[1] == 1


def way_to_rest(m: float, b: float, total: float, v: float) -> tuple[float, float]:
    """Time and distance to rest from speed `v` > 0 under the decelerating force `total` > 0."""
    with mp.workdps(60):
        m, b, total, v = map(mp.mpf, (m, b, total, v))
        if b == 0:
            return float(m * v / total), float(m * v**2 / (2 * total))
        time = m / b * mp.log1p(b * v / total)
        return float(time), float(m / b * v - total / b * time)


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("b", [0.0, 1e-15, 1e-12, 1e-6, 0.5, 40.0, 1e6])
def test_dry_friction_brings_the_mass_to_rest_when_and_where_the_closed_form_predicts(
    b: float, direction: float
) -> None:
    m, coulomb, v = 0.2, 0.7, 0.9
    time, distance = way_to_rest(m, b, coulomb, v)
    body = body_of(m, b, coulomb, velocity=direction * v)
    move(body, 0.0, time * (1 - 1e-9))
    assert body["velocity"] * direction > 0
    move(body, 0.0, time * 2e-9)
    assert body["velocity"] == 0
    assert body["position"] * direction == pytest.approx(distance, rel=1e-13)
    move(body, 0.0, 1e3)
    assert body["position"] * direction == pytest.approx(distance, rel=1e-13)


def test_the_turning_point_is_exact_where_the_friction_is_all_but_nothing() -> None:
    m, v = 1.0, 1.0
    for b in (0.0, *np.logspace(-16, -6, 41)):
        body = body_of(m, float(b), 1.0, velocity=v)
        move(body, -3.0, 1.0)
        time, distance = way_to_rest(m, float(b), 4.0, v)
        back = exactly(m, float(b), 0.0, -2.0, distance, 0.0, 1.0 - time)
        assert body["position"] == pytest.approx(back[0], abs=3e-16)
        assert body["velocity"] == pytest.approx(back[1], abs=3e-15)


@pytest.mark.parametrize("b", [0.0, 0.1, 8.0, 8e3])
@pytest.mark.parametrize("coulomb", [0.0, 0.5])
def test_a_mass_that_rests_where_the_spring_holds_the_force_stays_there_to_the_last_bit(
    b: float, coulomb: float
) -> None:
    body = body_of(0.25, b, coulomb, 0.75, stiffness=64.0)
    for _ in range(10):
        move(body, 48.0, 0.125)
    assert state_of(body).tolist() == [0.75, 0.0, 0.9375]


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


FREE_BODIES = st.tuples(masses, frictions, st.just(0.0), decades(-3, 2), forces, positions, velocities, times)
OSCILLATORS = st.builds(  # whose frequency is 1
    lambda m, ratio, coulomb, force, x, v, t: (m, 2 * ratio * m, m, coulomb * m, force * m, x, v, t),
    masses,
    st.floats(0.0, 4.0),
    decades(-2, 0),
    st.floats(-1.0, 1.0),
    st.floats(-2.0, 2.0),
    st.floats(-2.0, 2.0),
    st.floats(0.1, 20.0),
)


@settings(max_examples=points(80, 160), deadline=None, derandomize=True)
@given(st.one_of(FREE_BODIES, OSCILLATORS), st.floats(0.0, 1.0))
def test_dry_friction_knows_neither_left_from_right_nor_one_interval_from_two(
    of: tuple[float, ...], cut: float
) -> None:
    m, b, k, coulomb, force, x, v, t = of
    one, other, parts = (body_of(m, b, coulomb, s * x, s * v, k) for s in (1.0, -1.0, 1.0))
    move(one, force, t)
    move(other, -force, t)
    move(parts, force, cut * t)
    move(parts, force, t - cut * t)
    size = sizes(m, b, k, abs(force) + coulomb, x, v, t)
    assert (state_of(one) == -state_of(other)).all()
    assert (np.abs(state_of(one) - state_of(parts)) <= 1e-12 * size).all()


@pytest.mark.parametrize("coulomb", [1e-14, 1e-100, 1e-310, 5e-324])
@pytest.mark.parametrize(("b", "k", "t"), [(0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (1e9, 0.0, 1.0), (0.0, 4.0, 2e3)])
def test_dry_friction_of_almost_nothing_hardly_slows_a_mass(coulomb: float, b: float, k: float, t: float) -> None:
    """On the spring thousands of swings within one interval."""
    body, freed = body_of(1.0, b, coulomb, 0.25, 1.0, k), body_of(1.0, b, 0.0, 0.25, 1.0, k)
    move(body, 0.0, t)
    move(freed, 0.0, t)
    np.testing.assert_allclose(state_of(body), state_of(freed), rtol=0, atol=1e-9 if k else 1e-11)


@settings(max_examples=points(100, 300), deadline=None, derandomize=True)
@given(
    positive,
    st.floats(min_value=0.0),
    st.one_of(st.just(0.0), positive),
    st.floats(min_value=0.0),
    anything,
    anything,
    anything,
    positive,
)
@example(1.0, 1.0, 0.0, 1e-310, 0.0, 1.0, 1.0, 1.0)
@example(1e-300, 0.0, 0.0, 1.0, 1e300, 0.0, 1e300, 1.0)
@example(1.0, 1.0, 0.0, 1.0, math.inf, 0.0, 0.0, 1.0)
@example(1.0, 0.0, 0.0, 1e308, -1.7e308, 0.0, 1.0, 1.0)
@example(1.0, 0.0, 1.0, 1e-310, 0.0, 1.0, 0.0, 1e300)
@example(1e-300, 1.0, 1.0, 1.0, 1e300, 0.0, 1e300, 1.0)
@example(1.0, 0.0, 1e300, 1e-9, 0.0, 1.0, 1.0, 1e9)
@example(1.0, 2.0, 1.0, 1e-9, 1.0, 1.0, 0.0, 1.0)
def test_no_number_makes_the_motion_hang_or_raise(
    m: float, b: float, k: float, coulomb: float, force: float, x: float, v: float, t: float
) -> None:
    move(body_of(m, b, coulomb, x, v, k), force, t)
