"""The proxy: a material point with an implicit step that a virtual coupling, Kc and Bc, joins to a device point.

    (m / T²) (x[n] - 2 x[n-1] + x[n-2]) = Kc d[n] + (Bc / T) (d[n] - d[n-1]) + F[n],        d: the hand minus x

F[n], the force of the links that end on it, is that at x[n] too. All of them have knots (`table_links.py`), a spring a
single one. So the left side minus the right rises with x from one straight piece to the next, and Newton's steps find
the piece. A step that leaves the interval in which x is known to be becomes a bisection. Where a contact's damper
begins, the force jumps: there x is the edge, and the force lies between. A tick finds the proxy where it would coast,
at 2 x[n-1] - x[n-2] (`Masses`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import ONE
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BatchType, BuildContext, LiveColumn, live_columns
from hapsim.cordis.dispatch import Batch, Column, action
from hapsim.cordis.modules.linear_links import add_to_line
from hapsim.cordis.modules.link import Ends, count, pull_ends, stretch
from hapsim.cordis.modules.table_links import TableLinks, knot_columns, table_numbers, tension_at, update_pieces
from hapsim.laws import Law
from hapsim.scene import Proxy, Scene
from hapsim.scene.modules import Link

_MOST_STEPS = 200  # halvings of an interval need some 60; none is reached but with a NaN


class Proxies(NamedTuple):
    """P proxies and their links; those of proxy p are begin[p] to before begin[p + 1]. `ends`: hand and proxy of each
    coupling; m/T², Kc and Bc/T in N/m, (P,); `digit`: relative error of a number, (1,)."""

    links: TableLinks
    begin: NDArray[np.uint64]
    ends: Ends
    inertia: Column
    digit: Column
    stiffness: Column
    damping_per_sample: Column


@action
def retarget(proxies, _state):
    """Computes the numbers of the links that depend on the live ones."""
    update_pieces(value_of(proxies).links)


@action
def add_forces(proxies, state):
    """Moves every proxy to its position in this sample, and adds the forces of its coupling and its links."""
    proxies, state = value_of(proxies), value_of(state)
    links, x, real = proxies.links, state.position, state.position.dtype.type
    for p in range(count(proxies.ends)):
        at, hand, coasts = proxies.ends.second[p], proxies.ends.first[p], x[proxies.ends.second[p]]
        K, B, before = proxies.stiffness[p], proxies.damping_per_sample[p], state.previous[hand] - state.previous[at]
        low, high, below, above, share = real(-np.inf), real(np.inf), real(0), real(0), real(0)
        for _ in range(_MOST_STEPS):
            d = x[hand] - x[at]
            excess = proxies.inertia[p] * (x[at] - coasts) - K * d - B * (d - before)
            slope = proxies.inertia[p] + K + B
            for i in range(proxies.begin[p], proxies.begin[p + ONE]):
                tension, steepness = tension_at(links, i, stretch(links.ends, i, x), state.previous)
                excess += tension if links.ends.first[i] == at else -tension
                slope += steepness
            step, close = excess / slope, proxies.digit[0] * (abs(coasts) + abs(x[hand]) + abs(x[at]))
            if not abs(step) > close:
                x[at] -= step
                break
            if excess > 0:
                high, above = x[at], excess
            else:
                low, below = x[at], excess
            x[at] -= step
            if not low < x[at] < high:
                x[at] = low + real(0.5) * (high - low)
                if high - low <= close:
                    x[at], share = low, below / (below - above)
                    break
        d = x[hand] - x[at]
        pull = K * d + B * (d - before)
        state.force[hand] -= pull
        state.force[at] += pull
        for i in range(proxies.begin[p], proxies.begin[p + ONE]):
            tension, _ = tension_at(links, i, stretch(links.ends, i, x), state.previous)
            if share > 0:
                x[at] = high
                tension += share * (tension_at(links, i, stretch(links.ends, i, x), state.previous)[0] - tension)
                x[at] = low
            pull_ends(links.ends, i, tension, state.force)


def _select(scene: Scene) -> dict[str, Any]:
    """Returns the proxies, and the links of the first, of the second and so on."""
    every, at_proxies = scene.proxies, scene.links_at_proxies
    return every | {name: link for one in every for name, link in at_proxies.items() if one in link.between}


def _parted(modules: Mapping[str, Any]) -> tuple[dict[str, Proxy], dict[str, Link], list[Law]]:
    """Returns the proxies, the links and the laws by whose knots their forces are worked out."""
    proxies = {name: one for name, one in modules.items() if isinstance(one, Proxy)}
    links = {name: one for name, one in modules.items() if name not in proxies}
    return proxies, links, [link.table() or link.law() for link in links.values()]


def _live(modules: Mapping[str, Any], rate: float) -> list[LiveColumn]:
    proxies, links, laws = _parted(modules)
    return [*live_columns(proxies, rate), *knot_columns(dict(zip(links, laws, strict=True)), rate, 1.0, "")]


def _build(modules: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
    proxies, links, laws = _parted(modules)
    sizes = [sum(name in link.between for link in links.values()) for name in proxies]
    numbers = Proxies(
        table_numbers(links, laws, columns[2:], context),
        np.cumsum([0, *sizes]).astype(np.uint64),
        Ends(
            np.array([context.number[one.hand] for one in proxies.values()], np.uint32),
            np.array([context.number[name] for name in proxies], np.uint32),
        ),
        context.column([one.mass * context.rate**2 for one in proxies.values()]),
        context.column([4.0 * np.finfo(context.real).eps]),
        *columns[:2],
    )
    return Batch(numbers, initialize=retarget, retarget=retarget, add_forces=add_forces)


PROXY = BatchType(
    _select,
    _build,
    name="proxies and their links",
    compiled_as="steps over the links' knots",
    live=_live,
    line=add_to_line,
)
