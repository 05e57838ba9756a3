"""The options of a measurement: how its scene runs, what may be asked of it, and how hard it may push."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, TypedDict

from hapsim.errors import UsageError
from hapsim.recording.trace import Trace
from hapsim.scene import Scene

if TYPE_CHECKING:
    from hapsim.device.open_connection import TransportKind
    from hapsim.loop.counts import Progress

Run = Callable[..., Trace]
"""`run(scene, duration=…, excitation=…, **options)`, as `hapsim.run`."""

SHARE_OF_LIMIT = 0.25
"""Of the force limit: the largest push where none is given."""


class RunOptions(TypedDict, total=False):
    """Options of each run of a measurement, as of `hapsim.run`."""

    transport: TransportKind
    on_progress: Callable[[Progress], None] | None
    stop_on_signals: bool
    unstable: bool | None


def require_above_zero(unit: str, **values: float | None) -> None:
    """Raises UsageError for a value that is given and is not a finite number above 0."""
    for name, value in values.items():
        if value is not None and not 0.0 < value < math.inf:
            raise UsageError(f"{name}: found {value:g}, expected a finite number of {unit} above 0")


def require_device_point(scene: Scene, channel: int) -> None:
    """Raises UsageError where the scene has no device point on this channel."""
    channels = [point.channel for point in scene.device_points.values()]
    if channel not in channels:
        known = ", ".join(map(str, channels))
        raise UsageError(f"channel {channel}: the scene has nothing there; its device points are on: {known}")


def force_limit(scene: Scene) -> float:
    """N, of the scene; and of the mock where that is the device."""
    limit = scene.device.force_limit
    return limit if scene.device.port is not None else min(limit, scene.mock_device.force_limit)


def largest_push(scene: Scene, push: float | None) -> float:
    """N, of a measurement that is asked for this push, or for none: within the force limit."""
    limit = force_limit(scene)
    return SHARE_OF_LIMIT * limit if push is None else min(push, limit)
