"""Guards, which end a run or change a force to protect the hand: a file each, and their list.

To add one, write its file with a `Guard` at its end, and name it here.
"""

from __future__ import annotations

from hapsim.loop import endings
from hapsim.loop.guards import (
    armed_inside,
    command_limit,
    energy_guard,
    following,
    force_sensor,
    frozen_sensor,
    hand_limit,
    leap,
    motor_gate,
    rate,
    sign,
    slew,
    travel,
)
from hapsim.loop.hooks import Guard

GUARDS: tuple[Guard, ...] = (
    leap.GUARD,
    hand_limit.GUARD,
    motor_gate.GUARD,
    armed_inside.GUARD,
    travel.GUARD,
    slew.GUARD,
    energy_guard.GUARD,
    frozen_sensor.GUARD,
    sign.GUARD,
    rate.GUARD,
    rate.FIRST_FORCES,
    command_limit.GUARD,
    force_sensor.GUARD,
    following.GUARD,
)
"""All guards; those of one stage act in this order."""

HOOKS = {hook.function.__name__: hook for guard in GUARDS for hook in guard.hooks.values()}
"""Hooks of all guards, by function name."""


def guard_that_ended(code: int) -> Guard | None:
    """Returns the guard whose code ended a run; None if no guard ended it."""
    return next((guard for guard in GUARDS if guard.code == code), None)


def in_words(code: int) -> str:
    """Returns the `ending` of a report for a code that ended a run."""
    guard = guard_that_ended(code)
    return endings.IN_WORDS[code] if guard is None else guard.words
