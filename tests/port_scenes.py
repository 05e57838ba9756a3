"""Scenes of several devices."""

from __future__ import annotations

from typing import Any

from hapsim.scene import Scene, parse_scene

TWO = """\
version: 1
rate: 1000
devices:
  left: {clock: lockstep, mass: 0.2, friction: 1}
  right: {clock: lockstep, mass: 0.2, friction: 1}
modules:
  a: {type: device, of: left, channel: 0}
  b: {type: device, of: right, channel: 0}
  spring: {type: viscoelastic, between: [a, b], stiffness: 2000, damping: 5}
"""
"""Two hands on one spring, in virtual time."""

MORE = """\
version: 1
rate: 1000
devices:
  left: {clock: lockstep, mass: [0.2, 0.3], friction: 1}
  right: {clock: lockstep, mass: 0.1, friction: 0.5, motion: linear}
leader: right
modules:
  floor: {type: ground}
  thumb: {type: device, of: left, channel: 0}
  finger: {type: device, of: left, channel: 1}
  hand: {type: device, of: right, channel: 0}
  ball: {type: mass, mass: 0.05}
  gut: {type: string, masses: 4, mass: 0.01, stiffness: 500}
  own: {type: viscoelastic, between: [thumb, floor], stiffness: 100, damping: 1}
  touch: {type: viscoelastic, between: [finger, ball], stiffness: 200, damping: 1}
  pluck: {type: viscoelastic, between: [gut.2, finger], stiffness: 300, damping: 1}
  hold: {type: viscoelastic, between: [hand, ball], stiffness: 400, damping: 1}
  tie: {type: viscoelastic, between: [gut.0, floor], stiffness: 50, damping: 0}
sound: {ear: {from: gut.1, of: velocity}}
"""
"""Three hands of two devices, and masses that move with the second."""


def two_devices(**changes: Any) -> Scene:
    """Returns two hands on one spring, with other parts of the scene, such as `mocks`, as its file would have them."""
    return Scene.model_validate(parse_scene(TWO).document | changes)
