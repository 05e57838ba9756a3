"""The state predictor: with its own mass the loop has no delay, and with another one what the polynomial says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hapsim.theory import Configuration
from hapsim.theory.correction import PredictedLoop, state_predictor, white_noise_gain

DEVICE = Configuration(mass=0.2, rate=1000.0)
K, B = np.array([0.0, 300.0, 3000.0, 40000.0]), np.array([1.0, 0.0, 20.0, 90.0])


@pytest.mark.thorough(keep=40)
@pytest.mark.parametrize("senses", [False, True])
@pytest.mark.parametrize("sampling", ["ideal", "average"])
@pytest.mark.parametrize("hold", ["zoh", "impulse"])
@pytest.mark.parametrize("delay", [0.0, 0.37, 1.0, 2.5, 3.0])
@pytest.mark.parametrize(("friction", "stiffness"), [(0.0, 0.0), (3.0, 0.0), (2.0, 500.0)])
def test_the_loop_of_its_own_mass_is_that_of_a_sensed_velocity_without_delay(
    senses: bool, sampling: str, hold: str, delay: float, friction: float, stiffness: float
) -> None:
    """And of an observer, whose poles nothing else moves."""
    device = replace(DEVICE, hold=hold, sampling=sampling, delay=delay, friction=friction, stiffness=stiffness)
    loop = PredictedLoop(device, state_predictor(device, senses), static=K + 1.0)
    wanted = replace(device, delay=0.0, sampling="ideal", damper="sensed")
    poles = loop.poles(K, B)
    np.testing.assert_allclose(poles[:, :2], wanted.poles(K, B)[:, :2], rtol=0.0, atol=1e-9)
    if sampling == "ideal" or not senses:
        observer = 1 if senses else 2
        np.testing.assert_allclose(poles[:, 2 : 2 + observer], 0.5, rtol=0.0, atol=1e-6)
        assert np.abs(poles[:, 2 + observer :]).max(initial=0.0) < 2e-3  # zeros, as many at once as forces are kept
    assert np.abs(poles[:, 2:]).max() < 0.6
    k, b = loop.equivalent(K, B)
    expected = wanted.equivalent(K, B)
    for found, felt in zip((k, b), expected, strict=True):
        np.testing.assert_allclose(found, felt, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("senses", [False, True])
@pytest.mark.parametrize("device", [{}, {"delay": 2.4, "sampling": "average"}, {"hold": "impulse", "friction": 4.0}])
@pytest.mark.parametrize("own", [0.0, 700.0])
def test_a_steady_push_meets_the_stiffness_that_it_is_to_meet(senses: bool, device: dict[str, Any], own: float) -> None:
    """Whatever the mass is."""
    model = replace(DEVICE, stiffness=own, **device)
    if senses and model.hold == "impulse":
        return  # between two impulses it is never at rest: the velocity that is read is none of a steady push
    for pole in (0.5, 0.25, 0.0):
        predictor = state_predictor(model, senses, pole)
        for true in (model, replace(model, mass=0.3)):
            assert PredictedLoop(true, predictor, 5000.0).steady_stiffness(4700.0, 20.0) == pytest.approx(5000.0)
            if model.hold == "zoh":
                compliance = (5000.0 / 4700.0 - 1.0) / (5000.0 + own)
                yielding = PredictedLoop(true, predictor.for_compliance(compliance))
                assert yielding.steady_stiffness(4700.0, 20.0) == pytest.approx(5000.0)
                assert PredictedLoop(true, predictor).steady_stiffness(4700.0, 20.0) == pytest.approx(4700.0)


@pytest.mark.parametrize(("factor", "pole"), [(0.5, 0.5), (0.9, 0.25), (1.1, 0.0), (2.0, 0.5)])
@pytest.mark.parametrize("delay", [0.37, 1.0, 2.0])
def test_another_mass_moves_as_its_own_recurrence_predicts(delay: float, factor: float, pole: float) -> None:
    """The loop written out sample by sample: a double integrator under held forces, and its observer by hand."""
    true = replace(DEVICE, mass=factor * DEVICE.mass, delay=delay)
    predictor = state_predictor(replace(DEVICE, delay=delay), pole=pole)
    stiffness, damping, static = 3000.0, 20.0, 3300.0
    poles = PredictedLoop(true, predictor, static).poles(stiffness, damping)
    period, whole, fraction = 1e-3, int(delay), delay % 1.0
    of_velocity, of_push = 0.5 * (1.0 - pole) * (3.0 + pole), (1.0 - pole) ** 2

    def moved(x: float, v: float, parts: list[tuple[float, float]], push: float, mass: float) -> tuple[float, float]:
        for force, t in parts:
            a = (force + push) / mass
            x, v = x + v * t + 0.5 * a * t * t, v + a * t
        return x, v

    positions, speed, forces = [1e-3], 0.3, [0.0] * 6
    x, v, push = 1e-3, 0.0, 0.0
    for _ in range(400):
        ahead = []
        for later in range(whole):  # whole periods, and what follows until f[n] acts
            newer, older = forces[later - whole], forces[later - 1 - whole]
            ahead += [(older, fraction * period), (newer, (1.0 - fraction) * period)]
        there, speed_there = moved(x, v, [*ahead, (forces[-1], fraction * period)], push, DEVICE.mass)
        forces.append(-stiffness * there - damping * speed_there - (static - stiffness) / static * push)
        acting = [(forces[-2 - whole], fraction * period), (forces[-1 - whole], (1.0 - fraction) * period)]
        position, speed = moved(positions[-1], speed, acting, 0.0, true.mass)
        positions.append(position)
        expected, v = moved(x, v, acting, push, DEVICE.mass)
        x, off = position, position - expected
        v, push = v + of_velocity * off / period, push + of_push * DEVICE.mass * off / period**2
    # The motion obeys the recurrence whose roots the poles are, once the start is forgotten.
    polynomial = np.real(np.poly(poles))
    seen = np.convolve(positions[50:], polynomial, mode="valid")
    size = np.convolve(np.abs(positions[50:]), np.abs(polynomial), mode="valid")
    assert (np.abs(seen) < 1e-9 * size).all()


def test_the_noise_of_a_loop_that_forgets_nothing_is_unknown() -> None:
    assert np.isnan(white_noise_gain(np.zeros((1, 1)), np.zeros(1), np.ones(1)))
    assert white_noise_gain(-np.eye(1), np.ones(1), np.zeros(1)) == 1.0
