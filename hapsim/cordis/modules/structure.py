"""The base of strings and membranes: a stencil that moves all masses in one pass over contiguous memory, in lanes
(`simd.py`), and the masses that links hold.

A step is a named tuple of a structure's numbers, with a kernel for its type in `STENCIL_KERNELS`. From x[n] and x[n-1]
of some masses the kernel computes the terms for their neighbours, and from these and the neighbours' terms x[n+1]. So
each term is computed once. x[n+1] replaces x[n-1]: two rows of positions instead of three, which a long string fetches
from beyond the nearest caches in every step.

A structure moves all its masses in one pass, without forces. Forces of links act only on the masses that they hold
(`LoadedPoints`): those are moved once more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import fma, inlined, overload
from hapsim.compiling.native import NativeFunction
from hapsim.cordis.build_context import BatchType, BuildContext, Layout, all_of
from hapsim.cordis.dispatch import Batch, Column
from hapsim.cordis.simd import add_to_one, chosen, fetch, put, shift_lanes, width_of
from hapsim.scene.modules import Structure


class UniformLinks(NamedTuple):
    """The links inside S structures: T²/m in m/N; K, B/T and friction/T in N/m; shape (S,)."""

    mobility: Column
    stiffness: Column
    damping_per_sample: Column
    friction_per_sample: Column


class LoadedPoints(NamedTuple):
    """The masses of a type of structure that links hold, by number, and their T²/m in m/N; shape (P,)."""

    point: NDArray[np.uint32]
    mobility: Column


def structure_type(
    module: type[Structure],
    numbers: Callable[[Mapping[str, Any], UniformLinks, LoadedPoints, BuildContext], Any],
    layout: Layout,
    initialize: NativeFunction,
    integrate: NativeFunction,
    name: str,
    compiled_as: str,
    where: Callable[[Any], bool] = lambda _: True,
) -> BatchType:
    """Returns the type of a module type's structures for which `where` holds. `numbers`: makes their numbers."""

    def build(structures: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
        links = UniformLinks(context.mobility([one.mass for one in structures.values()]), *columns)
        own = numbers(structures, links, _loaded_points_of(structures, context), context)
        return Batch(own, initialize=initialize, integrate=integrate)

    words = f"{compiled_as}, many masses at once; a link reads only the masses at its ends"
    return BatchType(all_of(module, where), build, layout=layout, name=name, compiled_as=words, moves_points=True)


def _loaded_points_of(structures: Mapping[str, Any], context: BuildContext) -> LoadedPoints:
    loaded = [
        (number, one.mass)
        for name, one in structures.items()
        for place in one.point_names()
        if (number := context.number[f"{name}.{place}"]) in context.loaded
    ]
    point, mass = np.array(loaded, np.float64).reshape(-1, 2).T
    return LoadedPoints(point.astype(np.uint32), context.mobility(mass))


@inlined
def push_loaded_points(loaded, state):
    """Adds the links' force to x[n+1] of each mass that they hold, and sets the force to zero."""
    for i in range(np.uint64(loaded.point.size)):
        p = loaded.point[i]
        add_to_one(state.previous, np.uint64(p), loaded.mobility[i] * state.force[p])
        state.force[p] = 0.0


@inlined
def link_coefficients(links, s):
    """Returns a, b and e of structure s: T²/m times its stiffness, damping/T and friction/T."""
    mobility = links.mobility[s]
    return (
        mobility * links.stiffness[s],
        mobility * links.damping_per_sample[s],
        mobility * links.friction_per_sample[s],
    )


class StencilKernel(NamedTuple):
    """The functions of a step.

    `terms_of`: (step, x, before) -> (t, x, before), for lanes of masses at x now and at `before` a sample ago; t is the
    term that neighbours sum up. `update`: (step, rows, here, terms) -> the lanes at `here`, a sample on. `rows`: (x,
    before); `terms`: of the lanes to the left, here and to the right. It subtracts a mass's own term from its
    neighbours'. With one coefficient for x and one for `before`, rounded to 32 bits, the lowest mode of a string of 100
    masses would be up to a thousandth too fast or too slow.
    """

    terms_of: Callable[..., Any]
    update: Callable[..., Any]


STENCIL_KERNELS: dict[type, StencilKernel] = {}
"""Kernels that move a structure's masses by a sample, by the type of its step."""


def _neighbour_terms(step, x, before):
    """Chosen by `_choose_neighbour_terms`."""


def _update(step, rows, here, terms):
    """Chosen by `_choose_update`."""


@overload(_neighbour_terms)
def _choose_neighbour_terms(step, x, before):  # noqa: ARG001  (numba matches the names)
    kernel: Any = STENCIL_KERNELS[step.instance_class].terms_of

    def neighbour_terms(step, x, before):
        return kernel(step, x, before)

    return neighbour_terms


@overload(_update)
def _choose_update(step, rows, here, terms):  # noqa: ARG001  (numba matches the names)
    kernel: Any = STENCIL_KERNELS[step.instance_class].update

    def update(step, rows, here, terms):
        return kernel(step, rows, here, terms)

    return update


@fma
def linear_terms(step, x, before):
    """Returns the terms of a structure in which each mass is linked to the nearest ones."""
    return (step.a + step.b) * x - step.b * before, x, before


@inlined
def neighbours(terms, which):
    """Returns the sum of term `which`, a literal, of both neighbours in a row."""
    return shift_lanes(terms, which, -1) + shift_lanes(terms, which, 1)


@fma
def next_position(step, x, before, pull):
    """Returns x[n+1] by differences. `pull`: the motion by the links, m."""
    way = x - before
    return x + ((way - step.e * way) + pull)


@inlined
def sweep(step, state, first, count):
    """Moves `count` masses from the one at `first` on by a sample.

    One or two borders precede them, in the first one's lanes, and two numbers follow them. Other numbers in the same
    lanes keep their values: they are copied from `position` to `previous`.

    x[n+1] replaces x[n-1]. The terms that the lanes to the right need are in `middle` by then.
    """
    rows, width, end = (state.position, state.previous), width_of(state.position), first + count
    here, last = first & ~(width - np.uint64(1)), (end - np.uint64(1)) & ~(width - np.uint64(1))
    beyond = (end + np.uint64(1)) & ~(width - np.uint64(1))  # lanes of the second border
    left = middle = _terms_at(step, rows, here)  # the first mass's lanes include one or two borders
    right = _terms_at(step, rows, min(here + width, beyond))
    _put_inside(rows, here, first, end, _update(step, rows, here, (left, middle, right)))
    here += width
    while here < last:
        left, middle = middle, right
        right = _terms_at(step, rows, here + width)
        put(rows[1], here, _update(step, rows, here, (left, middle, right)))
        here += width
    if here == last:
        left, middle, right = middle, right, _terms_at(step, rows, beyond)
        _put_inside(rows, here, first, end, _update(step, rows, here, (left, middle, right)))


@inlined
def _terms_at(step, rows, here):
    return _neighbour_terms(step, fetch(rows[0], here), fetch(rows[1], here))


@inlined
def _put_inside(rows, here, first, end, lanes):
    """Stores the lanes' masses; other numbers keep their values."""
    put(rows[1], here, chosen(lanes, fetch(rows[0], here), np.int64(first - here), np.int64(end - here)))
