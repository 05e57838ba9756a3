"""Dampers, the device's own spring, and free motions in a scene: against polynomials and motions worked out by hand."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from hapsim.theory import Network
from hapsim.theory.interface import damper_named
from hapsim.theory.network import solve
from tests.networks import network_of
from tests.transitions import transition

RATE = 1000.0
CUTOFF = 90.0
EACH = [("backward", None), ("centred", None), ("filtered", CUTOFF), ("sensed", None)]


def hand(K: float, B: float, damper: tuple[str, float | None] = ("backward", None), **changed: object) -> Network:
    """One hand of 0.3 kg on one spring, without friction and delay."""
    own = {"channel_mass": [0.3], "channel_friction": [0.0], "delay": 0.0, "hold": "impulse"}
    link = {"stiffness": [K], "damping": [B], "damper": [damper_named(*damper, RATE)]}
    return network_of(**own | link | changed)


@pytest.mark.parametrize("damper", EACH)
def test_a_state_carries_what_the_damper_needs_and_nothing_more(damper: tuple[str, float | None]) -> None:
    more = {"backward": 0, "centred": 1, "filtered": 1, "sensed": 0}[damper[0]]
    assert transition(hand(100.0, 1.0, damper)).shape == (3 + more, 3 + more)
    assert transition(hand(100.0, 0.0, damper)).shape == (3, 3)
    averaged = transition(hand(100.0, 1.0, damper, sampling="average"))
    assert len(averaged) == 4 + max(more, int(damper[0] == "sensed"))


def test_an_impulse_is_not_sensed_before_the_next_sample() -> None:
    """x+ = x + u, u the velocity after the impulse; u+ = u, sensed before it: z² poles by hand."""
    kappa, beta, unit = 0.05, 0.3, 0.3 * RATE**2
    left = solve(hand(kappa * unit, beta * unit / RATE, ("sensed", None))).poles
    # u = v - kappa x - beta v; x+ = x + u, v+ = u
    for pole in np.linalg.eigvals(np.array([[1.0 - kappa, 1.0 - beta], [-kappa, 1.0 - beta]])):
        assert np.abs(left - pole).min() < 1e-9
        left = np.delete(left, np.argmin(np.abs(left - pole)))
    assert np.abs(left).max() < 1e-5


def test_a_devices_own_spring_is_table_1_v_of_the_paper() -> None:
    """cos(wT) = cos(w0 T) - K T sin(w0 T)/(2 m w0): impulse hold, no delay, no friction."""
    for k0, K in itertools.product((10.0, 5000.0, 4e5), (100.0, 3e4, 2e5)):
        w0 = math.sqrt(k0 / 0.3)
        cosine = math.cos(w0 / RATE) - K / RATE * math.sin(w0 / RATE) / (2.0 * 0.3 * w0)
        found = solve(hand(K, 0.0, channel_stiffness=[k0])).poles[:2]
        np.testing.assert_allclose(found.sum() / 2.0, cosine, atol=1e-12)
        np.testing.assert_allclose(np.prod(found), 1.0, atol=1e-12)
