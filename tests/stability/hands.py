"""Scenes of one hand in virtual time, made from numbers, and what a swing is like at its two ends."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from hapsim.errors import DeviceError
from hapsim.recording.trace import Trace
from hapsim.running import run
from hapsim.scene import Scene, parse_scene

RATE = 1000.0
TOUCH = ("hand", "wall")


def hand_scene(
    modules: dict[str, dict[str, Any]],
    *,
    rate: float = RATE,
    device: dict[str, Any],
    mock: dict[str, Any] | None = None,
    precision: str = "double",
) -> Scene:
    """A hand called `hand` and a wall called `wall`, at 0 unless `modules` says otherwise; clock: lockstep."""
    document = {
        "version": 1,
        "rate": rate,
        "precision": precision,
        "device": {"clock": "lockstep", "force_limit": 1e6, **device},
        "mock": {"quantum": 1e-11, **(mock or {})},
        "modules": {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, **modules},
    }
    return parse_scene(json.dumps(document))


def spring(stiffness: float, damping: float = 0.0, **more: Any) -> dict[str, Any]:
    """A visco-elastic link from the hand to the wall."""
    return {"type": "viscoelastic", "between": TOUCH, "stiffness": stiffness, "damping": damping, **more}


def contact(stiffness: float, damping: float = 0.0, **more: Any) -> dict[str, Any]:
    """A buffer that keeps the hand above the wall."""
    return {"type": "buffer", "between": TOUCH, "stiffness": stiffness, "damping": damping, **more}


def ran(scene: Scene, ticks: int) -> Trace:
    """Returns the trace, also of a run that ended because the hand left the range of its counts."""
    try:
        return run(scene, duration=ticks / scene.rate)
    except DeviceError as error:
        if error.trace is None:
            raise
        return error.trace


def swing(position: np.ndarray, last: int) -> tuple[float, float]:
    """Half the way from end to end in the `last` samples, and in as many before them."""
    ends = position[-last:], position[-2 * last : -last]
    now, before = (0.5 * float(np.ptp(part)) for part in ends)
    return now, before
