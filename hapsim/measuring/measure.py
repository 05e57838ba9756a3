"""Closing the temporary hybrid system, ringing it, and identifying the spring and damper that it felt."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from hapsim.device.open_connection import TransportKind
from hapsim.errors import DeviceError, UsageError
from hapsim.measuring.limits import SHARE_OF_LIMIT, require_above_zero, require_device_point
from hapsim.measuring.measure_trace import Measurement, measure_trace
from hapsim.progress import Progress
from hapsim.recording.trace import Trace
from hapsim.running import Excitation
from hapsim.running.run import run_to_end as run
from hapsim.scene import Scene, Spring, ViscoElastic
from hapsim.scene.load import SceneSource, as_scene

_SECONDS = 2.0
_LEAST_TICKS, _MOST_TICKS = 2048, 20000
_KICK = 0.1  # m/s, what one push gives to the mass where nothing holds it
_PUSHES = 40  # in the second half of a measurement; the first is one ring-down
_SHARE_OF_TRAVEL = 0.25
_COUNTS = 2.0**31
_LEAST_ROWS = 32


def measure(
    scene: SceneSource,
    *,
    channel: int = 0,
    duration: float | None = None,
    push: float | None = None,
    transport: TransportKind = "auto",
    on_progress: Callable[[Progress], None] | None = None,
    stop_on_signals: bool = False,
) -> Measurement:
    """Rings the hand on `channel` and identifies what it feels.

    For half of the time it rings down once, from the mock's initial state or from a push where the device is at rest;
    then pushes follow, so that a motion which dies out in a few samples is seen many times. `duration`: seconds.
    `push`: the largest force of a push in N [default: a quarter of the force limit]. A correction that adapts is pushed
    all the time, and what it does in the second half is identified, with the mass that it has found.

    Raises what `hapsim.running.run` raises, and UsageError where too little moves to identify anything. Where the
    device fails, or stops by itself, and was recorded for long enough to identify something, the measurement is
    returned with the error as its `failure`.
    """
    scene = as_scene(scene)
    require_device_point(scene, channel)
    require_above_zero("seconds", duration=duration)
    require_above_zero("newton", push=push)
    if duration is None:
        duration = min(max(_SECONDS, _LEAST_TICKS / scene.rate), _MOST_TICKS / scene.rate)
    failure: DeviceError | None = None
    try:
        trace = run(
            scene,
            duration=duration,
            transport=transport,
            excitation=_pushes(scene, channel, duration, push),
            on_progress=on_progress,
            stop_on_signals=stop_on_signals,
        )
    except DeviceError as error:
        if error.trace is None or error.trace.sample.size < _LEAST_ROWS:
            raise
        failure, trace = error, error.trace
    try:
        mass, uncertainty = _mass_of(scene, trace, channel)
        return replace(measure_trace(_settled(scene, trace), mass, channel, uncertainty), failure=failure)
    except UsageError as nothing:
        if failure is None:
            raise
        raise failure from nothing


def _settled(scene: Scene, trace: Trace) -> Trace:
    """What a correction that adapts did once it knew the hand."""
    half = trace.sample.size // 2
    if scene.device.correction != "adaptive" or trace.sample.size - half < _LEAST_ROWS:
        return trace
    return trace.since(half)


def _mass_of(scene: Scene, trace: Trace, channel: int) -> tuple[float, float | None]:
    """(kg, its standard uncertainty or None): the mass that was estimated, or declared."""
    report, device = trace.report, scene.device
    if channel < len(report.estimated_mass_kg) and (found := report.estimated_mass_kg[channel]) is not None:
        return found, report.estimated_mass_uncertainty_kg[channel]
    return device.masses(scene.channels)[channel], device.mass_uncertainties(scene.channels)[channel]


def _pushes(scene: Scene, channel: int, duration: float, push: float | None) -> Excitation:
    """Pushes that move the hand clearly, and neither beyond the device's force nor beyond its range and travel."""
    device, mock = scene.device, scene.mock_device
    mass, ticks = device.masses(scene.channels)[channel], math.ceil(duration * scene.rate)
    free = 0 if device.correction == "adaptive" else ticks // 2
    every = max(32, (ticks - free) // _PUSHES)
    rests_s = max(free, every) / scene.rate
    # Until the next push even a free mass must stay in the range of its counts; a real device's is not known before.
    range_m = mock.quantum * _COUNTS if device.port is None else math.inf
    impulse = mass * min(_KICK, 0.05 * range_m / rests_s, _kick_within_travel(scene, channel, rests_s))
    limit = device.force_limit if device.port is not None else mock.force_limit
    most = SHARE_OF_LIMIT * limit if push is None else min(push, limit)
    force = min(most, impulse * scene.rate)
    at_rest = device.port is not None or (
        mock.initial_velocity[channel] == 0.0
        and device.origins(scene.channels)[channel] in (None, mock.initial_position[channel])
    )
    longest = every // 2
    length = longest if impulse * scene.rate > longest * force else max(1, round(impulse * scene.rate / force))
    return Excitation(channel, force, length, every, start=free, first=at_rest)


def _kick_within_travel(scene: Scene, channel: int, rests_s: float) -> float:
    """m/s, with which the hand goes through no more than _SHARE_OF_TRAVEL of device.travel before a spring that always
    holds it takes it back, or else the next push. Where it rests within that is not known before it is armed."""
    least, most = scene.device.travels(scene.channels)[channel]
    point = next(name for name, one in scene.device_points.items() if one.channel == channel)
    springs = (one for one in scene.links.values() if point in one.between and isinstance(one, ViscoElastic | Spring))
    stiffness = scene.device.stiffnesses(scene.channels)[channel] + sum(one.stiffness for one in springs)
    swing_s = math.sqrt(scene.device.masses(scene.channels)[channel] / stiffness) if stiffness > 0.0 else math.inf
    return _SHARE_OF_TRAVEL * (most - least) / min(rests_s, swing_s)
