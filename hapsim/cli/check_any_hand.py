"""What `hapsim check` prints of hands other than the declared ones: any passive hand, and those of a range."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from hapsim.documents import pick
from hapsim.errors import UsageError
from hapsim.number_format import number, rounded_down, rounded_up
from hapsim.units import Units

if TYPE_CHECKING:
    from hapsim.prediction import AnyHand, Prediction, WorstHand

Range = tuple[float, float]

_ORDINARY = (0.0, 2.0), (0.0, 3000.0)  # kg and N/m that a hand and its arm add
_CLAMP = 2e4  # N/m: no hand is as stiff


def hand_ranges(mass: str | None, stiffness: str | None) -> tuple[Range, Range] | None:
    """Returns the ranges of mass and stiffness that hands add; None where none is asked for. Raises UsageError."""
    if mass is None and stiffness is None:
        return None
    return _range_of("--hand-mass", mass or "0"), _range_of("--hand-stiffness", stiffness or "0")


def _range_of(option: str, text: str) -> Range:
    try:
        low, *high = (float(part) for part in text.split(":"))
    except ValueError:
        low, high = -1.0, []
    if len(high) > 1 or not 0.0 <= low <= (high or [low])[0] < math.inf:
        raise UsageError(f"{option}: found {text}, expected LOW:HIGH or one number, from 0 on, such as 0.1:2")
    return low, (high or [low])[0]


def any_hand_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields for each part of the scene from which friction on it is stable in any hands, and in which it is not, and
    whether ordinary hands shake it; what is alike once."""
    alike: dict[str, list[str]] = {}
    for one in prediction.any_hands:
        told = f"{_passive(prediction, one)}{_ordinary(prediction, one)}"
        alike.setdefault(told, []).append(_who(one))
    for sentence, whose in alike.items():
        yield f"{', '.join(whose)}: {sentence}"


def _passive(prediction: Prediction, one: AnyHand) -> str:
    is_taken = prediction.assumptions or any(name in prediction.regions for name in one.names)
    taken = " (as it is taken)" if is_taken else ""
    if one.is_passive is None:
        return f"whether it is passive is not known, for {one.not_derived or 'its numbers are out of range'}"
    if one.lasting:
        held = "the hands are" if len(one.names) > 1 else "the hand is"
        return (
            f"not passive{taken}, whatever the friction, for while {held} held a motion of {escape(one.lasting)} at "
            f"{number(one.frequency_hz, 4)} Hz does not die out"
        )
    if one.pushes_away:
        return f"not passive{taken}, whatever the friction: at rest the scene pushes the hand on"
    friction = (
        f"{_needed(one, prediction.scene.units_of(one.channels[0]))} of friction (declared: {_numbers(one.friction)})"
    )
    if one.is_passive:
        return f"passive{taken}, which is stable in any hands (Colgate and Schenkel): that needs {friction}"
    return f"not passive{taken}: it is stable in any hands only with {friction}{_shaken(prediction, one)}"


def _ordinary(prediction: Prediction, one: AnyHand) -> str:
    """Returns whether ordinary hands shake it, where that is a question, and worked out."""
    is_linear = prediction.scene.device.motions(prediction.scene.channels)[one.channels[0]] == "linear"
    if one.is_passive or not is_linear or not prediction.stable_as_taken:
        return ""
    worst = one.worst_hand(*_ORDINARY)
    if worst is None:
        return ""
    if worst.is_stable:
        return f". Hands of up to {_ORDINARY[0][1]:g} kg and {_ORDINARY[1][1]:g} N/m more do not shake it"
    units = prediction.scene.units_of(one.channels[0])
    return f". [red]An ordinary hand shakes it[/red]: {_hands(one, worst, units)} more"


def _hands(one: AnyHand, worst: WorstHand, units: Units) -> str:
    """Returns what they add; of several what those add that add something."""
    each = zip(one.names, worst.masses, worst.stiffnesses, strict=True)
    several = len(one.names) > 1
    told = [
        f"{units(mass, 'kg', 3)}, {units(stiffness, 'N/m', 3)}{f' on {escape(name)}' if several else ''}"
        for name, mass, stiffness in each
        if mass or stiffness or not several
    ]
    return " and ".join(told) or "nothing"


def _who(one: AnyHand) -> str:
    first, *others = [f"[bold]{escape(name)}[/bold]" for name in one.names]
    return f"{', '.join([first, *others[:-1]])} and {others[-1]}" if others else first


def _needed(one: AnyHand, units: Units) -> str:
    shown = [rounded_up(max(0.0, float(needed))) for needed in one.needed]
    alike = len({*shown}) == 1
    if alike:
        return f"{units(shown[0], 'N·s/m')}{' each' if len(shown) > 1 else ''}"
    return f"{units(' and '.join(shown), 'N·s/m')}, in these proportions,"


def _numbers(friction: Any) -> str:
    return " and ".join(dict.fromkeys(number(float(one)) for one in friction))


def _shaken(prediction: Prediction, one: AnyHand) -> str:
    """Returns below which friction a single hand is shaken, and which, unless the declared one is already."""
    least, hand = one.needed_for_one, one.shaking if prediction.stable_as_taken else None
    below = f"; below {rounded_down(least)} a mass or a spring shakes it" if least > 0.0 else ""
    if hand is None:
        return below
    units = prediction.scene.units_of(one.channels[0])
    holds = units(hand.mass, "kg", 3) if hand.mass else units(hand.stiffness, "N/m", 3)
    holds = f"a clamp of {holds}" if hand.stiffness > _CLAMP else f"{holds} more"
    on = f" on [bold]{escape(hand.name)}[/bold]" if len(one.names) > 1 else ""
    growth, hertz = number(hand.growth, 7), number(hand.frequency_hz, 4)
    return f"{below}; with {holds}{on} it grows {growth}-fold a sample, at {hertz} Hz"


def worst_hand_sentences(prediction: Prediction, ranges: tuple[Range, Range] | None) -> Iterator[str]:
    """Yields for each part of the scene whether some hand of these ranges of mass and stiffness is shaken, and the
    worst."""
    if ranges is None:
        return
    for one in prediction.any_hands:
        units, worst = prediction.scene.units_of(one.channels[0]), one.worst_hand(*ranges)
        if worst is None:
            yield f"Hands on {_who(one)}: not worked out, because the loop has too many masses or too long a delay"
            continue
        verdict = "[green]stable with all that were tried[/green]" if worst.is_stable else "[red]some are shaken[/red]"
        of = f"{units(_range(ranges[0]), 'kg')} and {units(_range(ranges[1]), 'N/m')} more"
        yield (
            f"Hands on {_who(one)} of {of}: {verdict}; the worst, {_hands(one, worst, units)}, has a spectral radius "
            "of "
            f"{number(worst.spectral_radius, 9)}"
        )


def _range(values: Range) -> str:
    low, high = values
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def any_hands_document(prediction: Prediction, ranges: tuple[Range, Range] | None = None) -> list[dict[str, Any]]:
    """Returns the same as a JSON document. `ranges`: of mass and stiffness."""
    found = []
    for one in prediction.any_hands:
        worst = one.worst_hand(*ranges) if ranges else None
        found.append(pick(one, one.DOCUMENT) | {"worst_hand": worst and pick(worst, "* stable=is_stable")})
    return found
