"""Against a simulation that knows no transform: a mass that coasts exactly from one event to the next.

The events are the samples, every period, and the forces, each a delay after its sample. Between them the mass
moves by the solution of m x'' + b0 x' = F, written out.
"""

from __future__ import annotations

import heapq
import itertools

import mpmath as mp
import numpy as np
import pytest

from hapsim.theory import Network
from hapsim.theory.sample import loop
from tests.coasting import Coasting

SAMPLE, FORCE = 0, 1  # at one instant the position is read first
CASES = list(itertools.product(("zoh", "impulse"), ("ideal", "average"), (0.0, 0.37, 1.0, 1.5, 2.0), (0.0, 1.5)))


def run(network: Network, samples: int, x0: list[float], v0: list[float]) -> np.ndarray:
    """x[n] (samples, C + M) as the computer sees it, from x[-1] = x[0] and no force on its way."""
    T = 1 / mp.mpf(network.rate)
    channels = len(network.channel_mass)
    masses = [
        Coasting(mp.mpf(m), mp.mpf(b), mp.mpf(x), mp.mpf(v))
        for m, b, x, v in zip(network.channel_mass, network.channel_friction, x0, v0, strict=False)
    ]
    before = now = [mp.mpf(x) for x in x0]
    pushed: list[mp.mpf] = []  # the simulated masses' next positions
    seen: list[list[mp.mpf]] = []
    queue = [(mp.mpf(0), SAMPLE, 0, [])]
    clock = mp.mpf(0)
    while len(seen) < samples:
        at, kind, n, forces = heapq.heappop(queue)
        for mass in masses:
            mass.coast((at - clock) * T)
        clock = at
        if kind == FORCE:
            for mass, f in zip(masses, forces, strict=True):
                if network.hold == "zoh":
                    mass.force = f
                else:
                    mass.v += f * T / mass.m
            continue
        if n > 0:
            read = [mass.x if network.sampling == "ideal" else mass.travel / T for mass in masses]
            before, now = now, read + pushed
        for mass in masses:
            mass.travel = mp.mpf(0)
        seen.append(now)
        total = link_forces(network, T, now, before)
        pushed = [
            2 * now[i] - before[i] + T**2 / mp.mpf(m) * total[i]
            for i, m in enumerate(network.point_mass, start=channels)
        ]
        heapq.heappush(queue, (at + mp.mpf(network.delay), FORCE, n, total[:channels]))
        heapq.heappush(queue, (at + 1, SAMPLE, n + 1, []))
    return np.array(seen, dtype=float)


def link_forces(network: Network, T: mp.mpf, now: list[mp.mpf], before: list[mp.mpf]) -> list[mp.mpf]:
    total = [mp.mpf(0)] * len(now)
    now, before = [*now, mp.mpf(0)], [*before, mp.mpf(0)]  # index -1 is the ground
    for (a, b), K, B in zip(network.ends, network.stiffness, network.damping, strict=True):
        f = -mp.mpf(K) * (now[a] - now[b]) - mp.mpf(B) / T * (now[a] - now[b] - before[a] + before[b])
        for end, sign in ((a, 1), (b, -1)):
            if end >= 0:
                total[end] += sign * f
    return total


@pytest.mark.thorough(keep=14)
@pytest.mark.parametrize(("hold", "sampling", "delay", "friction"), CASES)
def test_a_network_moves_as_its_transition_matrix_predicts(
    hold: str, sampling: str, delay: float, friction: float
) -> None:
    network = Network(
        rate=2000.0,
        channel_mass=[0.2, 0.05],
        channel_friction=[friction, 0.3],
        delay=delay,
        hold=hold,
        sampling=sampling,
        point_mass=[0.03, 0.01],
        ends=[[0, 2], [2, 3], [3, 1], [2, -1], [1, 0]],
        stiffness=[900.0, 400.0, 700.0, 150.0, 60.0],
        damping=[0.4, 0.1, 0.2, 0.0, 0.3],
    )
    x0, v0 = [0.01, -0.02, 0.005, 0.0], [0.3, -0.1]
    with mp.workdps(30):
        expected = run(network, 60, x0, v0)

    change, points, *_ = loop(network)
    state = np.zeros(len(change))
    state[:4] = x0
    state[4:6] = np.array(v0) / network.rate
    for row in expected:
        np.testing.assert_allclose(points @ state, row, atol=1e-13)
        state = state + change @ state
