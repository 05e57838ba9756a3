"""The state predictor: with its own mass the loop has no delay, and with another one what the polynomial says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hapsim.theory import Configuration
from hapsim.theory.correction import PredictedLoop, state_predictor

DEVICE = Configuration(mass=0.2, rate=1000.0)
K, B = np.array([0.0, 300.0, 3000.0, 40000.0]), np.array([1.0, 0.0, 20.0, 90.0])


@pytest.mark.parametrize("senses", [False, True])
@pytest.mark.parametrize("sampling", ["ideal", "average"])
@pytest.mark.parametrize("hold", ["zoh", "impulse"])
@pytest.mark.parametrize("delay", [0.0, 0.37, 1.0, 2.5, 3.0])
@pytest.mark.parametrize(("friction", "stiffness"), [(0.0, 0.0), (3.0, 0.0), (2.0, 500.0)])
def test_the_loop_of_its_own_mass_is_that_of_a_sensed_velocity_without_delay(
    senses: bool, sampling: str, hold: str, delay: float, friction: float, stiffness: float
) -> None:
    device = replace(DEVICE, hold=hold, sampling=sampling, delay=delay, friction=friction, stiffness=stiffness)
    loop = PredictedLoop(device, state_predictor(device, senses))
    wanted = replace(device, delay=0.0, sampling="ideal", damper="sensed")
    poles = loop.poles(K, B)
    np.testing.assert_allclose(poles[:, :2], wanted.poles(K, B)[:, :2], rtol=0.0, atol=1e-9)
    assert np.abs(poles[:, 2:]).max(initial=0.0) < 2e-3  # zeros, as many at once as forces are remembered
    k, b = loop.equivalent(K, B)
    expected = wanted.equivalent(K, B)
    for found, felt in zip((k, b), expected, strict=True):
        np.testing.assert_allclose(found, felt, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("factor", [0.5, 0.9, 1.1, 2.0])
@pytest.mark.parametrize("delay", [0.37, 1.0, 2.0])
def test_another_mass_moves_as_its_own_recurrence_says(delay: float, factor: float) -> None:
    """The loop written out sample by sample: a double integrator under held forces, and the predictor's line."""
    true = replace(DEVICE, mass=factor * DEVICE.mass, delay=delay)
    predictor = state_predictor(replace(DEVICE, delay=delay))
    stiffness, damping = 3000.0, 20.0
    poles = PredictedLoop(true, predictor).poles(stiffness, damping)
    period, whole, fraction = 1e-3, int(delay), delay % 1.0
    positions, speed, forces = [0.0, 1e-3], 0.3, [0.0] * 6
    for _ in range(400):
        reading = np.array(positions[-1:-3:-1])
        state = predictor.readings @ reading + predictor.forces @ forces[-1 : -1 - predictor.lags : -1]
        forces.append(-stiffness * state[0] - damping * state[1])
        x = positions[-1]
        for force, share in ((forces[-2 - whole], fraction), (forces[-1 - whole], 1.0 - fraction)):
            t, a = share * period, force / true.mass
            x, speed = x + speed * t + 0.5 * a * t * t, speed + a * t
        positions.append(x)
    # The motion obeys the recurrence whose roots the poles are, once the start is forgotten.
    polynomial = np.real(np.poly(poles))
    seen = np.convolve(positions[50:], polynomial, mode="valid")
    size = np.convolve(np.abs(positions[50:]), np.abs(polynomial), mode="valid")
    assert (np.abs(seen) < 1e-9 * size).all()


def test_readings_alone_tell_position_and_velocity_of_a_free_mass() -> None:
    free = state_predictor(replace(DEVICE, delay=2.0))
    velocity, at = 0.25, 0.01
    state = free.readings @ [at, at - velocity * 1e-3] + free.forces @ np.zeros(free.lags)
    np.testing.assert_allclose(state, [at + 2e-3 * velocity, velocity], rtol=1e-12)
