"""The links that are no spring and damper: buffer (CORDIS: BUT), link with curves (LNL), dry friction, plectrum.

F pulls the ends together; d: first end minus second end.

**Buffer**, a contact from one side:

    p[n] = distance - d[n]                                  how deep the first end is below the second
    push[n] = max(0, K p[n] + (B/T) (p[n] - p[n-1]))  where p[n] > 0, else 0

The push drives the ends apart: as a tension it is F = -push, which the code works out from d - distance = -p. It never
pulls: a damper would hold back what leaves.

**Curves** for a spring and a damper:

    F[n] = f(d[n]) + g((d[n] - d[n-1])/T)

f and g are straight between the points of their curves, and level beyond the ends. A link has a part for each curve
that it has: `OverDistance` for f, `OverVelocity` for g, which keeps m per sample instead of m/s.

**Dry friction**: a bristle that sticks like a spring, and slides (Hayward and Armstrong 2000; Dahl 1968).

    z[n] = d[n] - w              w: where the bristle is anchored

    sticking:  F[n] = K z[n] + (B/T) (d[n] - d[n-1])    while |K z[n]| <= static; beyond, it slides, s = sign of z[n]
    sliding:   F[n] = s force,   w = d[n] - F[n]/K      until d moves against s: then it sticks about that w

The anchor moves only while it slides, and then with the ends: it does not creep under a force that trembles, which
models without a bound do (drift). At the start the anchor is where the ends are. Which way it slides is kept, so that a
hand that stands still while it slides feels the same force from sample to sample, whatever is rounded; and one sample
may turn it about.

**Plectrum**, a visco-elastic link that releases:

    F[n] = K d[n] + (B/T) (d[n] - d[n-1])  while it grips, else 0

It grips while |d[n]| <= release. Beyond, it releases, and remembers on which side; it grips again at the first sample
where d is 0 or on the other side, unless that is beyond `release` too. At the start it grips if |d| <= release.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import inlined
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Column, Memory, Part, action
from hapsim.cordis.modules.link import Ends, Links, count, ends_of, pull_ends, pull_link, stretch
from hapsim.scene import Buffer, Friction, Nonlinear, Plectrum


class Buffers(NamedTuple):
    """L buffers: K and B/T in N/m, distance in m; shape (L,)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column
    distance: Column


@action
def add_buffer_forces(group, state):
    """Adds the force of every buffer that is touched."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        if not d >= group.distance[i]:  # what is not a number goes on to the guard
            growth = d - stretch(group.ends, i, state.previous)
            tension = group.stiffness[i] * (d - group.distance[i]) + group.damping_per_sample[i] * growth
            if not tension > 0:
                pull_ends(group.ends, i, tension, state.force)


def _buffers(links: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Part:
    return Part(Buffers(ends_of(links, context), *columns), add_forces=add_buffer_forces)


BUFFER = PartType(
    all_of(Buffer),
    _buffers,
    name="buffers",
    compiled_as="gathered through unsigned indices; one comparison each",
    memoryless=True,
)


class Curves(NamedTuple):
    """L curves, one behind the other: where their points stand (m) and what they are there (N).

    `begin`: curve i has the points from begin[i] to before begin[i + 1]; shape (L + 1,).
    """

    begin: NDArray[np.uint64]
    at: Column
    tension: Column


class OverDistance(NamedTuple):
    """L links and their curves over d in m."""

    ends: Ends
    curves: Curves


class OverVelocity(NamedTuple):
    """L links and their curves over what d grows in a sample, in m."""

    ends: Ends
    curves: Curves


@inlined
def curve_at(curves, i, x):
    """Curve i at `x` m. What is not a number comes out as such: no comparison holds for it."""
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
def add_distance_forces(group, state):
    """Adds what every link does for the distance of its ends."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        pull_ends(group.ends, i, curve_at(group.curves, i, d), state.force)


@action
def add_velocity_forces(group, state):
    """Adds what every link does for how fast its ends part."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        growth = stretch(group.ends, i, state.position) - stretch(group.ends, i, state.previous)
        pull_ends(group.ends, i, curve_at(group.curves, i, growth), state.force)


def _curves(curves: Sequence[Sequence[tuple[float, float]] | None], unit: float, context: BuildContext) -> Curves:
    """These curves, whose abscissae are in `unit` metres."""
    points = [np.array(curve, np.float64) for curve in curves]
    begin = np.cumsum([0, *(len(curve) for curve in points)]).astype(np.uint64)
    together = np.concatenate(points)
    at, tension = (together[:, 0] * unit).astype(context.real), together[:, 1].astype(context.real)
    return Curves(begin, at, tension)


def _over_distance(links: Mapping[str, Nonlinear], _columns: Sequence[Column], context: BuildContext) -> Part:
    curves = _curves([one.force_over_distance for one in links.values()], 1.0, context)
    return Part(OverDistance(ends_of(links, context), curves), add_forces=add_distance_forces)


def _over_velocity(links: Mapping[str, Nonlinear], _columns: Sequence[Column], context: BuildContext) -> Part:
    curves = _curves([one.force_over_velocity for one in links.values()], 1.0 / context.rate, context)
    return Part(OverVelocity(ends_of(links, context), curves), add_forces=add_velocity_forces)


NONLINEAR_SPRING = PartType(
    all_of(Nonlinear, lambda link: link.force_over_distance is not None),
    _over_distance,
    name="forces over distance",
    compiled_as="gathered through unsigned indices; a search by halves in each table",
    memoryless=True,
)
NONLINEAR_DAMPER = PartType(
    all_of(Nonlinear, lambda link: link.force_over_velocity is not None),
    _over_velocity,
    name="forces over velocity",
    compiled_as="gathered through unsigned indices; a search by halves in each table",
    memoryless=True,
)


class Frictions(NamedTuple):
    """L links: force and static in N, K and B/T in N/m, anchor w in m; shape (L,).

    `sliding`: 1 or -1, which way, or 0 where it sticks.
    """

    ends: Ends
    force: Column
    static: Column
    stiffness: Column
    damping_per_sample: Column
    anchor: Column
    sliding: Column


@action
def initialize_friction(group, state):
    """No bristle is bent."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        group.anchor[i] = stretch(group.ends, i, state.position)


@action
def add_friction_forces(group, state):
    """Adds the force of every link."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        growth = d - stretch(group.ends, i, state.previous)
        if not group.sliding[i] * growth >= 0:  # what is not a number sticks, and goes on to the guard
            group.sliding[i] = 0
        bent = group.stiffness[i] * (d - group.anchor[i])
        if group.sliding[i] == 0 and abs(bent) > group.static[i]:
            group.sliding[i] = 1 if bent > 0 else -1
        tension = bent + group.damping_per_sample[i] * growth
        if group.sliding[i] != 0:
            tension = group.sliding[i] * group.force[i]
            group.anchor[i] = d - tension / group.stiffness[i]
        pull_ends(group.ends, i, tension, state.force)


def _frictions(links: Mapping[str, Friction], columns: Sequence[Column], context: BuildContext) -> Part:
    anchor, sliding = np.zeros((2, len(links)), context.real)
    force, static, stiffness, damping = columns
    numbers = Frictions(ends_of(links, context), force, static, stiffness, damping, anchor, sliding)
    memory = Memory(tuple(links), (anchor, sliding))
    return Part(numbers, initialize=initialize_friction, add_forces=add_friction_forces, memory=memory)


FRICTION = PartType(
    all_of(Friction),
    _frictions,
    name="friction links",
    compiled_as="gathered through unsigned indices; an anchor and a direction each",
)


class Plectra(NamedTuple):
    """L plectra; `release`: m, shape (L,). `side`: 1 or -1, on which side it released, or 0 where it grips."""

    links: Links
    release: Column
    side: Column


@action
def add_plectrum_forces(group, state):
    """Adds the force of every link that grips."""
    group, state = value_of(group), value_of(state)
    ends = group.links.ends
    for i in range(count(ends)):
        d = stretch(ends, i, state.position)
        if not group.side[i] * d > 0:  # it grips, or its ends have met; what is not a number goes on to the guard
            if abs(d) > group.release[i]:
                group.side[i] = 1 if d > 0 else -1
            else:
                group.side[i] = 0
                pull_link(group.links, i, d, d - stretch(ends, i, state.previous), state.force)


def _plectra(plectra: Mapping[str, Plectrum], columns: Sequence[Column], context: BuildContext) -> Part:
    stiffness, damping, release = columns
    links = Links(ends_of(plectra, context), stiffness, damping)
    side = np.zeros(len(plectra), context.real)
    return Part(Plectra(links, release, side), add_forces=add_plectrum_forces, memory=Memory(tuple(plectra), (side,)))


PLECTRUM = PartType(
    all_of(Plectrum),
    _plectra,
    name="plectra",
    compiled_as="gathered through unsigned indices; a grip each",
)
