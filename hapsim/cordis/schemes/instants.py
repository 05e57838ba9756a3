"""Forces at several instants of a sample period, for schemes that ask for them more than once.

Every link that remembers nothing is asked at each instant; those that do are asked once, at the sample, and their force
is held. Device points and grounds go on during the period as they went in the last. The force in the hand is that of
the sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from firmware_protocol.compiled import new_record
from hapsim.compiling import inlined
from hapsim.compiling.native import Behind, NativeFunction, value_of
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import CALLS, Part, action, call_all, calls_of
from hapsim.cordis.schemes.force_expansion import expanded_forces, first_moved, mobility_of_all
from hapsim.cordis.schemes.scheme import Taken
from hapsim.cordis.tick_state import Column, TickState
from hapsim.scene import Scene


class KeptForce(NamedTuple):
    """The force at the sample of the links that remember: N, shape (N,)."""

    force: Column


class Instants(NamedTuple):
    """What a scheme moves: the points from number `start` on, and their T²/m in m/N, shape (n,)."""

    start: np.uint64
    mobility: Column
    kept: KeptForce
    at: TickState
    """All points at an instant between two samples,"""
    at_address: np.uint64
    """behind this address too, for"""
    links: Any
    """the calls that are made at every instant: CALLS."""


class InstantParts(NamedTuple):
    """The parts that add up forces, and what the scheme's own part is made with."""

    adding: tuple[Part, ...]
    numbers: Instants
    kept: Any

    def parts(self, integrate: NativeFunction, numbers: Any) -> tuple[Part, ...]:
        """The whole program: `integrate` moves the points, by these numbers, in which `Instants` are."""
        return (*self.adding, Part(numbers, integrate=integrate, kept=self.kept))


@action
def keep_force(kept, state):
    """Keeps what has been added up so far, by the links that remember."""
    kept, state = value_of(kept), value_of(state)
    for p in range(np.uint64(kept.force.size)):
        kept.force[p] = state.force[p]


@inlined
def add_forces_at(instants, state, share):
    """The forces at an instant, which is this share of a sample period after the sample; the scheme has put its points
    where they are then."""
    at = instants.at
    for p in range(instants.start):
        way = state.position[p] - state.previous[p]
        at.position[p] = state.position[p] + share * way
        at.previous[p] = at.position[p] - way
    for p in range(np.uint64(instants.kept.force.size)):
        at.force[p] = instants.kept.force[p]
    call_all(instants.links, instants.at_address)


class _Calls:
    """The calls that are made at every instant, and what they need to stay where it is."""

    def __init__(self, links: Sequence[Part], state: TickState) -> None:
        position, previous, force = np.zeros((3, state.force.size), state.force.dtype)
        self.state = Behind(TickState(position, previous, position, force, state.velocity))
        numbers = [(part.add_forces, Behind(part.numbers)) for part in links if part.add_forces is not None]
        self._kept = (numbers, calls_of(numbers, self.state))
        self.calls = new_record(CALLS)
        self.calls.pairs, self.calls.count = self._kept[1].ctypes.data, len(self._kept[1])


def instants_of(scene: Scene, context: BuildContext, taken: Sequence[Taken]) -> InstantParts:
    """The parts of all modules, as forces, and the points that are left to the scheme to move."""
    once: list[Part] = []
    always: list[Part] = []
    for one in taken:
        if one.kind.moves_points:
            always += expanded_forces(one, context)
        else:
            part = one.build(context)
            (always if one.kind.memoryless or part.add_forces is None else once).append(part)
    kept = KeptForce(np.zeros_like(context.state.force))
    calls = _Calls(always, context.state)
    numbers = Instants(
        np.uint64(first_moved(scene)),
        mobility_of_all(scene, context),
        kept,
        calls.state.value,
        np.uint64(calls.state.address),
        calls.calls,
    )
    keeping = [Part(kept, add_forces=keep_force)] if once else []
    return InstantParts((*once, *keeping, *always), numbers, calls)
