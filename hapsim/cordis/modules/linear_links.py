"""The links of a spring and a damper: the visco-elastic link (CORDIS: REF), the spring (RES), the damper (FRO).

A spring is a visco-elastic link with B = 0, a damper one with K = 0. By how much d grows in a sample, g of `link.py`,
the damper says; each is the recurrence of the transfer function that has the same name in `hapsim.theory`:

    backward   g[n] = d[n] - d[n-1]                                (Florens et al., §6)
    centred    g[n] = (d[n] - d[n-2])/2
    filtered   g[n] = k g[n-1] + (1 - k) (d[n] - d[n-1])           k = exp(-2 pi cutoff T)
    sensed     g[n] = T v[n], where the device measures v; at an end that is no device point, backward
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hapsim.compiling import inlined
from hapsim.compiling.native import NativeFunction, value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Column, Memory, Part, action, fma_action
from hapsim.cordis.modules.link import Links, count, ends_of, pull_link, stretch
from hapsim.scene import Damper, Spring, ViscoElastic
from hapsim.scene.modules import Link


@fma_action
def add_forces(links, state):
    """Adds the force of every link with a backward damper."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        d = stretch(links.ends, i, state.position)
        pull_link(links, i, d, d - stretch(links.ends, i, state.previous), state.force)


def _plain(module: type[Link], name: str, where: Callable[[Any], bool] = lambda _: True) -> PartType:
    """Links with a backward damper; where a field is missing, it is 0."""

    def build(links: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Part:
        live = dict(zip(module.live, columns, strict=True))
        none = np.zeros(len(links), context.real)
        numbers = Links(ends_of(links, context), live.get("stiffness", none), live.get("damping", none))
        return Part(numbers, add_forces=add_forces)

    gathered = "gathered through unsigned indices"
    return PartType(all_of(module, where), build, name=name, compiled_as=gathered, memoryless=True, in_a_matrix=True)


class DampedLinks(NamedTuple):
    """L links; `constant`: k of a filtered damper, or T in s of a sensed one; `remembered`, in m: d two samples before
    the next tick (centred), or g of the last tick (filtered). Shape (L,)."""

    links: Links
    constant: Column
    remembered: Column


@action
def initialize_centred(group, state):
    """As if every point had moved up to now as it does."""
    group, state = value_of(group), value_of(state)
    ends = group.links.ends
    for i in range(count(ends)):
        before = stretch(ends, i, state.previous)
        group.remembered[i] = before + (before - stretch(ends, i, state.position))


@fma_action
def add_centred_forces(group, state):
    """Adds the force of every link."""
    group, state = value_of(group), value_of(state)
    ends = group.links.ends
    for i in range(count(ends)):
        d = stretch(ends, i, state.position)
        growth = np.float32(0.5) * (d - group.remembered[i])  # exact in either precision, and keeps either
        pull_link(group.links, i, d, growth, state.force)
        group.remembered[i] = stretch(ends, i, state.previous)


@action
def initialize_filtered(group, state):
    """As if every point had moved up to now as it does."""
    group, state = value_of(group), value_of(state)
    ends = group.links.ends
    for i in range(count(ends)):
        group.remembered[i] = stretch(ends, i, state.position) - stretch(ends, i, state.previous)


@fma_action
def add_filtered_forces(group, state):
    """Adds the force of every link."""
    group, state = value_of(group), value_of(state)
    ends, growth = group.links.ends, group.remembered
    for i in range(count(ends)):
        d = stretch(ends, i, state.position)
        newest = d - stretch(ends, i, state.previous)
        growth[i] = newest + group.constant[i] * (growth[i] - newest)
        pull_link(group.links, i, d, growth[i], state.force)


@fma_action
def add_sensed_forces(group, state):
    """Adds the force of every link."""
    group, state = value_of(group), value_of(state)
    ends, period = group.links.ends, group.constant[0]
    for i in range(count(ends)):
        growth = _step(ends.first[i], period, state) - _step(ends.second[i], period, state)
        pull_link(group.links, i, stretch(ends, i, state.position), growth, state.force)


@inlined
def _step(point, period, state):
    """How far a point moves in a sample period, by its sensor where it has one: device points do, and come first."""
    if point < state.velocity.size:
        return state.position.dtype.type(period * state.velocity[point])
    return state.position[point] - state.previous[point]


def _damped(
    damper: str,
    compiled_as: str,
    constant: Callable[[ViscoElastic, float], float],
    add_forces: NativeFunction,
    initialize: NativeFunction | None = None,
) -> PartType:
    """Links with another damper; `constant`: of a link at a rate in Hz. One with `initialize` remembers."""

    def build(links: Mapping[str, ViscoElastic], columns: Sequence[Column], context: BuildContext) -> Part:
        constants = context.column([constant(link, context.rate) for link in links.values()])
        remembered = np.zeros(len(links), context.real)
        numbers = DampedLinks(Links(ends_of(links, context), *columns), constants, remembered)
        memory = None if initialize is None else Memory(tuple(links), (remembered,))
        return Part(numbers, initialize=initialize, add_forces=add_forces, memory=memory)

    return PartType(
        all_of(ViscoElastic, lambda link: link.damper == damper),
        build,
        name=f"visco-elastic links ({damper} damper)",
        compiled_as=f"gathered through unsigned indices; {compiled_as}",
        memoryless=initialize is None,
    )


def _kept(link: ViscoElastic, rate: float) -> float:
    """k of a filtered damper."""
    return float(np.exp(-2.0 * np.pi * np.float64(link.cutoff) / rate))


VISCOELASTIC = _plain(ViscoElastic, "visco-elastic links", lambda link: link.damper == "backward")
CENTRED = _damped("centred", "one remembered stretch each", lambda *_: 0.0, add_centred_forces, initialize_centred)
FILTERED = _damped("filtered", "one remembered velocity each", _kept, add_filtered_forces, initialize_filtered)
SENSED = _damped("sensed", "velocities come from the device", lambda _, rate: 1.0 / rate, add_sensed_forces)
SPRING = _plain(Spring, "springs")
DAMPER = _plain(Damper, "dampers")
