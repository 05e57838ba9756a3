"""Scenes of one hand on one spring, made from numbers."""

from __future__ import annotations

from typing import Any

from hapsim.scene import Scene, parse_scene
from hapsim.theory import Configuration


def one_spring(
    stiffness: float,
    damping: float,
    *,
    mass: float = 0.2,
    friction: float = 0.0,
    delay: float = 1.0,
    hold: str = "zoh",
    sampling: str = "ideal",
    rate: float = 1000.0,
    velocity: float = 0.1,
    quantum: float = 1e-9,
    force_limit: float = 1000.0,
    ground: float = 0.0,
    device_stiffness: float = 0.0,
    damper: str = "backward",
    cutoff: float | None = None,
) -> Scene:
    """A hand, a wall, and a visco-elastic link; clock: lockstep."""
    of_damper = f"damper: {damper}" + ("" if cutoff is None else f", cutoff: {cutoff!r}")
    return parse_scene(
        f"""
version: 1
rate: {rate!r}
device: {{clock: lockstep, mass: {mass!r}, friction: {friction!r}, delay: {delay!r}, hold: {hold},
         sampling: {sampling}, stiffness: {device_stiffness!r}, force_limit: {force_limit!r}}}
mock: {{initial: {{position: {ground!r}, velocity: {velocity!r}}}, quantum: {quantum!r}}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground, position: {ground!r}}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: {stiffness!r}, damping: {damping!r},
          {of_damper}}}
"""
    )


def with_configuration(c: Configuration, stiffness: float, damping: float, **more: Any) -> Scene:
    """The same, on a device with this configuration."""
    names = ("mass", "rate", "friction", "delay", "hold", "sampling", "damper", "cutoff")
    device = {name: getattr(c, name) for name in names}
    return one_spring(float(stiffness), float(damping), device_stiffness=c.stiffness, **device, **more)
