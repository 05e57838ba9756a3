"""The link with curves for a spring and a damper (CORDIS: LNL).

    F[n] = f(d[n]) + g((d[n] - d[n-1])/T)      pulls the ends together; d: first end minus second

f and g are straight between the points of their curves, and level beyond the ends. A link has a part for each curve
that it has: `OverDistance` for f, `OverVelocity` for g, which keeps m per sample instead of m/s.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import inlined
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType
from hapsim.cordis.dispatch import Column, Part, action
from hapsim.cordis.modules.link import Ends, count, ends_of, pull_ends, stretch
from hapsim.scene import Nonlinear, Scene


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
def add_forces_over_distance(group, state):
    """Adds what every link does for the distance of its ends."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        pull_ends(group.ends, i, curve_at(group.curves, i, d), state.force)


@action
def add_forces_over_velocity(group, state):
    """Adds what every link does for how fast its ends part."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        growth = stretch(group.ends, i, state.position) - stretch(group.ends, i, state.previous)
        pull_ends(group.ends, i, curve_at(group.curves, i, growth), state.force)


def _with(curve: str) -> Callable[[Scene], Mapping[str, Nonlinear]]:
    """Selects the links that have this curve."""

    def select(scene: Scene) -> Mapping[str, Nonlinear]:
        modules = scene.modules.items()
        return {name: one for name, one in modules if isinstance(one, Nonlinear) and getattr(one, curve) is not None}

    return select


def _curves(curves: Sequence[Sequence[tuple[float, float]] | None], unit: float, context: BuildContext) -> Curves:
    """These curves, whose abscissae are in `unit` metres."""
    points = [np.array(curve, np.float64) for curve in curves]
    begin = np.cumsum([0, *(len(curve) for curve in points)]).astype(np.uint64)
    together = np.concatenate(points)
    at, tension = (together[:, 0] * unit).astype(context.real), together[:, 1].astype(context.real)
    return Curves(begin, at, tension)


def _over_distance(links: Mapping[str, Nonlinear], _columns: Sequence[Column], context: BuildContext) -> Part:
    curves = _curves([one.force_over_distance for one in links.values()], 1.0, context)
    return Part(OverDistance(ends_of(links, context), curves), add_forces=add_forces_over_distance)


def _over_velocity(links: Mapping[str, Nonlinear], _columns: Sequence[Column], context: BuildContext) -> Part:
    curves = _curves([one.force_over_velocity for one in links.values()], 1.0 / context.rate, context)
    return Part(OverVelocity(ends_of(links, context), curves), add_forces=add_forces_over_velocity)


NONLINEAR_SPRING = PartType(
    _with("force_over_distance"),
    _over_distance,
    name="forces over distance",
    compiled_as="gathered through unsigned indices; a search by halves in each table",
    memoryless=True,
)
NONLINEAR_DAMPER = PartType(
    _with("force_over_velocity"),
    _over_velocity,
    name="forces over velocity",
    compiled_as="gathered through unsigned indices; a search by halves in each table",
    memoryless=True,
)
