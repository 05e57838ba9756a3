"""The mock's mass in continuous time, against the closed form in mpmath, and under Coulomb friction also against an
independent solver."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from hapsim.device.mock.motion import strike

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
    positions,
    positive,
    sizes,
    state_of,
    stiffnesses,
    times,
    velocities,
)


@pytest.mark.parametrize("friction", [0.0, 1e-9, 1e-3, 0.0999, 0.1, 0.1001, 1.0, 30.0, 1e4, 1e9])
@pytest.mark.parametrize("t", [1e-9, 1e-4, 1e-3, 0.99, 1.0, 1.01, 50.0])
def test_position_velocity_and_area_are_exact_for_every_friction_and_interval(friction: float, t: float) -> None:
    m, force, x, v = 0.1, -1.7, 0.03, 0.4
    body = body_of(m, friction, position=x, velocity=v)
    move(body, force, t)
    difference = np.abs(state_of(body) - exactly(m, friction, force, x, v, t))
    assert (difference <= ROUNDING * sizes(m, friction, force, x, v, t)).all()


@settings(max_examples=100, deadline=None, derandomize=True)
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


@settings(max_examples=80, deadline=None, derandomize=True)
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


@settings(max_examples=80, deadline=None, derandomize=True)
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


@settings(max_examples=80, deadline=None, derandomize=True)
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


@settings(max_examples=100, deadline=None, derandomize=True)
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


@settings(max_examples=150, deadline=None, derandomize=True)
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
