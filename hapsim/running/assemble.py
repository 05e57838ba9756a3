"""Scene, line and description -> Loop: every array that the loop works on, allocated once and touched once."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description
from firmware_protocol.frames import armed_format
from hapsim.cordis.program import compile_scene, parameter_values
from hapsim.device.line import Line
from hapsim.loop.exchange import (
    CONTROL,
    DEVICE_CLOCK,
    HOST_CLOCK,
    NO_CLOCK,
    STATE,
    Loop,
    desk_of,
    new_statistics,
)
from hapsim.loop.guard.rate import WATCH
from hapsim.loop.parameters import parameters_of
from hapsim.loop.ring import new_ring
from hapsim.running.excitation import Excitation
from hapsim.scene import Scene

_RING_ROWS = 1 << 16
_CLOCK = {"device": DEVICE_CLOCK, "host": HOST_CLOCK, "lockstep": NO_CLOCK}


def assemble_loop(
    scene: Scene,
    line: Line,
    description: Description,
    excitation: Excitation | None = None,
    duration: float | None = None,
) -> Loop:
    """The loop of `scene` over `line`, for `duration` seconds (None: until stopped), not yet armed."""
    channels = description.channels
    values = parameter_values(scene)
    return Loop(
        port=line.port,
        inbox=line.inbox,
        decoder=line.decoder,
        wire=armed_format(channels, bool(scene.sensed_links)),
        program=compile_scene(scene, values, channels),
        parameters=parameters_of(values),
        ring=new_ring(channels, _RING_ROWS, waits=scene.device.clock == "lockstep"),
        desk=_desk(scene, description),
        control=_control(scene, excitation, duration),
        state=np.zeros(1, STATE)[0],
        watch=_watch(scene, line),
        statistics=new_statistics(),
    )


def watchdog_samples(rate: float, description: Description) -> int:
    """A tenth of a second of silence of the host, as far as the device lets us."""
    return min(max(round(0.1 * rate), 10), description.max_watchdog_samples)


def _control(scene: Scene, excitation: Excitation | None, duration: float | None) -> Any:
    control = np.zeros(1, CONTROL)[0]
    control["ticks"] = -1 if duration is None else max(1, round(duration * scene.rate))
    control["go"] = 1
    control["period_ns"] = round(1e9 / scene.rate)
    control["clock"] = _CLOCK[scene.device.clock]
    control["silence_ns"] = round(1e9 * max(0.25, 20.0 / scene.rate))
    control["time_to_live"] = min(max(round(0.02 * scene.rate), 2), schema.MAX_TIME_TO_LIVE_SAMPLES)
    if scene.device.clock == "lockstep":
        control["silence_ns"] = 5_000_000_000  # the mock may live in a process that is only now being compiled
    if excitation is not None:
        control["pulse_channel"] = excitation.channel
        control["pulse_force"] = excitation.force
        control["pulse_ticks"] = excitation.ticks
        control["pulse_every"] = excitation.every
        control["pulse_first"] = excitation.first
        control["pulse_from"] = excitation.start
    return control


def _watch(scene: Scene, line: Line) -> Any:
    watch = np.zeros(1, WATCH)[0]
    watch["judges"] = scene.device.clock == "device" and line.has_timer
    return watch


def _desk(scene: Scene, description: Description) -> Any:
    desk = np.zeros(1, desk_of(description.channels))[0]
    desk["position_scale"] = description.position_scale
    desk["force_scale"] = description.force_scale
    if scene.sensed_links:
        desk["velocity_scale"] = description.velocity_scale
    # In whole counts, so that the rounding of a force at its limit does not go beyond it, nor a count beyond 32 bits.
    scale, limit = np.array(description.force_scale), np.minimum(description.force_limit, scene.device.force_limit)
    with np.errstate(over="ignore"):
        counts = np.minimum(np.floor(limit / scale * (1.0 + 1e-12)), 2.0**31 - 1.0)
    desk["force_limit"] = counts * scale
    return desk
