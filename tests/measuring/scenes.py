"""Scenes of one hand on one spring, made from numbers."""

from __future__ import annotations

from typing import Any

from hapsim.scene import Scene
from hapsim.theory import Configuration
from tests.one_hand import scene_of, touch


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
    link = touch(stiffness, damping, damper=damper) | ({} if cutoff is None else {"cutoff": cutoff})
    device = {"mass": mass, "friction": friction, "delay": delay, "hold": hold, "sampling": sampling}
    device |= {"stiffness": device_stiffness, "force_limit": force_limit}
    mock = {"initial": {"position": ground, "velocity": velocity}, "quantum": quantum}
    modules = {"wall": {"type": "ground", "position": ground}, "touch": link}
    return scene_of(modules, rate=rate, device=device, mock=mock)


def with_configuration(c: Configuration, stiffness: float, damping: float, **more: Any) -> Scene:
    """The same, on a device with this configuration."""
    names = ("mass", "rate", "friction", "delay", "hold", "sampling", "damper", "cutoff")
    device = {name: getattr(c, name) for name in names}
    return one_spring(float(stiffness), float(damping), device_stiffness=c.stiffness, **device, **more)
