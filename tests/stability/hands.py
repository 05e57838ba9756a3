"""Scenes of one hand in virtual time, made from numbers, and what a swing is like at its two ends."""

from __future__ import annotations

from typing import Any

import numpy as np

from hapsim.errors import DeviceError
from hapsim.recording.trace import Trace
from hapsim.running import run
from hapsim.scene import Scene
from tests.one_hand import scene_of, touch

RATE = 1000.0
spring = touch


def hand_scene(
    modules: dict[str, dict[str, Any]],
    *,
    rate: float = RATE,
    device: dict[str, Any],
    mock: dict[str, Any] | None = None,
    precision: str = "double",
) -> Scene:
    """A hand called `hand` and a wall called `wall`, at 0 unless `modules` says otherwise; clock: lockstep."""
    device, mock = {"force_limit": 1e6, "friction": 0.0, **device}, {"quantum": 1e-11, **(mock or {})}
    return scene_of(modules, device=device, mock=mock, rate=rate, precision=precision)


def contact(stiffness: float, damping: float = 0.0, **more: Any) -> dict[str, Any]:
    """A buffer that keeps the hand above the wall."""
    return touch(stiffness, damping, "buffer", **more)


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
