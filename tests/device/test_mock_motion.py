"""The mock's mass in continuous time, against the solution written out in mpmath and against an independent solver.

A difference of rounding is measured against what the terms of a result are made of: |x|, |v| t, |F| t²/m.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from hapsim.device.mock.motion import BODY, move, strike

ROUNDING = 1e-14


def body_of(
    mass: float, friction: float = 0.0, coulomb: float = 0.0, position: float = 0.0, velocity: float = 0.0
) -> np.void:
    body: np.void = np.array([(mass, friction, coulomb, position, velocity, 0.0)], BODY)[0:1].view(np.recarray)[0]
    return body


def state_of(body: np.void) -> np.ndarray:
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
