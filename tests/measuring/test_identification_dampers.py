"""Identification beside prediction, with every damper and with a spring in the device."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.holds import HOLDS
from hapsim.measuring.measure_trace import measure_trace
from hapsim.running import run
from hapsim.theory import Configuration
from hapsim.theory.interface import DAMPERS, SAMPLINGS, WITH_CUTOFF

sys.path.insert(0, str(Path(__file__).parent))
from scenes import one_spring

MASS, RATE, FRICTION = 0.2, 1000.0, 0.05
CUTOFFS = {name: 90.0 if name in WITH_CUTOFF else None for name in DAMPERS}
INTERFACES = list(itertools.product(HOLDS, SAMPLINGS, (0.0, 0.37, 1.0)))


def element_and_target(c: Configuration, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """(K, B, k, b) of an element that neither pushes away nor drives."""
    while True:
        frequency = RATE * 10.0 ** rng.uniform(-2.0, -0.5)
        k = c.stiffness + MASS * frequency**2
        b = 2.0 * 10.0 ** rng.uniform(-3.0, -0.2) * np.sqrt(k * MASS)
        K, B = c.simulated(k, b)
        if K >= 0.0 and B >= 0.0:
            return float(K), float(B), k, b


@pytest.mark.parametrize("spring", [0.0, 0.001, 0.02])
@pytest.mark.parametrize("damper", DAMPERS)
def test_what_is_measured_is_what_is_predicted(damper: str, spring: float, figures: Any) -> None:
    rng = np.random.default_rng([int(1e4 * spring), *map(ord, damper)])
    for hold, sampling, delay in INTERFACES:
        c = Configuration(
            mass=MASS,
            rate=RATE,
            friction=FRICTION,
            delay=delay,
            hold=hold,
            sampling=sampling,
            stiffness=spring * MASS * RATE**2,
            damper=damper,
            cutoff=CUTOFFS[damper],
        )
        K, B, k, b = element_and_target(c, rng)
        velocity = min(5e-4 * np.sqrt(k / MASS), 1.0)
        scene = one_spring(
            K,
            B,
            mass=MASS,
            friction=FRICTION,
            delay=delay,
            hold=hold,
            sampling=sampling,
            device_stiffness=c.stiffness,
            damper=damper,
            cutoff=CUTOFFS[damper],
            velocity=float(velocity),
            quantum=1e-12,
            force_limit=float(max(1e-3, 2.0 * (K * 1e-3 + B * velocity))),
        )
        measured = measure_trace(run(scene, duration=4.0), MASS)
        assert measured.dominant, (c, K, B, measured.reason)
        pole = c.dominant_poles(K, B)[0]
        assert abs(measured.pole - pole) < min(4.0 * measured.pole_uncertainty, 1e-7), (c, K, B)
        assert measured.k == pytest.approx(k, rel=1e-6)
        assert measured.b == pytest.approx(b, rel=1e-6)
        figures.most("pole off by, with every damper", abs(measured.pole - pole))
        figures.most("k off by, relative, with every damper", abs(measured.k / k - 1.0))
        figures.most("b off by, relative, with every damper", abs(measured.b / b - 1.0))
