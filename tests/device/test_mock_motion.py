"""The mock's mass in continuous time, against the solution written out in mpmath and against an independent solver.

A difference of rounding is measured against what the terms of a result are made of: |x|, |v| t, |F| t²/m.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import cache
from time import perf_counter

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from hapsim.compiling.native import address_of
from hapsim.device.mock.motion import BODY, move_free, move_gliding, move_of, move_on_spring, strike

ROUNDING = 1e-14
NATIVES = (move_gliding, move_free, move_on_spring)


def body_of(
    mass: float,
    friction: float = 0.0,
    coulomb: float = 0.0,
    position: float = 0.0,
    velocity: float = 0.0,
    stiffness: float = 0.0,
) -> np.record:
    fields = (mass, friction, stiffness, coulomb, position, velocity, 0.0)
    body: np.record = np.array([fields], BODY).view(np.recarray)[0]
    return body


@cache
def natives() -> dict[int, Callable[[int, float, float], None]]:
    """By address. Compiled when first asked for."""
    return {native.address(): native for native in NATIVES}


def move(body: np.record, force: float, h: float, beside: Sequence[np.record] = ()) -> None:
    """Moves it as a device does that has this body, and `beside` it others."""
    natives()[move_of(np.array([*beside, body]))](address_of(body), force, h)


def state_of(body: np.record) -> np.ndarray:
    """Position, velocity, area."""
    return np.array([body["position"], body["velocity"], body["area"]])


def sizes(m: float, b: float, force: float, x: float, v: float, t: float) -> np.ndarray:
    """The size of what position, velocity and area are made of: the friction only ever makes it smaller."""
    u = b * t / m
    v_travel, a_travel = (t, t * t / 2) if u < 1 else (m / b, t * m / b)
    speed = abs(v) + abs(force) / m * v_travel
    place = abs(x) + abs(v) * v_travel + abs(force) / m * a_travel
    return np.array([place, speed, t * place])


def exactly(m: float, b: float, force: float, x: float, v: float, t: float) -> np.ndarray:
    """Position, velocity, area after `t`, by m x'' + b x' = F solved by hand."""
    with mp.workdps(120):  # the solution for b > 0 loses three times the digits of b t / m
        m, b, force, x, v, t = map(mp.mpf, (m, b, force, x, v, t))
        if b == 0:
            a = force / m
            end = (x + v * t + a * t**2 / 2, v + a * t, x * t + v * t**2 / 2 + a * t**3 / 6)
        else:
            rate, final = b / m, force / b
            e = mp.exp(-rate * t)
            gone = (1 - e) / rate
            end = (
                x + final * t + (v - final) * gone,
                final + (v - final) * e,
                x * t + final * t**2 / 2 + (v - final) * (t - gone) / rate,
            )
        return np.array([float(value) for value in end])


def decades(low: int, high: int) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


def either_sign(low: int, high: int) -> st.SearchStrategy[float]:
    return st.one_of(st.just(0.0), decades(low, high), decades(low, high).map(lambda value: -value))


masses = decades(-4, 3)
frictions = st.one_of(st.just(0.0), decades(-9, 6))
forces = either_sign(-6, 5)
positions = either_sign(-6, 2)
velocities = either_sign(-6, 3)
times = decades(-9, 4)


@pytest.mark.parametrize("friction", [0.0, 1e-9, 1e-3, 0.0999, 0.1, 0.1001, 1.0, 30.0, 1e4, 1e9])
@pytest.mark.parametrize("t", [1e-9, 1e-4, 1e-3, 0.99, 1.0, 1.01, 50.0])
def test_position_velocity_and_area_are_exact_for_every_friction_and_interval(friction: float, t: float) -> None:
    m, force, x, v = 0.1, -1.7, 0.03, 0.4
    body = body_of(m, friction, position=x, velocity=v)
    move(body, force, t)
    difference = np.abs(state_of(body) - exactly(m, friction, force, x, v, t))
    assert (difference <= ROUNDING * sizes(m, friction, force, x, v, t)).all()


@settings(max_examples=400, deadline=None, derandomize=True)
@given(masses, frictions, forces, positions, velocities, times)
@example(1.0, 1.0, 1.0, 0.0, 0.0, 1.0)  # where the series ends
@example(1.0, math.nextafter(1.0, 2.0), 1.0, 0.0, 0.0, 1.0)
@example(1e-4, 1e6, -1e5, 0.0, 1e3, 1e4)
def test_position_velocity_and_area_are_exact_whatever_the_body(
    m: float, b: float, force: float, x: float, v: float, t: float
) -> None:
    body = body_of(m, b, position=x, velocity=v)
    move(body, force, t)
    difference = np.abs(state_of(body) - exactly(m, b, force, x, v, t))
    assert (difference <= ROUNDING * sizes(m, b, force, x, v, t)).all()


@settings(max_examples=300, deadline=None, derandomize=True)
@given(masses, frictions, forces, positions, velocities, times, st.lists(st.floats(0.0, 1.0), min_size=1, max_size=6))
def test_splitting_an_interval_changes_nothing_beyond_rounding(
    m: float, b: float, force: float, x: float, v: float, t: float, cuts: list[float]
) -> None:
    whole, parts = (body_of(m, b, position=x, velocity=v) for _ in range(2))
    move(whole, force, t)
    edges = [0.0, *sorted(cut * t for cut in cuts), t]
    for start, stop in itertools.pairwise(edges):
        move(parts, force, stop - start)
    assert (np.abs(state_of(whole) - state_of(parts)) <= 10 * ROUNDING * sizes(m, b, force, x, v, t)).all()


def test_an_interval_of_no_length_changes_nothing() -> None:
    for coulomb in (0.0, 1.0):
        body = body_of(0.2, 3.0, coulomb, position=0.1, velocity=-0.3)
        move(body, 5.0, 0.0)
        assert state_of(body).tolist() == [0.1, -0.3, 0.0]


@settings(max_examples=200, deadline=None, derandomize=True)
@given(masses, frictions, forces, velocities, times)
def test_momentum_is_what_the_force_gave_less_what_the_friction_took(
    m: float, b: float, force: float, v: float, t: float
) -> None:
    body = body_of(m, b, velocity=v)
    move(body, force, t)
    given_ = force * t - b * body["position"]
    size = m * abs(v) + abs(force) * t + b * abs(body["position"])
    assert abs(m * (body["velocity"] - v) - given_) <= 10 * ROUNDING * size


@pytest.mark.parametrize("friction", [0.0, 0.3, 2.0, 8.0])
@pytest.mark.parametrize("force", [-3.0, 0.0, 0.7])
def test_kinetic_energy_is_the_work_of_the_force_less_the_heat_of_the_friction(friction: float, force: float) -> None:
    m, v, t = 0.4, 1.3, 0.9
    speeds_squared, (nodes, weights) = [], np.polynomial.legendre.leggauss(40)
    for node in nodes:
        body = body_of(m, friction, velocity=v)
        move(body, force, t * (node + 1) / 2)
        speeds_squared.append(body["velocity"] ** 2)
    heat = friction * t / 2 * float(weights @ np.array(speeds_squared))
    body = body_of(m, friction, velocity=v)
    move(body, force, t)
    gained = m / 2 * (body["velocity"] ** 2 - v**2)
    assert gained == pytest.approx(force * body["position"] - heat, abs=1e-13)


def test_an_impulse_changes_the_momentum_and_nothing_else() -> None:
    body = body_of(0.25, 3.0, 0.5, position=0.1, velocity=-2.0)
    strike(body, 0.75)
    assert state_of(body).tolist() == [0.1, 1.0, 0.0]


# Coulomb friction.


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
def test_dry_friction_brings_the_mass_to_rest_when_and_where_the_closed_form_says(b: float, direction: float) -> None:
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


def test_a_mass_that_came_to_rest_lends_its_place_to_the_area_until_the_end() -> None:
    body = body_of(1.0, 0.0, 2.0, position=0.5, velocity=4.0)  # rests after 2 s, 4 m further
    move(body, 0.0, 10.0)
    assert body["area"] == pytest.approx(0.5 * 2 + (4 * 2**2 / 2 - 2 * 2**3 / 6) + 4.5 * 8, rel=1e-14)


@pytest.mark.parametrize("force", [0.0, 1.0, -1.0, 1.5, -1.5])
def test_a_force_up_to_the_dry_friction_does_not_move_a_mass_at_rest(force: float) -> None:
    body = body_of(0.1, 0.2, 1.5, position=0.3)
    for t in (1e-6, 1.0, 1e6):
        move(body, force, t)
    assert (body["position"], body["velocity"]) == (0.3, 0.0)
    assert body["area"] == pytest.approx(0.3 * (1e-6 + 1.0 + 1e6), rel=1e-15)


@pytest.mark.parametrize("force", [1.6, -1.6, 400.0, -400.0])
def test_a_force_above_the_dry_friction_sets_the_mass_off_with_what_is_left_of_it(force: float) -> None:
    body, freed = body_of(0.1, 0.2, 1.5), body_of(0.1, 0.2)
    move(body, force, 0.7)
    move(freed, force - math.copysign(1.5, force), 0.7)
    assert state_of(body).tolist() == state_of(freed).tolist()


def test_a_mass_that_is_turned_round_meets_the_dry_friction_from_both_sides() -> None:
    body = body_of(2.0, 0.0, 1.0, velocity=3.0)
    move(body, -5.0, 3.0)  # decelerates at 3 m/s² for 1 s and 1.5 m; then -2 m/s² for 2 s
    assert body["velocity"] == pytest.approx(-4.0, rel=1e-14)
    assert body["position"] == pytest.approx(1.5 - 4.0, rel=1e-14)


def test_the_turning_point_is_exact_where_the_friction_is_all_but_nothing() -> None:
    m, v = 1.0, 1.0
    for b in (0.0, *np.logspace(-16, -6, 41)):
        body = body_of(m, float(b), 1.0, velocity=v)
        move(body, -3.0, 1.0)
        time, distance = way_to_rest(m, float(b), 4.0, v)
        back = exactly(m, float(b), -2.0, distance, 0.0, 1.0 - time)
        assert body["position"] == pytest.approx(back[0], abs=3e-16)
        assert body["velocity"] == pytest.approx(back[1], abs=3e-15)


def solved(
    m: float, b: float, coulomb: float, x: float, v: float, pieces: Sequence[tuple[float, float]]
) -> list[list[float]]:
    """Position, velocity, area after each (force, duration), by a Runge-Kutta method with an event at rest."""
    ends, area = [], 0.0

    def stops(_t: float, y: np.ndarray, *_: float) -> float:
        return float(y[1])

    stops.terminal = True  # type: ignore[attr-defined]
    for force, duration in pieces:
        left = duration
        while left > 0:
            if v == 0 and abs(force) <= coulomb:
                area, left = area + left * x, 0.0
                break
            sign = np.sign(v) if v != 0 else np.sign(force)

            def motion(_t: float, y: np.ndarray, total: float = force - coulomb * sign) -> list[float]:
                return [y[1], (total - b * y[1]) / m, y[0]]

            events: Callable | None = stops if v != 0 else None
            run = solve_ivp(motion, (0, left), [x, v, area], "DOP853", events=events, rtol=1e-13, atol=1e-15)
            x, v, area = run.y[:, -1]
            left -= run.t[-1]
            if run.status == 1:
                v = 0.0
        ends.append([x, v, area])
    return ends


@pytest.mark.parametrize("seed", range(12))
def test_a_mass_pushed_about_under_dry_friction_follows_an_independent_solver(seed: int) -> None:
    random = np.random.default_rng(seed)
    m, b = 10 ** random.uniform(-1, 0.5), random.choice([0.0, 10 ** random.uniform(-2, 1)])
    coulomb, x, v = random.uniform(0.2, 1.5), random.uniform(-1, 1), random.uniform(-2, 2)
    pieces = [(random.uniform(-3, 3), 10 ** random.uniform(-2, 0.3)) for _ in range(12)]
    body = body_of(m, b, coulomb, x, v)
    stuck = 0
    for (force, t), expected in zip(pieces, solved(m, b, coulomb, x, v, pieces), strict=True):
        move(body, force, t)
        np.testing.assert_allclose(state_of(body), expected, rtol=0, atol=2e-10)
        stuck += body["velocity"] == 0
    assert stuck < len(pieces)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(masses, frictions, decades(-3, 2), forces, positions, velocities, times, st.floats(0.0, 1.0))
def test_splitting_an_interval_with_dry_friction_changes_nothing_beyond_rounding(
    m: float, b: float, coulomb: float, force: float, x: float, v: float, t: float, cut: float
) -> None:
    whole, parts = (body_of(m, b, coulomb, x, v) for _ in range(2))
    move(whole, force, t)
    move(parts, force, cut * t)
    move(parts, force, t - cut * t)
    size = sizes(m, b, abs(force) + coulomb, x, v, t)
    assert (np.abs(state_of(whole) - state_of(parts)) <= 1e-12 * size).all()


@settings(max_examples=300, deadline=None, derandomize=True)
@given(masses, frictions, decades(-3, 2), forces, positions, velocities, times)
def test_left_and_right_are_alike_and_dry_friction_never_gives_energy(
    m: float, b: float, coulomb: float, force: float, x: float, v: float, t: float
) -> None:
    one, other = body_of(m, b, coulomb, x, v), body_of(m, b, coulomb, -x, -v)
    move(one, force, t)
    move(other, -force, t)
    assert (state_of(one) == -state_of(other)).all()
    gained = m / 2 * (one["velocity"] ** 2 - v**2)
    work = force * (one["position"] - x)
    size = m * sizes(m, b, abs(force) + coulomb, 0.0, v, t)[1] ** 2 + abs(force) * sizes(m, b, force, x, v, t)[0]
    assert gained <= work + 1e-13 * size


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    masses, st.floats(0.0, 10.0), st.floats(0.01, 10.0), st.floats(-20.0, 20.0), st.floats(-5.0, 5.0), decades(-6, 1)
)
def test_dry_friction_is_the_limit_of_no_friction_when_it_goes_to_zero(
    m: float, b: float, coulomb: float, force: float, v: float, t: float
) -> None:
    assume(abs(force) > 1e-3)
    tiny, none = body_of(m, b, 1e-14 * coulomb, velocity=v), body_of(m, b, velocity=v)
    move(tiny, force, t)
    move(none, force, t)
    assert (np.abs(state_of(tiny) - state_of(none)) <= 1e-9 * sizes(m, b, abs(force) + coulomb, 0.0, v, t)).all()


anything = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
positive = st.floats(min_value=5e-324, allow_nan=False)


@settings(max_examples=500, deadline=None, derandomize=True)
@given(positive, st.floats(min_value=0.0), st.floats(min_value=0.0), anything, anything, anything, positive)
@example(1.0, 1.0, 1e-310, 0.0, 0.0, 1.0, 1.0)
@example(1e-300, 0.0, 1.0, 1e300, 0.0, 1e300, 1.0)
@example(1.0, 1.0, 1.0, math.inf, 0.0, 0.0, 1.0)
@example(1.0, 0.0, 1e308, -1.7e308, 0.0, 1.0, 1.0)
def test_no_number_makes_the_motion_hang_or_raise(
    m: float, b: float, coulomb: float, force: float, x: float, v: float, t: float
) -> None:
    move(body_of(m, b, coulomb, x, v), force, t)


@pytest.mark.parametrize("coulomb", [1e-12, 1e-100, 1e-310, 5e-324])
@pytest.mark.parametrize("b", [0.0, 1.0, 1e9])
def test_dry_friction_of_almost_nothing_leaves_the_motion_a_number(coulomb: float, b: float) -> None:
    body, freed = body_of(1.0, b, coulomb, 0.25, 1.0), body_of(1.0, b, 0.0, 0.25, 1.0)
    move(body, 0.0, 1.0)
    move(freed, 0.0, 1.0)
    np.testing.assert_allclose(state_of(body), state_of(freed), rtol=1e-11, atol=1e-11)


# On a spring. The reference is the exponential of the matrix of m x'' + b x' + k x = F, for which no regime is special.


def passage(m: float, b: float, k: float, t: mp.mpf) -> mp.matrix:
    """The matrix by which (position, velocity, area, force) become what they are `t` later."""
    m, b, k, t = map(mp.mpf, (m, b, k, t))
    motion = mp.matrix([[0, t, 0, 0], [-k / m * t, -b / m * t, 0, t / m], [t, 0, 0, 0], [0, 0, 0, 0]])
    halvings = max(0, int(mp.ceil(mp.log(mp.mnorm(motion, 1) + 1, 2))))  # until mpmath can raise it to powers
    step = mp.expm(motion / 2**halvings)
    for _ in range(halvings):
        step = step * step
    return step


def exactly_on_spring(m: float, b: float, k: float, force: float, x: float, v: float, t: float) -> np.ndarray:
    with mp.workdps(80):  # forty, and what the squarings of a stiff matrix lose
        end = passage(m, b, k, mp.mpf(t)) * mp.matrix([x, v, 0, force])
        return np.array([float(value) for value in end[:3]])


def spring_sizes(m: float, b: float, k: float, force: float, x: float, v: float, t: float) -> np.ndarray:
    """The size of what position, velocity and area are made of, and how far rounding k, m and t turns a swing."""
    frequency = math.sqrt(k / m)
    v_travel = min(t, m / b if b > 0 else math.inf, 1 / frequency if k > 0 else math.inf)
    a_travel = min(t * v_travel, 2 * m / k if k > 0 else math.inf)
    push = abs(force) / m + k / m * abs(x)
    place = abs(x) + abs(v) * v_travel + push * a_travel
    turned = 1 + frequency * t * math.exp(-b * t / m / 2)
    return turned * np.array([place, abs(v) + push * v_travel, t * place])


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


@settings(max_examples=300, deadline=None, derandomize=True)
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


stiffnesses = decades(-9, 6)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(masses, frictions, stiffnesses, forces, positions, velocities, decades(-9, 1))
def test_on_a_spring_all_is_exact_whatever_the_body(
    m: float, b: float, k: float, force: float, x: float, v: float, t: float
) -> None:
    body = body_of(m, b, position=x, velocity=v, stiffness=k)
    move(body, force, t)
    difference = np.abs(state_of(body) - exactly_on_spring(m, b, k, force, x, v, t))
    assert (difference <= ROUNDING * spring_sizes(m, b, k, force, x, v, t)).all()


@settings(max_examples=300, deadline=None, derandomize=True)
@given(masses, frictions, stiffnesses, forces, positions, velocities, decades(-9, 2), st.floats(0.0, 1.0))
def test_on_a_spring_two_intervals_are_as_good_as_one(
    m: float, b: float, k: float, force: float, x: float, v: float, t: float, cut: float
) -> None:
    whole, parts = (body_of(m, b, position=x, velocity=v, stiffness=k) for _ in range(2))
    move(whole, force, t)
    move(parts, force, cut * t)
    move(parts, force, t - cut * t)
    assert (np.abs(state_of(whole) - state_of(parts)) <= 10 * ROUNDING * spring_sizes(m, b, k, force, x, v, t)).all()


def energy_of(body: np.record) -> float:
    return float(body["mass"] * body["velocity"] ** 2 + body["stiffness"] * body["position"] ** 2) / 2


@settings(max_examples=300, deadline=None, derandomize=True)
@given(masses, frictions, st.one_of(st.just(0.0), decades(-3, 2)), stiffnesses, positions, velocities, decades(-9, 2))
def test_on_a_spring_the_energy_never_grows_without_a_force(
    m: float, b: float, coulomb: float, k: float, x: float, v: float, t: float
) -> None:
    body = body_of(m, b, coulomb, x, v, k)
    for _ in range(4):
        before = energy_of(body)
        move(body, 0.0, t)
        assert energy_of(body) <= before * (1 + 1e-13)


@pytest.mark.parametrize("phase", PHASES)
def test_without_any_friction_a_spring_keeps_the_energy(phase: float) -> None:
    body = body_of(0.3, position=0.02, velocity=-1.1, stiffness=0.3 * phase**2)
    begun = energy_of(body)
    for _ in range(100):
        move(body, 0.0, 1.0)
    assert energy_of(body) == pytest.approx(begun, rel=1e-13)


@settings(max_examples=300, deadline=None, derandomize=True)
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


def test_an_interval_of_no_length_changes_nothing_on_a_spring() -> None:
    for coulomb in (0.0, 1.0):
        body = body_of(0.2, 3.0, coulomb, 0.1, -0.3, 500.0)
        move(body, 5.0, 0.0)
        assert state_of(body).tolist() == [0.1, -0.3, 0.0]


# On a spring, with Coulomb friction.


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


@settings(max_examples=300, deadline=None, derandomize=True)
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


@settings(max_examples=500, deadline=None, derandomize=True)
@given(positive, st.floats(min_value=0.0), positive, st.floats(min_value=0.0), anything, anything, anything, positive)
@example(1.0, 0.0, 1.0, 1e-310, 0.0, 1.0, 0.0, 1e300)
@example(1e-300, 1.0, 1.0, 1.0, 1e300, 0.0, 1e300, 1.0)
@example(1.0, 0.0, 1e300, 1e-9, 0.0, 1.0, 1.0, 1e9)
@example(1.0, 2.0, 1.0, 1e-9, 1.0, 1.0, 0.0, 1.0)
def test_no_number_makes_the_motion_on_a_spring_hang_or_raise(
    m: float, b: float, k: float, coulomb: float, force: float, x: float, v: float, t: float
) -> None:
    natives()  # compiled before the time is taken
    begun = perf_counter()
    move(body_of(m, b, coulomb, x, v, k), force, t)
    assert perf_counter() - begun < 1.0


@pytest.mark.parametrize("coulomb", [1e-14, 1e-100, 5e-324])
def test_dry_friction_of_almost_nothing_hardly_slows_thousands_of_swings_within_one_interval(coulomb: float) -> None:
    body, freed = body_of(1.0, 0.0, coulomb, 0.25, 1.0, 4.0), body_of(1.0, 0.0, 0.0, 0.25, 1.0, 4.0)
    move(body, 0.0, 2e3)
    move(freed, 0.0, 2e3)
    np.testing.assert_allclose(state_of(body), state_of(freed), rtol=0, atol=1e-9)


# Several bodies in one device.


@settings(max_examples=300, deadline=None, derandomize=True)
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
def test_what_moves_beside_it_makes_no_difference_to_a_body(
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
