"""The options of a measurement, and the checks of their values."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, TypedDict

from hapsim.device.connection import describe
from hapsim.device.open_connection import open_connection, place_of_device
from hapsim.errors import UsageError
from hapsim.prediction.linear import with_device
from hapsim.recording.trace import Trace
from hapsim.running.motors import may_be_lowered, motors_of
from hapsim.running.requirements import require_compatible
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


def as_limited(
    scene: Scene, channels: Sequence[int], push: float | None, run: Run, options: RunOptions
) -> tuple[Scene, Run]:
    """Returns the scene with the force limit that its runs have on these channels, so that pushes are made for it, and
    `run` with these options. At a port whose motors are not known to be right that may be a tenth of the scene's:
    `on_warning` says so. Raises UsageError if that is less than `push` (N)."""
    warn, own = options.pop("on_warning", None), scene.device.force_limit
    with_options: Run = partial(run, **options)
    kind = options.get("transport", "auto")
    if place_of_device(scene, kind, portable=True) != "port" or not may_be_lowered(scene):
        return scene, with_options
    with open_connection(scene, kind) as connection:
        description = describe(connection)
        require_compatible(scene, connection.name, description)
        motors = motors_of(scene, connection, description)
    if not set(channels) & set(motors.lowered):
        return scene, with_options
    limit = min(motors.description.force_limit[c] for c in channels)
    if push is not None and push > limit:
        units = scene.units_of(channels[0])
        found, most = units(push, "N", "g"), units(limit, "N", ".3g")
        raise UsageError(f"push: found {found}, expected at most {most}. {motors.warning}")
    if warn is not None:
        warn(motors.warning)

    def run_with_own_limit(scene: Scene, **more: Any) -> Trace:
        return with_options(with_device(scene, force_limit=own), **more)

    return with_device(scene, force_limit=limit), run_with_own_limit


def require_above_zero(unit: str, **values: float | None) -> None:
    """Raises UsageError for a given value that is not a finite number above 0."""
    for name, value in values.items():
        if value is not None and not 0.0 < value < math.inf:
            raise UsageError(f"{name}: found {value:g}, expected a finite number of {unit} above 0")


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
