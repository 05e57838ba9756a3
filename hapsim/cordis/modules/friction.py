"""Dry friction: a bristle that sticks like a spring, and slides (Hayward and Armstrong 2000; Dahl 1968).

    z[n] = d[n] - w              d: first end minus second end; w: where the bristle is anchored

    sticking:  F[n] = K z[n] + (B/T) (d[n] - d[n-1])    while |K z[n]| <= static; beyond, it slides, s = sign of z[n]
    sliding:   F[n] = s force,   w = d[n] - F[n]/K      until d moves against s: then it sticks about that w

F pulls the ends together. The anchor moves only while it slides, and then with the ends: it does not creep under a
force that trembles, which models without a bound do (drift). At the start the anchor is where the ends are.

Which way it slides is kept, so that a hand that stands still while it slides feels the same force from sample to
sample, whatever is rounded; and one sample may turn it about.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Column, Memory, Part, action
from hapsim.cordis.modules.link import Ends, count, ends_of, pull_ends, stretch
from hapsim.scene import Friction


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
def initialize(group, state):
    """No bristle is bent."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        group.anchor[i] = stretch(group.ends, i, state.position)


@action
def add_forces(group, state):
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


def _build(links: Mapping[str, Friction], columns: Sequence[Column], context: BuildContext) -> Part:
    anchor, sliding = np.zeros((2, len(links)), context.real)
    force, static, stiffness, damping = columns
    numbers = Frictions(ends_of(links, context), force, static, stiffness, damping, anchor, sliding)
    memory = Memory(tuple(links), (anchor, sliding))
    return Part(numbers, initialize=initialize, add_forces=add_forces, memory=memory)


FRICTION = PartType(
    all_of(Friction),
    _build,
    name="friction links",
    compiled_as="gathered through unsigned indices; an anchor and a direction each",
)
