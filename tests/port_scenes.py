"""Scenes of several devices."""

from __future__ import annotations

from typing import Any

from hapsim.scene import Scene, parse_scene

TWO = """\
version: 1
rate: 1000
devices:
  left: {mass: 0.2, friction: 1}
  right: {mass: 0.2, friction: 1}
modules:
  a: {type: device, of: left, channel: 0}
  b: {type: device, of: right, channel: 0}
  spring: {type: viscoelastic, between: [a, b], stiffness: 2000, damping: 5}
"""
"""Two hands on one spring."""


def two_devices(**changes: Any) -> Scene:
    """Returns two hands on one spring, with other parts of the scene, such as `mocks`, as its file would have them."""
    scene = parse_scene(TWO)
    return Scene.model_validate(scene.document | changes)
