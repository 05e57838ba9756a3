"""Random scenes of a hand behind a belt with play, and what the mock's motor or handle swings by in them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

import hapsim
from hapsim.prediction.backlash import rattle_in
from hapsim.prediction.linear import linear_scene, network_of
from hapsim.scene import Scene, parse_scene
from hapsim.theory import solve

_STEADY = 1.1  # ratio of two quarters of a run
_SMALL = 0.03  # of the play: a smaller swing is none


class Case(NamedTuple):
    """A swing of the side that is read, m from end to end: simulated by the mock, and predicted; 0: none."""

    simulated: float
    predicted: float


def backlash_scene(random: np.random.Generator) -> Scene:
    """A scene with a play of 0.05 to 0.5 mm and a belt whose own swing has 40 to 400 Hz, on a spring to a ground."""
    mass, share = 10 ** random.uniform(-1.2, -0.3), random.uniform(0.1, 0.6)
    moved = share * (1 - share) * mass
    belt = moved * (2 * math.pi * random.uniform(40, 400)) ** 2
    play = random.uniform(0.05e-3, 0.5e-3)
    sensor, brakes = random.choice(["motor", "handle"], 2)
    return parse_scene(f"""
version: 1
rate: 1000
device:
  {{clock: lockstep, mass: {mass}, friction: {random.uniform(0, 1)}, delay: {random.choice([1, 1.5])},
   hold: {random.choice(["zoh", "ramp"])}, force_limit: 1000000, energy_limit: 1000000000,
   transmission: {{stiffness: {belt}, damping: {2 * random.uniform(0.02, 0.2) * math.sqrt(belt * moved)},
     motor_mass: {share * mass}, sensor: {sensor}, friction_at: {brakes}, backlash: {play}}}}}
mock: {{initial: {{position: {2 * play}}}}}
modules:
  hand: {{type: device, channel: 0}}
  ground: {{type: ground}}
  spring: {{type: viscoelastic, between: [hand, ground], stiffness: {mass * 10 ** random.uniform(3, 5)},
            damping: {mass * 10 ** random.uniform(1, 2.7)}}}
""")


def compared(scene: Scene) -> Case | None:
    """Returns its swings; None if it is not stable in mesh, or if the mock's swing is not steady."""
    network, _ = network_of(scene, linear_scene(scene))
    if solve(network).spectral_radius > 1 - 1e-4:
        return None
    drive = scene.device.drives(1)[0]
    x = np.asarray(hapsim.run(scene, duration=2.4).position)[:, 0]
    before, after = (float(np.ptp(one)) for one in (x[1200:1800], x[1800:2400]))
    if after < _SMALL * drive.backlash:
        return Case(0.0, 0.0 if rattle_in(network, drive.backlash) is None else math.inf)
    if not 1 / _STEADY < after / before < _STEADY:
        return None
    found = rattle_in(network, drive.backlash)
    return Case(after, 0.0 if found is None else getattr(found, drive.sensor))
