"""A hand on channel 0 and a wall at 0, in virtual time: what the scenes of many tests begin with."""

from __future__ import annotations

from typing import Any

from hapsim.scene import Scene

HAND: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
DEVICE: dict[str, Any] = {"clock": "lockstep", "mass": 0.2, "friction": 1.0}


def touch(stiffness: float, damping: float = 0.0, kind: str = "viscoelastic", **more: Any) -> dict[str, Any]:
    """Returns a link between hand and wall."""
    return {"type": kind, "between": ["hand", "wall"], "stiffness": stiffness, "damping": damping} | more


def document_of(modules: dict[str, Any], *, device: Any = None, mock: Any = None, **keys: Any) -> dict[str, Any]:
    """Returns the document of a scene at 1 kHz with these modules besides; `device`, `mock`: what differs."""
    whole = {"version": 1, "rate": 1000.0, "device": DEVICE | (device or {}), "mock": mock or {}}
    return whole | keys | {"modules": HAND | modules}


def scene_of(modules: dict[str, Any], *, device: Any = None, mock: Any = None, **keys: Any) -> Scene:
    """Returns the scene of `document_of`."""
    return Scene.model_validate(document_of(modules, device=device, mock=mock, **keys))
