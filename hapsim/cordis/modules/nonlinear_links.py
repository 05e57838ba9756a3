"""The links that are no spring and damper: buffer (CORDIS: BUT), link with curves (LNL), dry friction, plectrum,
detent, click.

Their recurrences, and why, are in MODULES.md. A comparison decides so that a tension that is not a number (NaN) is
passed on: the guard then ends the run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import inlined
from hapsim.compiling.native import NativeFunction, value_of
from hapsim.cordis.build_context import BuildContext, PartType
from hapsim.cordis.dispatch import Column, action
from hapsim.cordis.modules.link import Ends, count, link_type, pull_ends, pull_link, stretch
from hapsim.scene import Buffer, Click, Detent, Friction, Nonlinear, Plectrum
from hapsim.scene.choices import DetentShape

_SHAPES = get_args(DetentShape)
_SINE, _SNAP = _SHAPES.index("sine"), _SHAPES.index("snap")


class Buffers(NamedTuple):
    """L buffers: K and B/T in N/m, distance in m; shape (L,)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column
    distance: Column


class Curves(NamedTuple):
    """L links and their curves, one behind the other: where their points stand (m) and the tension there (N).

    `begin`: curve i has the points from begin[i] to before begin[i + 1]; shape (L + 1,).
    """

    ends: Ends
    begin: NDArray[np.uint64]
    at: Column
    tension: Column


class Frictions(NamedTuple):
    """L links: force and static in N, K and B/T in N/m, anchor in m; shape (L,).

    `sliding`: 1 or -1, which way, or 0 where it sticks.
    """

    ends: Ends
    force: Column
    static: Column
    stiffness: Column
    damping_per_sample: Column
    anchor: Column
    sliding: Column


class Plectra(NamedTuple):
    """L plectra: K and B/T in N/m, `release` in m; shape (L,).

    `side`: 1 or -1, on which side it released, or 0 where it grips.
    """

    ends: Ends
    stiffness: Column
    damping_per_sample: Column
    release: Column
    side: Column


class Detents(NamedTuple):
    """L detents: pitch in m, depth in N, B/T in N/m, sharpness, and the number of its shape; shape (L,)."""

    ends: Ends
    pitch: Column
    depth: Column
    damping_per_sample: Column
    sharpness: Column
    shape: NDArray[np.uint8]


class Clicks(NamedTuple):
    """L clicks: travel in m, peak and drop in N, bottom and B/T in N/m; shape (L,)."""

    ends: Ends
    travel: Column
    peak: Column
    drop: Column
    bottom: Column
    damping_per_sample: Column


@action
def add_buffer_forces(group, state):
    """Adds the force of every buffer that is touched; it never pulls: a damper would hold back what leaves."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        if not d >= group.distance[i]:
            growth = d - stretch(group.ends, i, state.previous)
            tension = group.stiffness[i] * (d - group.distance[i]) + group.damping_per_sample[i] * growth
            if not tension > 0:
                pull_ends(group.ends, i, tension, state.force)


@action
def add_distance_forces(group, state):
    """Adds what every link does for the distance of its ends."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        pull_ends(group.ends, i, curve_at(group, i, d), state.force)


@action
def add_velocity_forces(group, state):
    """Adds what every link does for how fast its ends part."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        growth = stretch(group.ends, i, state.position) - stretch(group.ends, i, state.previous)
        pull_ends(group.ends, i, curve_at(group, i, growth), state.force)


@inlined
def curve_at(curves, i, x):
    """Curve i at `x` m: straight between its points, level beyond the ends; NaN for NaN."""
    low, high = curves.begin[i], curves.begin[i + 1] - np.uint64(1)
    if x <= curves.at[low]:
        return curves.tension[low]
    if x >= curves.at[high]:
        return curves.tension[high]
    while high - low > np.uint64(1):
        middle = (low + high) >> np.uint64(1)
        if x < curves.at[middle]:
            high = middle
        else:
            low = middle
    share = (x - curves.at[low]) / (curves.at[high] - curves.at[low])
    return curves.tension[low] + share * (curves.tension[high] - curves.tension[low])


@action
def initialize_friction(group, state):
    """No bristle is bent."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        group.anchor[i] = stretch(group.ends, i, state.position)


@action
def add_friction_forces(group, state):
    """Adds the force of every friction link. It keeps which way it slides, so that a hand that stands still feels the
    same force from sample to sample, whatever is rounded."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        growth = d - stretch(group.ends, i, state.previous)
        if not group.sliding[i] * growth >= 0:
            group.sliding[i] = 0
        bent = group.stiffness[i] * (d - group.anchor[i])
        if group.sliding[i] == 0 and abs(bent) > group.static[i]:
            group.sliding[i] = 1 if bent > 0 else -1
        tension = bent + group.damping_per_sample[i] * growth
        if group.sliding[i] != 0:
            tension = group.sliding[i] * group.force[i]
            group.anchor[i] = d - tension / group.stiffness[i]
        pull_ends(group.ends, i, tension, state.force)


@action
def add_plectrum_forces(group, state):
    """Adds the force of every plectrum that grips."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        if not group.side[i] * d > 0:  # it grips, or its ends have met
            if abs(d) > group.release[i]:
                group.side[i] = 1 if d > 0 else -1
            else:
                group.side[i] = 0
                pull_link(group, i, d, d - stretch(group.ends, i, state.previous), state.force)


@action
def add_detent_forces(group, state):
    """Adds the force of every detent."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        growth = d - stretch(group.ends, i, state.previous)
        tension = _detent_tension(group, i, d) + group.damping_per_sample[i] * growth
        pull_ends(group.ends, i, tension, state.force)


@inlined
def _detent_tension(group, i, d):
    """Detent i's tension at `d` m without its damper: from the nearest rest up over `rise`, down to 0 at `end`."""
    real = group.pitch.dtype.type
    pitch, depth, half = group.pitch[i], group.depth[i], real(0.5)
    u = d - pitch * np.floor(d / pitch + half)
    if group.shape[i] == _SINE:
        return depth * math.sin(real(2.0 * math.pi) * u / pitch)
    if group.shape[i] == _SNAP:
        end = half * pitch
        rise = end * group.sharpness[i] / (group.sharpness[i] + real(1.0))
    else:
        end = half * pitch / group.sharpness[i]
        rise = half * end
    away = abs(u)
    if away >= end:
        return real(0.0)
    force = depth * ((end - away) / (end - rise) if away > rise else away / rise)
    return force if u > 0 else -force


@action
def add_click_forces(group, state):
    """Adds the force of every click that is pressed; it pulls no more than its curve does: a damper would hold back
    what leaves."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        if not d >= 0:
            growth = d - stretch(group.ends, i, state.previous)
            push = _click_push(group, i, -d) - group.damping_per_sample[i] * growth
            most_pull = min(group.peak[i] - group.drop[i], group.peak.dtype.type(0))
            push = max(push, most_pull)  # the first where it is NaN
            pull_ends(group.ends, i, -push, state.force)


@inlined
def _click_push(group, i, pressed):
    """What click i pushes back with without its damper, pressed by so much, m."""
    quarter = group.travel.dtype.type(0.25) * group.travel[i]
    peak, drop, rises_over = group.peak[i], group.drop[i], quarter + quarter
    if pressed <= rises_over:
        return peak * pressed / rises_over
    if pressed <= rises_over + quarter:
        return peak - drop * (pressed - rises_over) / quarter
    if pressed <= group.travel[i]:
        return peak - drop + peak * (pressed - rises_over - quarter) / rises_over
    return peak - drop + peak * quarter / rises_over + group.bottom[i] * (pressed - group.travel[i])


def _shapes(detents: Iterable[Any], _context: BuildContext) -> tuple[NDArray[np.uint8]]:
    return (np.array([_SHAPES.index(detent.shape) for detent in detents], np.uint8),)


def _curves(field: str, add_forces: NativeFunction, name: str, unit: Callable[[float], float]) -> PartType:
    """The links with this curve, whose abscissae are in `unit` metres at a rate in Hz."""

    def constants(links: Iterable[Any], context: BuildContext) -> tuple[Any, ...]:
        points = [np.array(getattr(link, field), np.float64) for link in links]
        begin = np.cumsum([0, *map(len, points)]).astype(np.uint64)
        at, tension = np.concatenate(points).T
        return begin, context.column(at * unit(context.rate)), context.column(tension)

    def has_curve(link: Nonlinear) -> bool:
        return getattr(link, field) is not None

    words = "a search by halves in each table"
    return link_type(Nonlinear, Curves, add_forces, name, words, where=has_curve, constants=constants)


BUFFER = link_type(Buffer, Buffers, add_buffer_forces, "buffers", "one comparison each")
NONLINEAR_SPRING = _curves("force_over_distance", add_distance_forces, "forces over distance", lambda _: 1.0)
NONLINEAR_DAMPER = _curves("force_over_velocity", add_velocity_forces, "forces over velocity", lambda rate: 1.0 / rate)
FRICTION = link_type(
    Friction,
    Frictions,
    add_friction_forces,
    "friction links",
    "an anchor and a direction each",
    remembers=2,
    initialize=initialize_friction,
)
PLECTRUM = link_type(Plectrum, Plectra, add_plectrum_forces, "plectra", "a grip each", remembers=1)
DETENT = link_type(Detent, Detents, add_detent_forces, "detents", "the nearest rest each", constants=_shapes)
CLICK = link_type(Click, Clicks, add_click_forces, "clicks", "up to four comparisons each")

TYPES = (BUFFER, NONLINEAR_SPRING, NONLINEAR_DAMPER, FRICTION, PLECTRUM, DETENT, CLICK)
