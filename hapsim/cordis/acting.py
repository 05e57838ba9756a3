"""What a module's part of the program does in a tick, chosen by the part's type when the tick is compiled.

A program's parts are a tuple of named tuples, one for each kind of module that the scene has. Each kind's file says
with `@settles`, `@pulls` and `@moves` what its part does before the first tick, when forces are added up, and when
points move. The tick is compiled for the very tuple that a scene has: what is not in it leaves no instruction behind,
nor does a kind of module that was added to hapsim later.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from hapsim.compiled import overload

Action = TypeVar("Action", bound=Callable[..., None])

_SETTLES: dict[type, Any] = {}
_PULLS: dict[type, Any] = {}
_MOVES: dict[type, Any] = {}


def settles(part: type) -> Callable[[Action], Action]:
    """Registers an inlined function (part, moment) that is called once, before the first tick."""
    return _registered(_SETTLES, part)


def pulls(part: type) -> Callable[[Action], Action]:
    """Registers an inlined function (part, moment) that adds the part's forces."""
    return _registered(_PULLS, part)


def moves(part: type) -> Callable[[Action], Action]:
    """Registers an inlined function (part, moment) that works out where the part's points are at the next sample."""
    return _registered(_MOVES, part)


def settle_all(parts, moment):
    """Before the first tick."""
    _in_python(_SETTLES, parts, moment)


def pull_all(parts, moment):
    """Adds all forces."""
    _in_python(_PULLS, parts, moment)


def move_all(parts, moment):
    """Moves all points that the scene moves."""
    _in_python(_MOVES, parts, moment)


def _registered(actions: dict[type, Any], part: type) -> Callable[[Action], Action]:
    def register(action: Action) -> Action:
        actions[part] = action
        return action

    return register


def _in_python(actions, parts, moment):
    for part in parts:
        if type(part) in actions:
            actions[type(part)](part, moment)


def _compiled(for_all: Any, actions: dict[type, Any]) -> None:
    """How compiled code calls `for_all`: the first part's action, if it has any, then those of the rest."""

    @overload(for_all)
    def choose(parts, moment):  # noqa: ARG001  (numba matches the names)
        first: Any = actions.get(parts.types[0].instance_class) if parts.types else None

        def none(parts, moment):
            pass

        def others(parts, moment):
            for_all(parts[1:], moment)

        def first_and_others(parts, moment):
            first(parts[0], moment)
            for_all(parts[1:], moment)

        if not parts.types:
            return none
        return others if first is None else first_and_others


for _for_all, _actions in ((settle_all, _SETTLES), (pull_all, _PULLS), (move_all, _MOVES)):
    _compiled(_for_all, _actions)
