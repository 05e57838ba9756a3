"""The response of about one count that probe sees: the rounding of positions is no friction."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.bringup.probe.pushing import estimate

PERIOD, MASS, FRICTION, FORCE = 0.004, 2e-5, 1.75e-4, 1.5e-3  # s, kg·m², N·m·s/rad, N·m
SIDES = (1.0, -1.0, -1.0, 1.0)
AGES = (range(3), range(3, 6), range(6, 16))  # samples; a push lasts 6


@pytest.mark.parametrize("count", [1e-7, 1.5e-3, 2.6e-3])
def test_a_force_that_ended_has_no_response_however_coarse_the_positions(count: float) -> None:
    rng = np.random.default_rng(1)
    pushes = [(SIDES[i % 4], age) for i in range(96) for age in range(int(rng.integers(19, 23)))]
    kept = np.exp(-FRICTION / MASS * PERIOD)
    positions, angle, speed = {}, 0.0, 0.0
    for n, (side, age) in enumerate(pushes):
        positions[n] = float(np.floor(angle / count) * count)
        reached = side * FORCE * (age < 6) / FRICTION
        angle += reached * PERIOD + (speed - reached) * (1 - kept) * MASS / FRICTION
        speed = reached + (speed - reached) * kept

    def forces_of(n: int) -> list[float] | None:
        acting = [[side * FORCE * (age in part) for part in AGES] for side, age in pushes[max(n - 1, 0) : n + 1]]
        return [0.5 * (before + now) for before, now in zip(*acting, strict=True)] if n else None

    found = estimate(positions, forces_of)
    assert found is not None
    assert found.values == pytest.approx([PERIOD**2 / MASS, PERIOD**2 / MASS, 0.0], abs=0.08)
