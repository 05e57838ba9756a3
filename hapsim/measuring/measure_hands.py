"""Ringing several hands that are linked, one after the other, and identifying what each feels of the scene and of the
others. Nothing here knows the scene's links but that something holds the hands."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from hapsim.device.open_connection import TransportKind
from hapsim.loop.ring import BRIDGED, LATE_FORCE, LIMITED
from hapsim.measuring.converters import Floats
from hapsim.measuring.limits import in_units_of_scene, require_above_zero, require_device_point
from hapsim.measuring.measure import pushes
from hapsim.measuring.rings import HandsMeasurement, identify_rings
from hapsim.one_thread import one_thread
from hapsim.progress import Progress
from hapsim.recording.trace import Trace
from hapsim.running.run import run_to_end
from hapsim.scene import Scene
from hapsim.scene.load import SceneSource

_SECONDS, _RINGS = 4.0, 4
_RUN_UP = 8  # samples after a push, until the force is over


@in_units_of_scene
def measure_hands(
    scene: SceneSource,
    *,
    channels: Sequence[int],
    duration: float | None = None,
    push: float | None = None,
    transport: TransportKind = "auto",
    on_progress: Callable[[Progress], None] | None = None,
    stop_on_signals: bool = False,
    unstable: bool | None = None,
) -> HandsMeasurement:
    """Rings the hands on these channels, one after the other, and identifies what all of them feel.

    `duration`: seconds for each [default: 4]; `push`: N, the largest force. UsageError where their motion does not show
    as many springs and dampers. The rest as of `measure`.
    """
    run = partial(run_to_end, transport=transport, on_progress=on_progress, unstable=unstable)
    run = partial(run, stop_on_signals=stop_on_signals)
    return measure_hands_by(run, scene, channels, duration, push)  # type: ignore[arg-type]


def measure_hands_by(
    run: Callable[..., Trace], scene: Scene, channels: Sequence[int], duration: float | None, push: float | None
) -> HandsMeasurement:
    """Does what `measure_hands` does, with `run(scene, duration=…, excitation=…)` for each hand."""
    require_above_zero("seconds", duration=duration)
    require_above_zero("newton", push=push)
    traces, segments = [], list[Floats]()
    for channel in channels:
        require_device_point(scene, channel)
        seconds = _SECONDS if duration is None else duration
        every = int(seconds * scene.rate) // _RINGS
        excitation = replace(pushes(scene, channel, seconds, push), start=0, every=every, first=False)
        trace = run(scene, duration=seconds, excitation=excitation)
        begins = np.arange(0, trace.sample[-1] if trace.sample.size else 0, every)
        traces.append(trace)
        quiet = excitation.ticks + _RUN_UP + math.ceil(scene.device.delay)
        segments += _free(trace, begins + quiet, begins + every, list(channels))
    mass = np.array([scene.device.masses(scene.channels)[channel] for channel in channels])
    with one_thread():
        return identify_rings(segments, mass, scene.rate, _is_held(scene, channels), tuple(channels), tuple(traces))


def _is_held(scene: Scene, channels: Sequence[int]) -> bool:
    """Whether something holds these hands at a place of rest: a constant of the motion that is none of theirs."""
    reached = {name for name, one in scene.device_points.items() if one.channel in channels}
    links, grounds = [{*one.between} for one in scene.links.values()], scene.grounds.keys()
    for _ in links:
        reached = reached.union(*(ends for ends in links if ends & reached - grounds))
    return bool(reached & grounds) or max(scene.device.stiffnesses(scene.channels)) > 0.0


def _free(trace: Trace, begins: Any, ends: Any, channels: list[int]) -> list[Floats]:
    """(samples, n) m: what was recorded without a gap, a late force or one at its limit, between two pushes."""
    bad = (trace.flags & (LATE_FORCE | BRIDGED | LIMITED)) != 0
    breaks = np.flatnonzero(bad | (np.diff(trace.sample, prepend=trace.sample[:1] - 1) != 1))
    found = []
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        first, last = np.searchsorted(trace.sample, [begin, end]).tolist()
        edges = [first, *breaks[(breaks >= first) & (breaks < last)].tolist(), last]
        found += [trace.position[low + (low != first) : high, channels] for low, high in pairwise(edges)]
    return found
