"""The links with a recurrence of their own: dry friction, plectrum and sine detent.

MODULES.md explains their recurrences. Comparisons are written so that a tension that is NaN is passed on: the guard
then ends the run."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hapsim.compiling.native import value_of
from hapsim.cordis.dispatch import Column, action
from hapsim.cordis.line_query import (
    COLLECTS,
    FROM,
    MOST_OF_LINK,
    UNTIL,
    X,
    add_force,
    add_knot,
    add_spring_between,
    far_end,
    side_of,
)
from hapsim.cordis.modules.link import Ends, count, link_type, pull_ends, pull_link, stretch
from hapsim.scene import Detent, Friction, Plectrum

_SLIDING = 1.0 - 1e-6  # of the force while a bristle slides: its edge for the line, off rounding


class Frictions(NamedTuple):
    """L links: force and static in N, K and B/T in N/m, anchor in m; shape (L,). `sliding`: 1 or -1, which way, or 0
    where it sticks."""

    ends: Ends
    force: Column
    static: Column
    stiffness: Column
    damping_per_sample: Column
    anchor: Column
    sliding: Column


class Plectra(NamedTuple):
    """L plectra: K and B/T in N/m, `release` in m; shape (L,). `side`: 1 or -1, on which side it released, or 0 where
    it grips."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column
    release: Column
    side: Column


class Sines(NamedTuple):
    """L sine detents: pitch in m, depth in N, B/T in N/m; shape (L,)."""

    ends: Ends
    pitch: Column
    depth: Column
    damping_per_sample: Column


@action
def initialize_friction(group, state):
    """Sets every anchor so that no bristle is bent."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        group.anchor[i] = stretch(group.ends, i, state.position)


@action
def add_friction_forces(group, state):
    """Adds the force of every friction link. A link keeps its direction of sliding, so that rounding does not change
    the force on a hand that stands still."""
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
def add_frictions_to_line(held, query):
    """Adds every friction link of a hand to its line: the bristle between the two forces at which it slides. While it
    slides, it is bent a little less on that side, so that its edge is behind the hand."""
    held, query = value_of(held), value_of(query)
    links = held.links
    for j in range(np.uint64(held.held.size)):
        i = held.held[j]
        force, static, anchor = np.float64(links.force[i]), np.float64(links.static[i]), np.float64(links.anchor[i])
        spring = np.float64(links.stiffness[i]), np.float64(links.damping_per_sample[i]), anchor
        below = _SLIDING * force if links.sliding[i] < 0 else static
        above = _SLIDING * force if links.sliding[i] > 0 else static
        span = anchor - below / spring[0], anchor + above / spring[0]
        add_spring_between(query, links.ends, i, spring, span, (-force, force))


@action
def add_plectra_to_line(held, query):
    """Adds every plectrum of a hand to its line. One that released has no force on the side where its ends are."""
    held, query = value_of(held), value_of(query)
    links = held.links
    for j in range(np.uint64(held.held.size)):
        i = held.held[j]
        spring = np.float64(links.stiffness[i]), np.float64(links.damping_per_sample[i]), 0.0
        release, side = np.float64(links.release[i]), links.side[i]
        span = 0.0 if side < 0 else -release, 0.0 if side > 0 else release
        add_spring_between(query, links.ends, i, spring, span, (0.0, 0.0))


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
def add_sine_forces(group, state):
    """Adds the force of every sine detent."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        growth = d - stretch(group.ends, i, state.previous)
        real, pitch = group.pitch.dtype.type, group.pitch[i]
        u = d - pitch * np.floor(d / pitch + real(0.5))
        tension = group.depth[i] * math.sin(real(2.0 * math.pi) * u / pitch)
        pull_ends(group.ends, i, tension + group.damping_per_sample[i] * growth, state.force)


@action
def add_sines_to_line(held, query):
    """Adds every sine detent of a hand to its line: its extremes in reach, or its law at the asked place."""
    held, query = value_of(held), value_of(query)
    links, numbers = held.links, query.numbers
    for j in range(np.uint64(held.held.size)):
        i = held.held[j]
        side, pitch = side_of(query, links.ends, i), np.float64(links.pitch[i])
        if side == 0.0:
            continue
        place, way = far_end(query, links.ends, i, side)
        if query.whole[COLLECTS]:
            peak = np.floor(2.0 * (numbers[FROM] - place) / pitch - 0.5)
            last = np.floor(2.0 * (numbers[UNTIL] - place) / pitch - 0.5) + 1.0
            every = 1.0 + 2.0 * np.floor((last - peak) / MOST_OF_LINK)  # odd: a highest one follows a lowest one
            while peak <= last:
                add_knot(query.whole, query.knots, place + 0.5 * pitch * (peak + 0.5))
                peak += every
        else:
            d, turns = side * (numbers[X] - place), 2.0 * math.pi / pitch
            tension, slope = links.depth[i] * math.sin(turns * d), links.depth[i] * turns * math.cos(turns * d)
            add_force(query, side, way, tension, slope, links.damping_per_sample[i], False)


FRICTION = link_type(
    Friction,
    Frictions,
    add_friction_forces,
    "friction links",
    "an anchor and a direction each",
    remembers=2,
    initialize=initialize_friction,
    line=add_frictions_to_line,
)
PLECTRUM = link_type(
    Plectrum, Plectra, add_plectrum_forces, "plectra", "a grip each", remembers=1, line=add_plectra_to_line
)
SINE = link_type(
    Detent,
    lambda ends, pitch, depth, damping, *_of_others: Sines(ends, pitch, depth, damping),
    add_sine_forces,
    "sine detents",
    "the nearest rest each",
    where=lambda detent: detent.shape == "sine" and not detent.is_held,
    line=add_sines_to_line,
)
