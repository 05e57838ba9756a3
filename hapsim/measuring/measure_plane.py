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
    HandsMeasurement,
    free_motions,
    identify_free_motions,
    mass_of,
)
from hapsim.measuring.measurement_options import Run, RunOptions, force_limit, require_pushable
from hapsim.measuring.place import Place
from hapsim.measuring.pushes import pushes, recorded
from hapsim.one_thread import one_thread
from hapsim.prediction.plane_geometry import Plane, PlaneLink
from hapsim.recording.trace import Trace
from hapsim.running.motors import as_limited
from hapsim.running.run import run_to_end
from hapsim.running.session_options import Excitation, Guide
from hapsim.scene import DevicePoint, Scene
from hapsim.scene.input_states import with_mock_inputs_on
from hapsim.scene.load import SceneSource, as_scene

_SECONDS, _IN_VIRTUAL_TIME, _EVERY_S = 4.0, 10.0, 0.4  # of pushes along each coordinate, and from one to the next
_MOST_RUNS = 3  # along each coordinate
_MOST_ROOM = 0.01  # m
_WITHIN, _ABOUT = 0.45, (0.5, 3.0)  # of the room: the largest motion; and of the wanted one, those that do
_STRAIGHT, _BENT = 0.1, 1e-3  # of the room, and of the radius at which a link turns: the motion that is wanted
_COUNTS = 4000.0  # a motion in which rounding hardly shows
_SETTLES = 8.0  # times as long as on a line: what is felt along a surface is as far off as the depth of the press
_EDGE = 1e-9  # m: a shorter way is none
_AT_REST = 64  # samples before the first push
_GROWS = (0.003, 0.1)  # of the room: between these distances a hand that slides off is observed


@dataclass(frozen=True)
class _Place:
    """A place of a hand in the plane, SI units.

    Attributes:
        room: distance to where a link changes its state, or much of its direction.
        swing: a motion that hardly changes any direction.
        along: the place by each coordinate, as on a line.
        guide: leads the hand there.
        beyond: overshoot of its path by coordinate, m, in the direction of the path; then back, so that friction sticks
            without a bent bristle.
    """

    at: tuple[float, float]
    words: str
    room: float
    swing: float
    along: tuple[Place, Place]
    guide: Guide
    beyond: tuple[float, float]


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
    4, or 10 in virtual time]; `push`: largest force, N [default: so much that the hand moves a little; up to 3 runs
    along each coordinate].
    Raises UsageError if no link acts there, or if the hand slides off: the message says how fast. The rest is as for
    `measure`.
    """
    scene = with_mock_inputs_on(as_scene(scene))
    require_pushable(scene, [channel], duration, push)
    hand = scene.hand_of(channel)
    _require_alone(scene, hand)
    scene, run = as_limited(scene, hand, push, run, options)
    place = _place_of(scene, hand, at)
    seconds = duration or (_IN_VIRTUAL_TIME if scene.device.clock == "lockstep" else _SECONDS)
    rung = [_rung(scene, run, place, axis, seconds, push) for axis in range(len(hand))]
    segments, traces = [one for each in rung for one in each.segments], tuple(one.trace for one in rung)
    with one_thread():
        identify = partial(identify_free_motions, segments, mass_of(scene, hand), scene.rate)
        try:
            found = identify(True, hand, traces)
        except UsageError:  # a direction in which nothing holds the hand has no place of rest
            found = identify(False, hand, traces)
    return replace(found, at_m=place.at)


@dataclass(frozen=True)
class _Rung:
    """A run with pushes along one coordinate: its free motions (samples, 2) from the place of rest, m."""

    trace: Trace
    segments: list[Floats]
    moved: float


def _rung(scene: Scene, run: Run, place: _Place, axis: int, seconds: float, push: float | None) -> _Rung:
    """Returns the first run in which the hand moved by about as much as is wanted, or the last."""
    channel, most = place.along[axis].channel, _WITHIN * place.room
    swing = min(most, max(place.swing, _COUNTS * scene.mock_device.quantum[channel]))
    for _ in range(_MOST_RUNS):
        found = _ring(scene, run, place, axis, seconds, push, swing)
        wanted = min(most, max(place.swing, _COUNTS * float(found.trace.position_scale[channel])))
        if push is not None or _ABOUT[0] * wanted <= found.moved <= _ABOUT[1] * wanted:
            break
        swing *= wanted / max(found.moved, 1e-3 * wanted)
    if found.moved > place.room:
        moved = scene.units_of(channel)(found.moved, "m", 3)
        raise UsageError(f"{place.words}, a push moved the hand by {moved}, off its place: push less (--push)")
    return found


def _ring(scene: Scene, run: Run, place: _Place, axis: int, seconds: float, push: float | None, swing: float) -> _Rung:
    """Leads the hand to its place, and pushes it along one coordinate."""
    own, other = place.along[axis], place.along[1 - axis]
    every = int(min(_EVERY_S, seconds) * scene.rate)
    also = ((other.channel, other.at, place.beyond[1 - axis]),)
    guide = replace(place.guide, target=own.at, beyond=place.beyond[axis], also=also)
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
    segments = free_motions(trace, excitation, scene.device.delay, channels, guided)
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
            f"(a pole of {grows:.6g}), so no spring is felt there. If dry friction should hold it, push less (--push). "
            "Otherwise add friction (friction_coefficient) or a spring along the surface, or choose another place"
        )


def _require_alone(scene: Scene, hand: Sequence[int]) -> None:
    """Raises UsageError if links join this hand with another one, which would move too."""
    hands = {name: one.all_channels for name, one in scene.modules.items() if isinstance(one, DevicePoint)}
    moving = {name for name, one in scene.modules.items() if one.can_move}
    joined = {name for name, channels in hands.items() if channels == tuple(hand)}
    for _ in scene.plane_links:
        for link in scene.plane_links.values():
            if joined & {*link.between}:
                joined |= moving & {*link.between}
    if others := [name for name in hands if name in joined and hands[name] != tuple(hand)]:
        raise UsageError(
            f"measure: found links that join the hand with {' and '.join(others)}, which would move too; "
            "expected a hand that is joined with no other. `hapsim check --at X,Y` predicts both"
        )


def _place_of(scene: Scene, hand: Sequence[int], at: tuple[float, float] | None) -> _Place:
    """Returns the place of the hand on these channels. Raises UsageError if no link acts there, or the force is more
    than the limit."""
    plane, units = Plane(scene), scene.units_of(hand[0])
    name = scene.hand_on(hand[0])
    here = plane.start[name] if at is None else at
    words = f"at: {units.number(here[0], 'm')},{units(here[1], 'm')}"
    links = [one for one in plane.at({name: here}) if name in one.link.between and one.acts]
    if not links:
        raise UsageError(f"{words}, no link touches the hand, so there is no spring to measure. Choose another --at")
    x, y = (np.array(one) for one in here)
    force, limit = float(np.hypot(*plane.forces(x, y, name))), force_limit(scene)
    if force > limit:
        raise UsageError(
            f"{words}, the scene asks for {units(force, 'N', 4)}, more than the force limit of {units(limit, 'N')}. "
            "The force is clipped there, so the hand feels no spring. Choose a place with less force"
        )
    if blocked := plane.in_the_way(name, here):
        raise UsageError(
            f"{words}, {blocked} is in the way: the hand is led there along a straight line from where it starts. "
            "Choose a place on this side, or let the hand start on that one (mock.initial.position)"
        )
    stiffness, damping, beyond = np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2)
    room, swing = _MOST_ROOM, _STRAIGHT * _MOST_ROOM
    for one in links:
        for row in one.rows():
            both = np.outer(row.pull, row.stretch)
            stiffness, damping = stiffness + row.stiffness * both, damping + row.damping * both
        beyond += _overshoot(one, np.subtract(here, plane.start[name]))
        law = one.link.law()
        is_one_spring = law.memoryless and law.sector[0] == law.sector[1] and len(set(law.dampings)) == 1
        edges = () if is_one_spring else law.edges
        bends = [1.0 / abs(one.curvature)] if one.curvature and math.isfinite(one.curvature) else []
        room = min([room, *bends, *(abs(one.distance - edge) for edge in edges)])
        swing = min([swing, _STRAIGHT * room, *(_BENT * bend for bend in bends)])
    if room < _EDGE:
        raise UsageError(f"{words}, the hand is on the edge of a link; expected a place within or beyond it")
    device, along = scene.device, []
    for i, channel in enumerate(hand):
        mass, friction = device.masses(scene.channels)[channel], device.frictions(scene.channels)[channel]
        own = max(float(stiffness[i, i]), 0.0), friction + float(damping[i, i])
        low, high = here[i] - room, here[i] + room
        along.append(Place(name, channel, here[i], low, high, mass, *own, None, None, units))
    guide = replace(along[0], stiffness=float(np.linalg.eigvalsh(stiffness)[1])).guide(scene)
    way, settling, mean, fade = guide.seconds
    guide = replace(guide, seconds=(way, _SETTLES * settling, mean, fade))
    along_path = np.where(np.subtract(here, plane.start[name]) < 0.0, -beyond, beyond).tolist()
    return _Place(here, words, room, swing, (along[0], along[1]), guide, (along_path[0], along_path[1]))


def _overshoot(link: PlaneLink, path: Floats) -> Floats:
    """Returns how far beyond its place, m, a hand that comes along this path bends the bristle of a link until it
    slides."""
    if math.isfinite(reach := link.link.law().reach):
        return path * reach / max(float(np.hypot(*path)), 1e-300)
    if not link.rubs:
        return np.zeros(2)
    bent, t = link.link.break_away * abs(link.tension) / link.link.bristle[0], np.array(link.tangent)
    along = float(path @ t)
    return math.copysign(bent, along) * t if abs(along) > _EDGE else np.zeros(2)
