"""Felt values behind a belt or a lagging motor, measured on the mock as they are predicted."""

from __future__ import annotations

import math

import pytest

import hapsim
from hapsim.scene import parse_scene

BELT = f"transmission: {{stiffness: 20000, damping: {0.04 * math.sqrt(2e4 * 0.0375)}, motor_mass: 0.05, sensor: %s}}"


@pytest.mark.parametrize(
    "device", [BELT % "motor", BELT % "handle", "motor_lag: 1 ms", "motor_lag: 0.3 ms, hold: ramp"]
)
def test_k_and_b_are_measured_as_predicted(device: str) -> None:
    scene = parse_scene(f"""
version: 1
rate: 1000
device: {{clock: lockstep, mass: 0.2, friction: 1, {device}}}
mock: {{initial: {{position: 1 mm}}}}
modules:
  hand: {{type: device, channel: 0}}
  ground: {{type: ground}}
  spring: {{type: viscoelastic, between: [hand, ground], stiffness: 2000, damping: 5}}
""")
    (part,) = hapsim.predict(scene).parts
    measured = hapsim.measure(scene)
    assert measured.k == pytest.approx(float(part.felt.k[0, 0]), rel=1e-6)
    assert measured.b == pytest.approx(float(part.felt.b[0, 0]), rel=1e-6)
