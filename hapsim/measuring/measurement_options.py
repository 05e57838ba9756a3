"""The options of a measurement, and the checks of their values."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypedDict

from hapsim.errors import UsageError
from hapsim.recording.trace import Trace
from hapsim.scene import Scene

if TYPE_CHECKING:
    from hapsim.device.open_connection import TransportKind
    from hapsim.loop.counts import Progress

Run = Callable[..., Trace]
"""A function like `hapsim.run`: `run(scene, duration=…, excitation=…, **options)`."""

SHARE_OF_LIMIT = 0.25
"""Default of the largest push, as a share of the force limit."""


class RunOptions(TypedDict, total=False):
    """Options of each run of a measurement, as in `hapsim.run`."""

    transport: TransportKind
    on_progress: Callable[[Progress], None] | None
    stop_on_signals: bool
    unstable: bool | None
    on_warning: Callable[[str], None] | None


class PushOptions(RunOptions, total=False):
    """Options of an identification, which pushes a device, and of its runs."""

    channel: int
    """Channel to push [default: 0]."""
    force: float | None
    """Largest force to either side, N [default: a quarter of the scene's force_limit]."""
    travel: float | None
    """Largest distance from the home position, m [default: 0.005 m, 0.2 rad]."""
    duration: float | None
    """Duration of the fitted record, s."""
    run: Run
    """Function that runs the scene with `RunOptions` [default: hapsim.run]."""


def require_above_zero(unit: str, **values: float | None) -> None:
    """Raises UsageError for a given value that is not a finite number above 0."""
    for name, value in values.items():
        if value is not None and not 0.0 < value < math.inf:
            raise UsageError(f"{name}: found {value:g}, expected a finite number of {unit} above 0")


def require_pushable(scene: Scene, channels: Sequence[int], duration: float | None, push: float | None) -> None:
    """Raises UsageError if one of the channels has no device point, or if a given duration, s, or push, N, is not a
    finite number above 0."""
    for channel in channels:
        require_device_point(scene, channel)
    require_above_zero("seconds", duration=duration)
    require_above_zero(scene.units_of(channels[0]).name("newton"), push=push)


def require_device_point(scene: Scene, channel: int) -> None:
    """Raises UsageError if the scene has no device point on this channel."""
    channels = [point.channel for point in scene.device_points.values()]
    if channel not in channels:
        known = ", ".join(map(str, channels))
        raise UsageError(f"channel {channel}: the scene has nothing there; its device points are on: {known}")


def force_limit(scene: Scene) -> float:
    """Returns the force limit of the scene, N, or the mock's if that is the device and lower."""
    limit = scene.device.force_limit
    return limit if scene.device.port is not None else min(limit, scene.mock_device.force_limit)


def largest_push(scene: Scene, push: float | None) -> float:
    """Returns the largest push of a measurement within the force limit, N. `push`: as requested, or None."""
    limit = force_limit(scene)
    return SHARE_OF_LIMIT * limit if push is None else min(push, limit)
