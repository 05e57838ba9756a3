"""The results that can be had by hand, the paper's first: each as a formula, none by the code's own road."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.theory import Configuration, Network, frequency_and_ratio
from hapsim.theory.network import solve

MASS, RATE = 0.2, 1000.0
T = 1.0 / RATE
STIFFNESS_UNIT, DAMPING_UNIT = MASS / T**2, MASS / T

IDEAL_INTERFACE = {"hold": "impulse", "sampling": "ideal", "delay": 0.0}  # the paper's §6.1


def configuration(**changed: object) -> Configuration:
    return Configuration(**({"mass": MASS, "rate": RATE} | changed))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


class TestThePapersEquations:
    """§6.1 to §6.3 in the paper's units, m = 1 and T = 1."""

    def characteristic(self, rng: np.random.Generator, delay: float, b0: float, r: np.ndarray) -> None:
        c = Configuration(mass=1.0, rate=1.0, friction=b0, delay=delay, hold="impulse", sampling="ideal")
        p, q = np.array([1.0, 0.0]), np.array([1.0, -1.0])
        for K, B in rng.uniform(-1.0, 4.0, (20, 2)):
            paper = np.polyadd(np.polyadd(K * p, B * q), r)
            np.testing.assert_allclose(c.characteristic(K, B), paper / paper[0], rtol=1e-14, atol=1e-15)
            np.testing.assert_allclose(np.polyval(paper / paper[0], c.poles(K, B)), 0.0, atol=1e-12)

    def test_without_delay_p_q_r_are_those_of_6_1(self, rng: np.random.Generator) -> None:
        self.characteristic(rng, 0.0, 0.0, np.array([1.0, -2.0, 1.0]))

    def test_with_one_sample_of_delay_p_q_r_are_those_of_6_2(self, rng: np.random.Generator) -> None:
        self.characteristic(rng, 1.0, 0.0, np.array([1.0, -2.0, 1.0, 0.0]))

    @pytest.mark.parametrize("b0", [1e-6, 0.5, 3.0])
    def test_with_real_damping_p_q_r_are_those_of_6_3(self, rng: np.random.Generator, b0: float) -> None:
        free = np.polymul([1.0, -1.0, 0.0], [1.0, -np.exp(-b0)])
        self.characteristic(rng, 1.0, b0, free * b0 / -np.expm1(-b0))


class TestTheIdealInterface:
    """§6.1: no delay, impulses, no friction."""

    def test_a_simulated_mass_is_the_same_oscillator(self) -> None:
        """ "The sampled image of the real mass is identical to a virtual mass element" (§6.1)."""
        K, B = 0.7 * STIFFNESS_UNIT, 0.2 * DAMPING_UNIT
        virtual = Network(RATE, [], [], 0.0, "impulse", "ideal", [MASS], [[0, -1]], [K], [B])
        np.testing.assert_allclose(solve(virtual).poles, configuration(**IDEAL_INTERFACE).poles(K, B), rtol=1e-12)


class TestTheRealOscillator:
    def test_frequency_and_ratio_are_those_of_the_textbook(self) -> None:
        frequency, ratio = frequency_and_ratio(0.5, [50.0, 200.0], [[0.0], [20.0]])
        np.testing.assert_allclose(frequency, np.tile(np.array([10.0, 20.0]) / (2.0 * np.pi), (2, 1)))
        np.testing.assert_allclose(ratio, [[0.0, 0.0], [2.0, 1.0]])

    def test_without_a_spring_there_is_no_ratio(self) -> None:
        frequency, ratio = frequency_and_ratio(1.0, [0.0, -1.0], 1.0)
        assert frequency[0] == 0.0
        assert np.isnan(ratio).all()
        assert np.isnan(frequency[1])
