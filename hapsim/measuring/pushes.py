"""Pushes that excite a hand, and the run that records its motion."""

from __future__ import annotations

import math

from hapsim.errors import DeviceError, GuardError
from hapsim.measuring.measurement_options import Run, force_limit, largest_push
from hapsim.measuring.place import Place
from hapsim.recording.trace import Trace
from hapsim.running import Excitation
from hapsim.scene import Scene

_SECONDS = 2.0
_LEAST_TICKS, _MOST_TICKS = 2048, 20000
_PUSHES = 40  # in the second half of a measurement; the first is one ring-down
_SHARE_OF_TRAVEL = 0.25
_COUNTS = 2.0**31
LEAST_ROWS = 32
"""Samples from which something can be identified."""


def duration_of(scene: Scene, duration: float | None) -> float:
    """Returns the duration of a measurement, s: as requested, or the default."""
    if duration is None:
        return min(max(_SECONDS, _LEAST_TICKS / scene.rate), _MOST_TICKS / scene.rate)
    return duration


def pushes(
    scene: Scene,
    channel: int,
    duration: float,
    push: float | None,
    place: Place | None = None,
    swing: float = math.inf,
    *,
    larger: float = 1.0,
) -> Excitation:
    """Returns pushes that move the hand clearly, within the device's force, range and travel: `larger` times as far as
    usual. At a `place` they move it by `swing` m, and a push of `push` N lasts one radian of the spring's oscillation.
    """
    device, mock = scene.device, scene.mock_device
    mass, ticks = device.masses(scene.channels)[channel], math.ceil(duration * scene.rate)
    free = 0 if device.correction == "adaptive" else ticks // 2
    every = max(32, (ticks - free) // _PUSHES)
    rests_s = max(free, every) / scene.rate
    # Until the next push even a free mass must stay in the range of its counts. A real device reports its range later.
    range_m = mock.quantum[channel] * _COUNTS if device.port is None else math.inf
    kick = larger * mass * device.scales(scene.channels)[channel].kick
    wanted = kick if push is None else max(kick, push / scene.rate)
    impulse = min(wanted, mass * min(0.05 * range_m / rests_s, _kick_within_travel(scene, channel, rests_s)))
    most = min(larger * largest_push(scene, push), force_limit(scene))
    longest = every // 2
    if place is not None:
        eigen = math.sqrt(max(place.stiffness, 0.0) / mass)  # rad/s
        length = max(1, min(longest, round(scene.rate / eigen))) if eigen > 0.0 else longest
        impulse = min(impulse, swing * max(mass * eigen, place.damping, mass / rests_s))
        force = min(most, impulse * scene.rate / length) if push is None else most
        return Excitation(channel, force, length, every, start=free, first=True, guide=place.guide(scene))
    force = min(most, impulse * scene.rate)
    at_rest = device.port is not None or (
        mock.initial_velocity[channel] == 0.0
        and device.origins(scene.channels)[channel] in (None, mock.initial_position[channel])
    )
    length = longest if impulse * scene.rate > longest * force else max(1, round(impulse * scene.rate / force))
    return Excitation(channel, force, length, every, start=free, first=at_rest)


def _kick_within_travel(scene: Scene, channel: int, rests_s: float) -> float:
    """Returns the velocity in m/s at which the hand uses no more than _SHARE_OF_TRAVEL of device.travel until a spring,
    or else the next push, returns it. Its place of rest within the travel is not known before arming."""
    least, most = scene.device.travels(scene.channels)[channel]
    point = next(name for name, one in scene.device_points.items() if one.channel == channel)
    laws = (one.law() for one in scene.links.values() if point in one.between)
    stiffness = scene.device.stiffnesses(scene.channels)[channel] + sum(law.below for law in laws if law.is_line)
    swing_s = math.sqrt(scene.device.masses(scene.channels)[channel] / stiffness) if stiffness > 0.0 else math.inf
    return _SHARE_OF_TRAVEL * (most - least) / min(rests_s, swing_s)


def recorded(run: Run, scene: Scene, excitation: Excitation, duration: float) -> tuple[Trace, DeviceError | None]:
    """Runs the excitation for `duration` s. Returns the trace, and the error that ended it early or None. Raises
    DeviceError if too little was recorded."""
    guided = excitation.ticks_before(scene.rate)
    try:
        trace, failure = run(scene, duration=duration + guided / scene.rate, excitation=excitation), None
    except (DeviceError, GuardError) as error:
        recorded = 0 if error.trace is None else error.trace.sample.size
        if excitation.guide is not None and 0 < recorded < guided:
            where = scene.units_of(excitation.channel)(excitation.guide.target, "m")
            error.args = (f"while the hand was led to {where}, by a force besides the scene's: {error}",)
        if isinstance(error, GuardError) or recorded < guided + LEAST_ROWS:
            raise
        trace, failure = error.trace, error
    return trace, failure
