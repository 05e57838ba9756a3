"""Dampers, the device's own spring, and free motions in a scene: against polynomials and motions worked out by hand."""

from __future__ import annotations

import itertools
import math

import mpmath
import numpy as np
import pytest

from hapsim.theory import Network
from hapsim.theory.interface import damper_named
from hapsim.theory.network import solve
from tests.transitions import transition

RATE = 1000.0
CUTOFF = 90.0
EACH = [("backward", None), ("centred", None), ("filtered", CUTOFF), ("sensed", None)]


def hand(K: float, B: float, damper: tuple[str, float | None] = ("backward", None), **changed: object) -> Network:
    """One hand of 0.3 kg on one spring, without friction and delay."""
    arguments: dict[str, object] = {
        "rate": RATE,
        "channel_mass": [0.3],
        "channel_friction": [0.0],
        "delay": 0.0,
        "hold": "impulse",
        "sampling": "ideal",
        "point_mass": [],
        "ends": [[0, -1]],
        "stiffness": [K],
        "damping": [B],
        "damper": [damper_named(*damper, RATE)],
    }
    return Network(**(arguments | changed))  # type: ignore[arg-type]


def simulated(K: float, B: float, damper: tuple[str, float | None]) -> Network:
    """One simulated mass of 0.3 kg on one spring: the centred scheme, no device."""
    nothing = {"channel_mass": [], "channel_friction": [], "point_mass": [0.3]}
    return hand(K, B, damper, **nothing)


def same(found: np.ndarray, expected: np.ndarray, atol: float = 1e-9) -> None:
    """The same numbers, whatever their order, and besides them only poles at zero."""
    left = list(found)
    for pole in expected:
        nearest = int(np.argmin(np.abs(np.array(left) - pole)))
        assert abs(left.pop(nearest) - pole) < atol
    assert np.abs(left).max(initial=0.0) < 1e-5


class TestASimulatedMass:
    """z² - 2 z + 1 = -z (kappa + beta v(z)), multiplied out by hand for each damper's v."""

    kappa, beta = 0.07, 0.4

    def poles(self, damper: tuple[str, float | None]) -> np.ndarray:
        unit = 0.3 * RATE**2
        return solve(simulated(self.kappa * unit, self.beta * unit / RATE, damper)).poles

    @pytest.mark.parametrize("name", ["backward", "sensed"])
    def test_backward_and_where_nothing_is_to_be_sensed(self, name: str) -> None:
        same(self.poles((name, None)), np.roots([1.0, self.kappa + self.beta - 2.0, 1.0 - self.beta]))

    def test_centred(self) -> None:
        # v = (1 - z^-2)/2: z³ - 2 z² + z + kappa z² + beta (z² - 1)/2
        same(self.poles(("centred", None)), np.roots([1.0, self.kappa + self.beta / 2.0 - 2.0, 1.0, -self.beta / 2.0]))

    def test_filtered(self) -> None:
        # v = a (1 - 1/z)/(1 - (1 - a)/z): (z² - 2 z + 1 + kappa z)(z - 1 + a) + beta a z (z - 1)
        a = 1.0 - math.exp(-2.0 * math.pi * CUTOFF / RATE)
        free = np.polymul([1.0, self.kappa - 2.0, 1.0], [1.0, a - 1.0])
        same(self.poles(("filtered", CUTOFF)), np.roots(np.polyadd(free, self.beta * a * np.array([1.0, -1.0, 0.0]))))


@pytest.mark.parametrize("damper", EACH)
def test_a_state_carries_what_the_damper_needs_and_nothing_more(damper: tuple[str, float | None]) -> None:
    more = {"backward": 0, "centred": 1, "filtered": 1, "sensed": 0}[damper[0]]
    assert transition(hand(100.0, 1.0, damper)).shape == (3 + more, 3 + more)
    assert transition(hand(100.0, 0.0, damper)).shape == (3, 3)
    averaged = transition(hand(100.0, 1.0, damper, sampling="average"))
    assert len(averaged) == 4 + max(more, int(damper[0] == "sensed"))


@pytest.mark.parametrize("damper", EACH)
def test_a_mass_moves_as_its_recurrence_does(damper: tuple[str, float | None]) -> None:
    """The recurrence as a kernel runs it, link by link, beside the powers of the transition."""
    K, B, unit = np.array([900.0, 2000.0]), np.array([3.0, 1.0]), 0.02 * RATE**2
    made = damper_named(*damper, RATE)
    network = Network(RATE, [], [], 1.0, "zoh", "ideal", [0.02, 0.02], [[0, 1], [-1, 1]], K, B, damper=[made, made])
    x = [np.zeros(2), np.zeros(2), np.array([1e-3, -2e-3])]
    past = np.zeros(2)
    state = np.zeros(len(transition(network)))
    state[:2] = state[2:4] = x[-1]  # positions, and steps
    for _ in range(40):
        y = [np.array([now[0] - now[1], -now[1]]) for now in x[:-4:-1]]
        v = sum(p * back for p, back in zip(made.of_positions, y, strict=False))
        v = v + sum(q * past for q in made.of_velocities)
        past = v
        pull = K * y[0] + B * RATE * v
        x.append(2.0 * x[-1] - x[-2] + np.array([-pull[0], pull[0] + pull[1]]) / unit)
        state = transition(network) @ state
        np.testing.assert_allclose(state[:2], x[-1], atol=1e-15)


class TestTheSensedVelocity:
    """Poles against an exact exponential of fifty digits."""

    def transition(self, sampling: str, b0: float, k0: float, K: float, B: float) -> mpmath.matrix:
        """The zero-order hold without delay, state (position, velocity) at a sample, the reading beside them."""
        with mpmath.workdps(50):
            rows = [[0, 1, 0, 0], [-k0 / 0.3, -b0 / 0.3, 1 / mpmath.mpf(0.3), 0], [0, 0, 0, 0], [1, 0, 0, 0]]
            flow = mpmath.expm(mpmath.matrix(rows) / RATE, method="taylor")
            if sampling == "ideal":
                pull = [-K, -B]
                return mpmath.matrix([[flow[i, j] + flow[i, 2] * pull[j] for j in (0, 1)] for i in (0, 1)])
            # state: position, velocity, mean position, mean velocity; the force from the last two
            force = [0, 0, -K, -B]
            step = mpmath.zeros(4)
            for j in range(4):
                own = [flow[i, j] if j < 2 else 0 for i in (0, 1, 3)]
                step[0, j] = own[0] + flow[0, 2] * force[j]
                step[1, j] = own[1] + flow[1, 2] * force[j]
                step[2, j] = RATE * (own[2] + flow[3, 2] * force[j])
                step[3, j] = RATE * (step[0, j] - (1 if j == 0 else 0))
            return step

    @pytest.mark.parametrize(("b0", "k0"), [(0.0, 0.0), (3.0, 0.0), (0.5, 800.0), (0.0, 9e5)])
    @pytest.mark.parametrize("sampling", ["ideal", "average"])
    def test_as_the_device_reads_it(self, sampling: str, b0: float, k0: float) -> None:
        K, B = 4000.0, 20.0
        network = hand(
            K, B, ("sensed", None), hold="zoh", sampling=sampling, channel_friction=[b0], channel_stiffness=[k0]
        )
        with mpmath.workdps(50):
            exact = mpmath.eig(self.transition(sampling, b0, k0, K, B), right=False)
        # A pole at 1 is where the reading and its state agree by structure only; it is double, and half as sure.
        same(solve(network).poles, np.array([complex(pole) for pole in exact if abs(pole) > 1e-9]), 1e-9)

    def test_an_impulse_is_not_sensed_before_the_next_sample(self) -> None:
        """x+ = x + u, u the velocity after the impulse; u+ = u, sensed before it: z² poles by hand."""
        kappa, beta, unit = 0.05, 0.3, 0.3 * RATE**2
        network = hand(kappa * unit, beta * unit / RATE, ("sensed", None))
        # u = v - kappa x - beta v; x+ = x + u, v+ = u
        by_hand = np.array([[1.0 - kappa, 1.0 - beta], [-kappa, 1.0 - beta]])
        same(solve(network).poles, np.linalg.eigvals(by_hand))


def test_a_devices_own_spring_is_table_1_v_of_the_paper() -> None:
    """cos(wT) = cos(w0 T) - K T sin(w0 T)/(2 m w0): impulse hold, no delay, no friction."""
    for k0, K in itertools.product((10.0, 5000.0, 4e5), (100.0, 3e4, 2e5)):
        w0 = math.sqrt(k0 / 0.3)
        cosine = math.cos(w0 / RATE) - K / RATE * math.sin(w0 / RATE) / (2.0 * 0.3 * w0)
        found = solve(hand(K, 0.0, channel_stiffness=[k0])).poles[:2]
        np.testing.assert_allclose(found.sum() / 2.0, cosine, atol=1e-12)
        np.testing.assert_allclose(np.prod(found), 1.0, atol=1e-12)


def test_springs_in_the_device_and_across_it_are_two_things() -> None:
    """Real springs add where nothing is simulated; the loop's spring is late."""
    alone = Network(RATE, [0.3], [0.0], 1.0, "zoh", "ideal", [], [], [], [], channel_stiffness=[700.0])
    solution = solve(alone)
    np.testing.assert_allclose(np.abs(np.angle(solution.poles[:2])), math.sqrt(700.0 / 0.3) / RATE, rtol=1e-12)
    assert solution.spectral_radius == pytest.approx(1.0, abs=1e-12)
    assert solve(hand(700.0, 0.0, delay=1.0, hold="zoh")).spectral_radius > 1.0 + 1e-6


class TestFreeMotions:
    def test_a_drifting_pair_of_masses_has_a_double_pole_at_1_exactly(self) -> None:
        network = Network(RATE, [], [], 1.0, "zoh", "ideal", [0.1, 0.2], [[0, 1]], [500.0], [1.0])
        solution = solve(network)
        assert (solution.poles[:2] == 1.0).all()
        assert solution.spectral_radius == 1.0
        assert not solution.is_stable

    def test_what_is_braked_rests_but_does_not_drift(self) -> None:
        network = Network(RATE, [0.2], [1.0], 1.0, "zoh", "ideal", [0.1], [[0, 1]], [500.0], [1.0])
        poles = solve(network).poles
        assert poles[0] == 1.0
        assert abs(poles[1] - 1.0) > 1e-4

    def test_a_ground_or_a_devices_spring_ends_it(self) -> None:
        grounded = Network(RATE, [], [], 1.0, "zoh", "ideal", [0.1, 0.2], [[0, 1], [1, -1]], [500.0] * 2, [1.0] * 2)
        assert solve(grounded).is_stable
        sprung = Network(
            RATE, [0.2], [1.0], 1.0, "zoh", "ideal", [0.1], [[0, 1]], [500.0], [1.0], channel_stiffness=[300.0]
        )
        assert solve(sprung).is_stable
