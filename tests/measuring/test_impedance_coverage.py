"""How often the truth lies outside the circles that `measure --impedance` states: as often as they say."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.measuring import impedance
from hapsim.measuring.converters import Converters
from hapsim.measuring.impedance import impedance_of
from hapsim.measuring.measure_impedance import measure_impedance
from hapsim.measuring.multisine import Periods, lines_for, periods_of
from hapsim.prediction.impedance import predict_impedance
from hapsim.scene import parse_scene

sys.path.insert(0, str(Path(__file__).parent))
from records import trace_of

LINES = lines_for(1000.0)
CONVERTERS = Converters("zoh", "ideal")
STIFFNESS = 700.0  # N/m: all that this device has


def noisy_periods(seed: int) -> Periods:
    """Thirteen pairs of periods of a spring that a multisine pulls, read with a white noise of 1 µm."""
    rng = np.random.default_rng(seed)
    pulled = np.zeros(LINES.samples // 2 + 1, complex)
    pulled[LINES.bins] = np.exp(2j * np.pi * rng.random(LINES.bins.size))
    force = np.tile(20.0 * np.fft.irfft(pulled, LINES.samples), 14)
    trace = trace_of(force / STIFFNESS + 1e-6 * rng.normal(size=force.size), force)
    return periods_of(trace, LINES, CONVERTERS, senses=False)


def test_as_many_values_lie_outside_their_circles_as_the_confidence_says(
    monkeypatch: pytest.MonkeyPatch, figures: Any
) -> None:
    """The 99.9 % are of all circles together, of which no test could count the misses; so the circles are drawn for
    10 % and 1 % of misses each. They are somewhat wide, because of the overlap: 0.8 and 0.7 of that."""
    experiments = [noisy_periods(seed) for seed in range(300)]
    size = LINES.bins.size
    shares = {}
    for outside in (0.1, 0.01):
        monkeypatch.setattr(impedance, "CONFIDENCE", 1.0 - outside * size)
        found = [impedance_of([one], LINES.frequency, 1000.0, 0.0, CONVERTERS).device for one in experiments]
        late = CONVERTERS.response(LINES.frequency, 1000.0, 0.0)
        true = (STIFFNESS * late / (2j * np.pi * LINES.frequency))[:, None, None]
        missed = [np.abs(one.value - true) > one.uncertainty for one in found]
        shares[outside] = float(np.mean(missed)) / outside
    figures.most("impedance values outside circles drawn for 10 %, of these", shares[0.1])
    assert 0.7 < shares[0.1] < 0.9
    assert 0.3 < shares[0.01] < 0.8


THREE_HANDS = """
version: 1
rate: 1000
scheme: exact
device: {{clock: lockstep, mass: [0.15, 0.3, 0.2], friction: [0.8, 1.5, 1.0], delay: 2, force_limit: 20}}
mock: {{quantum: {quantum}, noise: {noise}}}
modules:
  a: {{type: device, channel: 0}}
  b: {{type: device, channel: 1}}
  c: {{type: device, channel: 2}}
  wall: {{type: ground}}
  p: {{type: mass, mass: {mass}}}
  q: {{type: mass, mass: 0.5}}
  ap: {{type: viscoelastic, between: [a, p], stiffness: {coupling}, damping: 1}}
  bp: {{type: viscoelastic, between: [b, p], stiffness: 300, damping: 2}}
  bq: {{type: viscoelastic, between: [b, q], stiffness: {coupling}, damping: 1}}
  cq: {{type: viscoelastic, between: [c, q], stiffness: 30, damping: 1}}
  aw: {{type: viscoelastic, between: [a, wall], stiffness: 900, damping: 5}}
  bw: {{type: viscoelastic, between: [b, wall], stiffness: 600, damping: 5}}
  cw: {{type: viscoelastic, between: [c, wall], stiffness: 1200, damping: 6}}
"""


def test_a_hand_that_moves_by_few_counts_while_another_is_excited_is_within_the_uncertainty() -> None:
    """Its rounding is not like noise then: it follows the motion, and is the same in every period."""
    outside, certain = 0, []
    for quantum, noise, coupling, mass in ((9e-7, 0.0, 30.0, 0.5), (2e-7, 0.0, 1.0, 0.3), (8e-7, 1e-6, 3.0, 0.9)):
        scene = parse_scene(THREE_HANDS.format(quantum=quantum, noise=noise, mass=mass, coupling=coupling))
        found = measure_impedance(scene)
        predicted = predict_impedance(scene, found.frequency)
        for kind in ("device", "rendered", "closed_loop"):
            circles, own = getattr(found, kind), np.arange(3)
            outside += np.count_nonzero(np.abs(circles.value - getattr(predicted, kind)) > circles.uncertainty)
            certain.append(circles.uncertainty[:, own, own] / np.abs(circles.value[:, own, own]))
    assert outside == 0
    assert np.median(certain) < 0.01  # and it is no wide circle that holds them
