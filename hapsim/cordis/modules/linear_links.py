"""The links of a spring and a damper: the visco-elastic link (CORDIS: REF), the spring (RES), the damper (FRO).

A damper is a visco-elastic link with K = 0. The damper's type defines g of `link.py`, the growth of d in a sample.
Each is the recurrence of the transfer function with the same name in `hapsim.theory`:

    backward   g[n] = d[n] - d[n-1]                                (Florens et al., §6)
    centred    g[n] = (d[n] - d[n-2])/2
    filtered   g[n] = k g[n-1] + (1 - k) (d[n] - d[n-1])           k = exp(-2 pi cutoff T)
    sensed     g[n] = T v[n], with v measured by the device; at an end that is no device point, backward
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hapsim.compiling import inlined
from hapsim.compiling.native import NativeFunction, value_of
from hapsim.cordis.build_context import BatchType
from hapsim.cordis.dispatch import Column, action, fma_action
from hapsim.cordis.line_query import add_spring_and_damper
from hapsim.cordis.modules.link import Ends, Links, count, link_type, pull_ends, pull_link, stretch
from hapsim.scene import Damper, Spring, ViscoElastic


class Springs(NamedTuple):
    """L springs: K in N/m, shape (L,)."""

    ends: Ends
    stiffness: Column


class DampedLinks(NamedTuple):
    """L links, shape (L,). `constant`: k of a filtered damper. `remembered`, in m: g of the last tick (filtered) or
    d two samples before the next one (centred)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column
    constant: Column
    remembered: Column


class SensedLinks(NamedTuple):
    """L links; `period`: T in s, shape (L,)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column
    period: Column


@fma_action
def add_forces(links, state):
    """Adds the force of every link with a backward damper."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        d = stretch(links.ends, i, state.position)
        pull_link(links, i, d, d - stretch(links.ends, i, state.previous), state.force)


class ScaledLinks(NamedTuple):
    """L links with a scale between two hands (`scene/scaled_links.py`), shape (L,). `in_stretch`, `in_pull`: weights of
    the second end."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column
    in_stretch: Column
    in_pull: Column


@fma_action
def add_scaled_forces(links, state):
    """Adds the force of every link with a scale."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        first, second, ratio = links.ends.first[i], links.ends.second[i], links.in_stretch[i]
        d = state.position[first] - ratio * state.position[second]
        growth = d - (state.previous[first] - ratio * state.previous[second])
        tension = links.stiffness[i] * d + links.damping_per_sample[i] * growth
        state.force[first] -= tension
        state.force[second] += links.in_pull[i] * tension


@fma_action
def add_spring_forces(springs, state):
    """Adds the force of every spring. Separate, because reading the earlier positions costs a quarter of the time."""
    springs, state = value_of(springs), value_of(state)
    for i in range(count(springs.ends)):
        pull_ends(springs.ends, i, springs.stiffness[i] * stretch(springs.ends, i, state.position), state.force)


@action
def add_to_line(held, query):
    """Adds every link of a hand with a backward damper to the line of that hand."""
    held, query = value_of(held), value_of(query)
    links = held.links
    for j in range(np.uint64(held.held.size)):
        i = held.held[j]
        add_spring_and_damper(query, links.ends, i, links.stiffness[i], links.damping_per_sample[i])


@action
def add_springs_to_line(held, query):
    """Adds every spring of a hand to its line."""
    held, query = value_of(held), value_of(query)
    for j in range(np.uint64(held.held.size)):
        i = held.held[j]
        add_spring_and_damper(query, held.links.ends, i, held.links.stiffness[i], 0.0)


@action
def initialize_centred(links, state):
    """Sets the memory as if every point had moved so far at its present velocity."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        before = stretch(links.ends, i, state.previous)
        links.remembered[i] = before + (before - stretch(links.ends, i, state.position))


@action
def initialize_filtered(links, state):
    """Sets the memory as if every point had moved so far at its present velocity."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        links.remembered[i] = stretch(links.ends, i, state.position) - stretch(links.ends, i, state.previous)


@fma_action
def add_centred_forces(links, state):
    """Adds the force of every link with a centred damper."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        d = stretch(links.ends, i, state.position)
        growth = np.float32(0.5) * (d - links.remembered[i])  # exact in either precision, and keeps either
        pull_link(links, i, d, growth, state.force)
        links.remembered[i] = stretch(links.ends, i, state.previous)


@fma_action
def add_filtered_forces(links, state):
    """Adds the force of every link with a filtered damper."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        d = stretch(links.ends, i, state.position)
        newest = d - stretch(links.ends, i, state.previous)
        links.remembered[i] = newest + links.constant[i] * (links.remembered[i] - newest)
        pull_link(links, i, d, links.remembered[i], state.force)


@fma_action
def add_sensed_forces(links, state):
    """Adds the force of every link with a sensed damper."""
    links, state = value_of(links), value_of(state)
    ends, period = links.ends, links.period[0]
    for i in range(count(ends)):
        growth = _step(ends.first[i], period, state) - _step(ends.second[i], period, state)
        pull_link(links, i, stretch(ends, i, state.position), growth, state.force)


@inlined
def _step(point, period, state):
    """Returns a point's step in a sample period, m: by the sensor for device points, which come first."""
    if point < state.velocity.size:
        return state.position.dtype.type(period * state.velocity[point])
    return state.position[point] - state.previous[point]


def damped_type(
    damper: str,
    compiled_as: str,
    add_forces: NativeFunction,
    constant: Callable[[Any, float], float],
    initialize: NativeFunction | None = None,
) -> BatchType:
    """Returns the type of links with another damper. `constant`: of a link at a rate in Hz; `initialize`: a memory."""
    return link_type(
        ViscoElastic,
        DampedLinks if initialize else SensedLinks,
        add_forces,
        f"visco-elastic links ({damper} damper)",
        compiled_as,
        where=lambda link: link.damper == damper,
        constants=lambda links, context: (context.column([constant(link, context.rate) for link in links]),),
        remembers=1 if initialize else 0,
        initialize=initialize,
    )


VISCOELASTIC = link_type(
    ViscoElastic,
    Links,
    add_forces,
    "visco-elastic links",
    where=lambda link: link.damper == "backward" and not link.scale,
    line=add_to_line,
)
CENTRED = damped_type("centred", "one remembered stretch each", add_centred_forces, lambda *_: 0.0, initialize_centred)
FILTERED = damped_type(
    "filtered",
    "one remembered velocity each",
    add_filtered_forces,
    lambda link, rate: float(np.exp(-2.0 * np.pi * np.float64(link.cutoff) / rate)),  # k
    initialize_filtered,
)
SENSED = damped_type("sensed", "velocities come from the device", add_sensed_forces, lambda _, rate: 1.0 / rate)
SPRING = link_type(Spring, Springs, add_spring_forces, "springs", line=add_springs_to_line)
DAMPER = link_type(
    Damper,
    lambda ends, damping: Links(ends, np.zeros_like(damping), damping),
    add_forces,
    "dampers",
    line=add_to_line,
)
SCALED = link_type(
    ViscoElastic,
    ScaledLinks,
    add_scaled_forces,
    "visco-elastic links with a scale",
    where=lambda link: link.scale,
    constants=lambda links, context: tuple(context.column([one.second_scale for one in links]).T.copy()),
)
