"""The base of all links: two ends each, which they pull towards each other.

    F[n] = K d[n] + (B / T) g[n]      d: first end minus second end; g: growth of d in a sample period

is the visco-elastic link (Florens et al., §6, Figure 5b). F is a *tension*: a positive one pulls the ends together, so
that it acts on the first end as -F, and on the second as +F. `pull_ends` does that for every link.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import inlined
from hapsim.compiling.native import NativeFunction
from hapsim.cordis.build_context import BatchType, BuildContext, all_of
from hapsim.cordis.dispatch import Batch, Column, Memory
from hapsim.scene import Scene
from hapsim.scene.modules import Link


class Ends(NamedTuple):
    """The points that L links join, by number, shape (L,)."""

    first: NDArray[np.uint32]
    second: NDArray[np.uint32]


class Links(NamedTuple):
    """L visco-elastic links: K in N/m, B/T in N/m; shape (L,)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column


def link_type(
    module: type[Link],
    numbers: Callable[..., Any],
    add_forces: NativeFunction,
    name: str,
    compiled_as: str = "",
    *,
    where: Callable[[Any], bool] = lambda _: True,
    constants: Callable[[Iterable[Any], BuildContext], tuple[Any, ...]] = lambda *_: (),
    remembers: int = 0,
    initialize: NativeFunction | None = None,
    line: NativeFunction | None = None,
    space: int = 1,
) -> BatchType:
    """Returns the type of the links of a module type for which `where` holds, in scenes with this space.

    Args:
        numbers: makes the part's numbers of the ends, the live columns, the constants and the remembered columns.
        constants: of these links, such as curves.
        remembers: count of the links' memory columns, which are 0 before the first tick.
        name, compiled_as, line: as in `BatchType`.
    """

    def build(links: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
        remembered = tuple(np.zeros((remembers, len(links)), context.real))
        own = numbers(ends_of(links, context), *columns, *constants(links.values(), context), *remembered)
        columns_by_name = zip(own._fields[-remembers:], remembered, strict=True) if remembers else ()
        memory = Memory(tuple(links), dict(columns_by_name)) if remembers else None
        return Batch(own, initialize=initialize, add_forces=add_forces, memory=memory)

    gathered = "; ".join(filter(None, ("gathered through unsigned indices", compiled_as)))
    every = all_of(module, where, space)
    return BatchType(
        lambda scene: apart_from_proxies(every(scene), scene), build, name=name, compiled_as=gathered, line=line
    )


def apart_from_proxies(links: Mapping[str, Any], scene: Scene) -> dict[str, Any]:
    """Returns these links without those that end on a proxy: its part has them."""
    at_proxies = scene.links_at_proxies if scene.proxies else {}
    return {name: link for name, link in links.items() if name not in at_proxies}


def ends_of(links: Mapping[str, Any], context: BuildContext) -> Ends:
    """Returns the ends of these links; in the plane their x, each followed by its y."""
    number = context.number
    numbers = [[number[end if end in number else f"{end}.x"] for end in link.between] for link in links.values()]
    first, second = np.array(numbers, np.uint32).reshape(-1, 2).T
    return Ends(np.ascontiguousarray(first), np.ascontiguousarray(second))


@inlined
def count(ends):
    """Returns the number of links."""
    return np.uint64(ends.first.size)


@inlined
def stretch(ends, i, position):
    """Returns link i's first end minus its second, m, for points at `position`."""
    return position[ends.first[i]] - position[ends.second[i]]


@inlined
def pull_ends(ends, i, tension, force):
    """Pulls link i's ends towards each other by `tension` N."""
    force[ends.first[i]] -= tension
    force[ends.second[i]] += tension


@inlined
def pull_link(links, i, d, growth, force):
    """Adds link i's force. `d`: its stretch, m; `growth`: of the stretch in a sample, m."""
    pull_ends(links.ends, i, links.stiffness[i] * d + links.damping_per_sample[i] * growth, force)
