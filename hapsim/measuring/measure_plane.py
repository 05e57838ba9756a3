"""measure_in_plane: leads a hand to a place in the plane, pushes it along x and along y, and identifies the springs and
dampers that it feels there from the free motion of both coordinates.

Of the scene only the geometry is used, for the guide's stiffness and the size of the pushes, as on a line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Unpack

import numpy as np

from hapsim.errors import UsageError
from hapsim.measuring.converters import Floats
from hapsim.measuring.measure_hands import (
    RUN_UP,
    HandsMeasurement,
    free_motions,
    identify_free_motions,
    mass_of,
)
from hapsim.measuring.measurement_options import (
    Run,
    RunOptions,
    force_limit,
    require_above_zero,
    require_device_point,
)
from hapsim.measuring.place import Place
from hapsim.measuring.pushes import pushes, recorded
from hapsim.one_thread import one_thread
from hapsim.prediction.plane import Plane
from hapsim.recording.trace import Trace
from hapsim.running.run import run_to_end
from hapsim.running.session_options import Excitation, Guide
from hapsim.scene import DevicePoint, Scene
from hapsim.scene.load import SceneSource, as_scene

_SECONDS, _PUSHES = 4.0, 4  # along each coordinate
_MOST_RUNS = 3  # along each coordinate
_MOST_ROOM = 0.01  # m
_WITHIN = 0.45  # of the room: the largest motion
_FLAT, _COUNTS = 1e-3, 1000.0  # of the room, and counts: a motion that hardly bends, and one that rounding hardly shows
_AT_REST = 64  # samples before the first push
_GROWS = (0.003, 0.1)  # of the room: between these distances a hand that slides off is observed


@dataclass(frozen=True)
class _Place:
    """A place of a hand in the plane, SI units.

    Attributes:
        room: distance to where a link changes its state, or much of its direction.
        along: the place by each coordinate, as on a line.
        guide: leads the hand there.
    """

    at: tuple[float, float]
    words: str
    room: float
    along: tuple[Place, Place]
    guide: Guide


def measure_in_plane(
    scene: SceneSource,
    *,
    channel: int = 0,
    at: tuple[float, float] | None = None,
    duration: float | None = None,
    push: float | None = None,
    run: Run = run_to_end,
    **options: Unpack[RunOptions],
) -> HandsMeasurement:
    """Identifies the stiffness and damping matrices (2, 2) that the hand with this channel feels at the place `at`.

    `at`: x and y in m, from the scene's position 0 [default: where the hand starts]. The hand is led there along a
    straight path, and a constant force then holds it. `duration`: seconds of the pushes along each coordinate [default:
    4]; `push`: largest force, N [default: so much that the hand moves a little; up to 3 runs along each coordinate].
    Raises UsageError if no link acts there, or if the hand slides off: the message says how fast. The rest is as for
    `measure`.
    """
    scene, run = as_scene(scene), partial(run, **options)
    require_device_point(scene, channel)
    require_above_zero("seconds", duration=duration)
    require_above_zero(scene.units_of(channel).name("newton"), push=push)
    hand = next(group for group in scene.channel_groups if channel in group)
    place, seconds = _place_of(scene, hand, at), _SECONDS if duration is None else duration
    swing = _wanted(place, scene.mock_device.quantum[channel])
    for tried in range(_MOST_RUNS):
        rung = [_ring(scene, run, place, i, seconds, push, swing) for i in range(len(hand))]
        moved, wanted = max(one.moved for one in rung), _wanted(place, float(rung[0].trace.position_scale[channel]))
        if push is not None or 0.3 * wanted <= moved <= max(3.0 * wanted, 0.0) or tried + 1 == _MOST_RUNS:
            break
        swing *= wanted / max(moved, 1e-3 * wanted)
    if moved > place.room:
        raise UsageError(f"{place.words}, a push moved the hand by {scene.units(moved, 'm', 3)}: push less (--push)")
    segments, traces = [one for each in rung for one in each.segments], tuple(one.trace for one in rung)
    with one_thread():
        identify = partial(identify_free_motions, segments, mass_of(scene, hand), scene.rate)
        try:
            found = identify(True, hand, traces)
        except UsageError:  # a direction in which nothing holds the hand has no place of rest
            found = identify(False, hand, traces)
    return replace(found, at_m=place.at)


def _wanted(place: _Place, count_m: float) -> float:
    """Returns the motion to push for, m."""
    return min(_WITHIN * place.room, max(_FLAT * place.room, _COUNTS * count_m))


@dataclass(frozen=True)
class _Rung:
    """A run with pushes along one coordinate: its free motions (samples, 2) from the place of rest, m."""

    trace: Trace
    segments: list[Floats]
    moved: float


def _ring(scene: Scene, run: Run, place: _Place, axis: int, seconds: float, push: float | None, swing: float) -> _Rung:
    """Leads the hand to its place, and pushes it along one coordinate."""
    own, other = place.along[axis], place.along[1 - axis]
    every = int(seconds * scene.rate) // _PUSHES
    guide = replace(place.guide, target=own.at, also=((other.channel, other.at),))
    pushed = pushes(scene, own.channel, seconds, push, own, swing)
    excitation: Excitation = replace(pushed, start=0, every=every, first=False, guide=guide)
    trace, failure = recorded(run, scene, excitation, seconds)
    guided, channels = excitation.ticks_before(scene.rate), [one.channel for one in place.along]
    for one in place.along:
        one.require_arrival(
            trace.position[: guided - guide.ticks(scene.rate)[-1], one.channel],
            float(trace.position_scale[one.channel]),
        )
    rest = trace.position[guided - _AT_REST : guided, channels].mean(axis=0)
    trace = trace.since(guided)
    away = trace.position[:, channels] - rest
    _require_held(scene, place, away)
    if failure is not None:
        raise failure
    begins = np.arange(guided, trace.sample[-1], every)
    quiet = excitation.ticks + RUN_UP + math.ceil(scene.device.delay)
    segments = free_motions(trace, begins + quiet, begins + every, channels)
    return _Rung(trace, [one - rest for one in segments], float(np.hypot(*away.T).max()))


def _require_held(scene: Scene, place: _Place, away: Floats) -> None:
    """Raises UsageError if the hand slides off its place, with the rate at which its distance grows. `away`: (samples,
    2) from the place, m."""
    far = np.hypot(*away.T)
    if far.max() <= place.room:
        return
    first, last = (int(np.argmax(far > share * place.room)) for share in _GROWS)
    direction = away[last] / far[last]
    step = max(1, (last - first) // 12)
    x = away[first : last + 1] @ direction
    rows = np.stack([x[step:-step], x[: -2 * step], np.ones(max(x.size - 2 * step, 0))], axis=1)
    if len(rows) < 8:
        return
    of_next, of_last, _ = np.linalg.lstsq(rows, x[2 * step :], rcond=None)[0]
    grows = float(max(np.roots([1.0, -of_next, -of_last]).real)) ** (1.0 / step)
    if grows > 1.0:
        angle, time = math.degrees(math.atan2(direction[1], direction[0])) % 180.0, 1.0 / (scene.rate * math.log(grows))
        raise UsageError(
            f"{place.words}, the hand slides off along {angle:.0f}°: its distance grows e-fold in {1e3 * time:.4g} ms "
            f"(a pole of {grows:.6g}), so that no spring is felt there. Give the shape friction (friction_coefficient), "
            "hold the hand by a spring along the surface, or choose a place that is flat or hollow"
        )


def _place_of(scene: Scene, hand: Sequence[int], at: tuple[float, float] | None) -> _Place:
    """Returns the place of the hand on these channels. Raises UsageError if no link acts there, or the force is more
    than the limit."""
    plane, units = Plane(scene), scene.units_of(hand[0])
    modules = scene.modules.items()
    name = next(name for name, one in modules if isinstance(one, DevicePoint) and one.all_channels == tuple(hand))
    here = plane.start[name] if at is None else at
    words = f"at: {units.number(here[0], 'm')},{units(here[1], 'm')}"
    links = [one for one in plane.at({name: here}) if name in one.link.between and one.acts]
    if not links:
        raise UsageError(f"{words}, no link touches the hand, so there is no spring to measure. Choose another --at")
    force, limit = math.hypot(*(float(one) for one in plane.forces(*map(np.array, here), name))), force_limit(scene)
    if force > limit:
        raise UsageError(
            f"{words}, the scene asks for {units(force, 'N', 4)}, more than the force limit of {units(limit, 'N')}. "
            "The force is clipped there, so the hand feels no spring. Choose a place with less force"
        )
    stiffness, damping = np.zeros((2, 2)), np.zeros((2, 2))
    room = _MOST_ROOM
    for one in links:
        n, t = np.array(one.normal), np.array(one.tangent)
        stiffness += one.slope * np.outer(n, n) + one.across * np.outer(t, t)
        damping += one.damping * np.outer(n, n)
        edges = [abs(one.distance - edge) for edge in one.link.law().edges]
        room = min(room, *edges, 1.0 / abs(one.curvature) if one.curvature else math.inf)
    if room < 1e-9:
        raise UsageError(f"{words}, the hand is on the edge of a link; expected a place within or beyond it")
    device, along = scene.device, []
    for i, channel in enumerate(hand):
        mass, friction = device.masses(scene.channels)[channel], device.frictions(scene.channels)[channel]
        own = max(float(stiffness[i, i]), 0.0), friction + float(damping[i, i])
        low, high = here[i] - room, here[i] + room
        along.append(Place(name, channel, here[i], low, high, mass, *own, None, None, units))
    stiffest = replace(along[0], stiffness=float(np.linalg.eigvalsh(stiffness)[1]))
    return _Place(here, words, room, (along[0], along[1]), stiffest.guide(scene))
