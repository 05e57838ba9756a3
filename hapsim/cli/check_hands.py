"""Lines of `hapsim check` about what hands feel: alone, moving masses or each other, and any hands."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.markup import escape

from hapsim.cli.check_plane import ALONG
from hapsim.cli.command_options import quantity, require_units
from hapsim.cli.output import Line, output_units, table
from hapsim.documents import pick
from hapsim.errors import UsageError
from hapsim.number_format import angle, listed, number, rounded_down, rounded_up
from hapsim.prediction.felt_mass import admittance_sentences, stable_words
from hapsim.units import Units

if TYPE_CHECKING:
    from hapsim.prediction import AnyHand, Part, Prediction, Weight, WorstHand
    from hapsim.scene import Scene

_NONE = 1e-9  # of the largest stiffness: what rounding leaves
_FREQUENCIES = 5  # of a sentence


def felt_lines(prediction: Prediction, *, with_alone: bool) -> Iterator[Line]:
    """Yields k, b and static stiffness of the hands, beside the desired ones, and sentences about them. `with_alone`:
    also of hands with a closed form."""
    if prediction.scene.device.is_admittance:
        return  # they feel a mass and a damping, see below
    parts = [one for one in prediction.parts if with_alone or one.alone is None]
    if rows := [row for one in parts for row in _rows_of(prediction.scene, one)]:
        yield table("", ("", "desired", "felt", "static", ""), rows, box=None)
    for one in parts:
        yield from sentences_of(prediction, one)


def admittance_lines(prediction: Prediction) -> Iterator[Line]:
    """Yields the mass and damping that each hand feels in admittance, beside the simulated ones, and how far both are
    stable, in every hand that the device assumes; nothing in impedance."""
    if not prediction.scene.device.is_admittance:
        return
    scene, rows, sentences = prediction.scene, [], list[Line]()
    several, every = bool(prediction.in_other_hands), (prediction, *prediction.in_other_hands.values())
    weakest = {felt.name: felt for felt in prediction.felt_masses}  # where the least stiff hand makes it unstable
    for felt in (felt for one in every for felt in one.felt_masses):
        weakest[felt.name] = min(weakest[felt.name], felt, key=lambda felt: felt.stable_hand_stiffness)
    for one in every:
        for felt in one.felt_masses:
            units = scene.units_at(felt.name)
            hand = f"{units(felt.hand_stiffness, 'N/m', 'g')}, {units(felt.hand_damping, 'N·s/m', 'g')}"
            who = f"{escape(felt.name)}{f' ({hand})' if several else ''}"
            masses, dampings = stable_words(felt, units)
            m, b = (units.number(felt.m, "kg"), units.number(felt.b, "N·s/m")) if not felt.reason else ("–", "–")
            rows.append((f"{who}: m", units.number(felt.mass, "kg"), m, units.name("kg"), masses or "none"))
            rows.append((f"{who}: b", units.number(felt.damping, "N·s/m"), b, units.name("N·s/m"), dampings or "none"))
            sentences += map(escape, admittance_sentences(felt, units, who, felt is weakest[felt.name]))
    # A hand without a span is the same at each end of another's.
    yield table("", ("", "simulated", "felt", "", "<stable"), dict.fromkeys(rows), box=None)
    yield from dict.fromkeys(sentences)


def admittance_document(prediction: Prediction) -> list[dict[str, Any]]:
    """Returns what the hands feel in admittance as a JSON document, in every hand that the device assumes."""
    every = (prediction, *prediction.in_other_hands.values())
    return [pick(felt, felt.DOCUMENT) | {"stable": one.stable_as_taken} for one in every for felt in one.felt_masses]


def _rows_of(scene: Scene, part: Part) -> Iterator[tuple[str, ...]]:
    """Yields rows for each hand along its coordinate, or along its principal directions, and on a line for each pair of
    hands: the coupling that the first feels to the second."""
    largest = max((abs(one.static_stiffness) for one in part.rows), default=0.0)
    for one in part.rows:
        is_line, units = math.isnan(one.angle_deg), scene.units_at(one.hand)
        turned = "" if is_line else f" at {angle(one.angle_deg)}"
        who = escape(one.hand) + (f" of {escape(one.of)}" if one.of else turned)
        least = 0.0 if is_line else _NONE * largest
        k = (0.0 if abs(each) <= least else each for each in (one.desired_k, one.k, one.static_stiffness))
        names = names_between(units, scene.units_at(one.of)) if one.of else None
        yield from pair_rows(who, units if names is None else units.si, k, (one.desired_b, one.b), names)


def names_between(units: Units, of: Units) -> tuple[str, str] | None:
    """Returns the units of the k and b that a hand feels of a hand of another motion; None for one of its own."""
    if units.is_rotary == of.is_rotary:
        return None
    return ("N", "N·s") if units.is_rotary else ("N/rad", "N·s/rad")  # N·m/m


def pair_rows(
    who: str, units: Units, k: Iterable[float], b: Iterable[float], names: tuple[str, str] | None = None
) -> Iterator[tuple[str, ...]]:
    of_k, of_b = names or (units.name("N/m"), units.name("N·s/m"))
    yield f"{who}: k", *(units.number(one, "N/m") for one in k), of_k
    yield f"{who}: b", *(units.number(one, "N·s/m") for one in b), "", of_b


def sentences_of(prediction: Prediction, one: Part) -> Iterator[str]:
    """Yields the meaning of a part's rows, or the felt stiffness over frequency if there are none."""
    if one.alone is not None:
        if one.alone.reason:
            yield f"[bold]{escape(one.names[0])}[/bold]: no spring and damper is equivalent: {one.alone.reason}"
        return
    whys = "; ".join(f"[bold]{escape(name)}[/bold] {escape(why)}" for name, why in one.whys.items())
    is_line = len(one.hands) == len(one.names)
    if not one.felt.reason and is_line:
        pairs = " (of another hand: between them)" if len(one.names) > 1 else ""
        yield f"{whys}. Felt: k and b of its own oscillation{pairs}. Desired: the same without sampling and delay"
    elif one.felt.reason:
        modes = _modes(one.felt.frequencies_hz)
        yield f"{whys}: no single k and b describe what it feels, because {one.felt.reason}{modes}"
        yield from (_at_frequencies(one, i, output_units(channel)) for i, channel in enumerate(one.channels))
    if (weight := _weight_of(prediction, one)) is not None:
        yield _weight(weight, output_units(one.channels[0]))


def _weight_of(prediction: Prediction, one: Part) -> Weight | None:
    """Returns the weight that the hands feel; None for rotary motion, to which `HAND_STIFFNESS` does not apply."""
    motions = prediction.scene.device.motions(prediction.scene.channels)
    return one.weight if motions[one.channels[0]] == "linear" else None


def _modes(frequencies: tuple[float, ...]) -> str:
    if not frequencies:
        return ""
    shown = [number(one, 3) for one in sorted(frequencies[:_FREQUENCIES])]
    return f" ({'modes' if len(shown) > 1 else 'a mode'} of {listed(shown)} Hz)"


def _at_frequencies(one: Part, i: int, units: Units) -> str:
    from hapsim.prediction import HAND_HZ

    static, (k_moved, b_moved) = float(one.static_stiffness[i, i]), one.at_frequencies
    pairs = zip(HAND_HZ, k_moved[i].tolist(), b_moved[i].tolist(), strict=True)
    moved = [f"at {hz:g} Hz {units(k, 'N/m', 4)} and {units(b, 'N·s/m', 3)}" for hz, k, b in pairs if math.isfinite(k)]
    inertia = " (below 0: there it feels a mass, no spring)" if any(k < 0.0 for k in k_moved[i]) else ""
    on, it = "", ", the hand"
    if len(one.names) > 1:
        on, it = f" on {escape(one.names[i])}", " while the others are held, it"
    steady = f"A steady push{on} meets {units(static, 'N/m', 4)}"
    if math.isfinite(brake := float(one.drift_damping[i])):
        steady += f"; released, it drifts on, braked by {units(brake, 'N·s/m', 4)}"
    return f"{steady}; moved to and fro{it} meets {', '.join(moved)}{inertia}" if moved else steady


def _weight(weight: Weight, units: Units) -> str:
    """Returns the mass that a linear hand feels, in sentences."""
    from hapsim.prediction import HAND_STIFFNESS

    weighed, felt, plain, simulated = (
        units(one, "kg", 4) for one in (weight.mass, weight.felt, weight.continuous, weight.to_simulate)
    )
    text = f"The free masses weigh {weighed}. Moved by a hand of {units(HAND_STIFFNESS, 'N/m')}, they feel "
    text += f"like {felt} (without sampling and delay: {plain})"
    if math.isfinite(weight.within_10_percent_hz):
        text += f". Up to {number(weight.within_10_percent_hz, 2)} Hz they feel like themselves, within 10 %"
    if math.isfinite(weight.to_simulate):
        text += f". Simulate {simulated} to feel {weighed}"
    return text


def part_document(prediction: Prediction, one: Part) -> dict[str, Any]:
    """Returns a part of the scene as a JSON document."""
    from hapsim.prediction import HAND_HZ

    moved = (rows[0].tolist() for rows in one.at_frequencies)
    return {
        **pick(one, "device_points=names channels why=whys alone"),
        "hands": [pick(each, ALONG) for each in one.rows if not each.of],
        "k": _matrix(one.felt.k),
        "b": _matrix(one.felt.b),
        "desired": {"k": _matrix(one.desired.k), "b": _matrix(one.desired.b)},
        "static_stiffness": _matrix(one.static_stiffness),
        "drift_damping": one.drift_damping,
        **pick(one.felt, "kinetic_share=share other_motions=others frequencies_hz reason"),
        "weight": _weight_of(prediction, one),
        "moved": [{"frequency_hz": hz, "k": k, "b": b} for hz, k, b in zip(HAND_HZ, *moved, strict=True)],
        "regions": one.regions,
    }


def _matrix(values: np.ndarray[Any, Any]) -> Any:
    return values if np.isfinite(values).all() else None


Range = tuple[float, float]

_ORDINARY = (0.0, 2.0), (0.0, 3000.0)  # kg and N/m that a hand and its arm add
_CLAMP = 2e4  # N/m: no hand is as stiff


def hand_ranges(scene: Scene, mass: str | None, stiffness: str | None) -> tuple[Range, Range] | None:
    """Returns the ranges of mass and stiffness that hands add; None if neither option is given. Raises UsageError."""
    if mass is None and stiffness is None:
        return None
    if scene.device.is_admittance:
        key = "--hand-mass" if mass is not None else "--hand-stiffness"
        expected = "expected the hand in the scene: device.assumed_hand takes spans, such as {from: 100, to: 2000}"
        raise UsageError(f"{key}: found a scene in admittance, {expected}")
    ranges = _range_of("--hand-mass", mass or "0", "kg"), _range_of("--hand-stiffness", stiffness or "0", "N/m")
    for point in scene.device_points.values():
        require_units(scene.units_of(point.channel), *ranges[0], *ranges[1])
    return ranges


def _range_of(option: str, text: str, unit: str) -> Range:
    parts: list[float] = [-1.0]
    with suppress(ValueError):
        parts = [quantity(option, part, unit) for part in text.split(":")]
    low, *high = parts
    if len(high) > 1 or not 0.0 <= low <= (high or [low])[0] < math.inf:
        raise UsageError(f"{option}: found {text}, expected LOW:HIGH or one number, from 0 on, such as 0.1:2")
    return low, (high or [low])[0]


def any_hand_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields for each part of the scene the friction that makes it stable in any hands, the hands that make it
    oscillate, and the result for ordinary hands. Equal sentences are merged."""
    alike: dict[str, list[str]] = {}
    for one in (part.any_hand for part in prediction.parts if not part.is_admittance):
        sentence = f"{_passive(prediction, one)}{_ordinary(prediction, one)}"
        alike.setdefault(sentence, []).append(_who(one))
    for sentence, whose in alike.items():
        yield f"{', '.join(whose)}: {sentence}"


def _passive(prediction: Prediction, one: AnyHand) -> str:
    is_taken = prediction.assumptions or any(name in prediction.regions for name in one.names)
    taken = " (as assumed)" if is_taken else ""
    if one.is_passive is None or (one.grows and np.isnan(one.needed).any()):
        return f"passivity is unknown, because {one.not_derived or 'its numbers are out of range'}"
    if one.lasting:
        held = "the hands are" if len(one.names) > 1 else "the hand is"
        return (
            f"not passive{taken} at any friction: while {held} held, a motion of {escape(one.lasting)} at "
            f"{number(one.frequency_hz, 4)} Hz does not die out"
        )
    if one.pushes_away:
        return f"not passive{taken} at any friction: at rest, the scene pushes the hand away"
    if np.isinf(one.needed).any():
        return f"not passive{taken} at any friction that a device has"
    units = _units(prediction, one)
    friction = f"{_needed(one, units)} of friction (declared: {_numbers(one.friction, units)})"
    if one.grows and (one.friction >= one.needed).all():
        return f"unstable while {escape(one.grows)}; as assumed passive, which needs {friction}"
    if one.is_passive:
        return f"passive{taken}: stable in any hands (Colgate and Schenkel), which needs {friction}"
    return f"not passive{taken}: stability in any hands needs {friction}{_shaken(prediction, one)}"


def _units(prediction: Prediction, one: AnyHand) -> Units:
    """Returns the units of the part's hands."""
    motions = prediction.scene.device.motions(prediction.scene.channels)
    return Units.of([motions[channel] for channel in one.channels], prediction.scene.written)


def _ordinary(prediction: Prediction, one: AnyHand) -> str:
    """Returns a sentence about ordinary hands; "" if the scene is passive, unstable by itself or rotary."""
    is_linear = not _units(prediction, one).is_rotary
    if one.is_passive or one.grows or not is_linear or not prediction.stable_as_taken:
        return ""
    worst = one.worst_hand(*_ORDINARY)
    if worst is None:
        return ""
    units = _units(prediction, one)
    if worst.is_stable:
        most = f"{units(_ORDINARY[0][1], 'kg')} and {units(_ORDINARY[1][1], 'N/m')}"
        return f". It is stable with hands that add up to {most}"
    return f". [red]An ordinary hand makes it unstable[/red]: one that adds {_hands(one, worst, units)}"


def _hands(one: AnyHand, worst: WorstHand, units: Units) -> str:
    """Returns the mass and stiffness that the hands add."""
    each = zip(one.names, worst.masses, worst.stiffnesses, strict=True)
    several = len(one.names) > 1
    added = [
        f"{units(mass, 'kg', 3)}, {units(stiffness, 'N/m', 3)}{f' on {escape(name)}' if several else ''}"
        for name, mass, stiffness in each
        if mass or stiffness or not several
    ]
    return " and ".join(added) or "nothing"


def _who(one: AnyHand) -> str:
    return listed(f"[bold]{escape(name)}[/bold]" for name in one.names)


def _needed(one: AnyHand, units: Units) -> str:
    shown = [units.number(max(0.0, float(needed)), "N·s/m", rounded_up) for needed in one.needed]
    alike = len({*shown}) == 1
    if alike:
        return f"{units(shown[0], 'N·s/m')}{' each' if len(shown) > 1 else ''}"
    return f"{units(' and '.join(shown), 'N·s/m')}, in these proportions,"


def _numbers(friction: Any, units: Units) -> str:
    return " and ".join(dict.fromkeys(units.number(float(one), "N·s/m") for one in friction))


def _shaken(prediction: Prediction, one: AnyHand) -> str:
    """Returns the friction below which a single hand makes the scene oscillate, and that hand."""
    units = _units(prediction, one)
    least, hand = one.needed_for_one, one.shaking if prediction.stable_as_taken else None
    shown = units.number(least, "N·s/m", rounded_down)
    below = f"; below {shown}, a mass or a spring makes it oscillate" if least > 0.0 else ""
    if hand is None:
        return below
    holds = units(hand.mass, "kg", 3) if hand.mass else units(hand.stiffness, "N/m", 3)
    holds = f"a clamp of {holds}" if hand.stiffness > _CLAMP else f"another {holds}"
    on = f" on [bold]{escape(hand.name)}[/bold]" if len(one.names) > 1 else ""
    growth, hertz = number(hand.growth, 7), number(hand.frequency_hz, 4)
    return f"{below}; with {holds}{on} the oscillation grows {growth}-fold per sample, at {hertz} Hz"


def worst_hand_sentences(prediction: Prediction, ranges: tuple[Range, Range] | None) -> Iterator[str]:
    """Yields each part's stability with hands in these ranges of mass and stiffness, and the worst hand."""
    if ranges is None:
        return
    for one in (part.any_hand for part in prediction.parts):
        units, worst = _units(prediction, one), one.worst_hand(*ranges)
        if worst is None:
            yield f"Hands on {_who(one)}: not worked out, because the loop has too many masses or too long a delay"
            continue
        verdict = "[green]all tested are stable[/green]" if worst.is_stable else "[red]some are unstable[/red]"
        of = f"{_low_to_high(ranges[0], 'kg', units)} and {_low_to_high(ranges[1], 'N/m', units)} to {_who(one)}"
        radius = number(worst.spectral_radius, 9)
        yield f"Hands that add {of}: {verdict}. The worst adds {_hands(one, worst, units)} (spectral radius {radius})"


def _low_to_high(values: Range, unit: str, units: Units) -> str:
    low, high = values
    return units(high, unit) if low == high else f"{units.number(low, unit)} to {units(high, unit)}"


def any_hand_document(one: AnyHand, ranges: tuple[Range, Range] | None) -> dict[str, Any]:
    """Returns a part in other hands as a JSON document. `ranges`: of the mass and stiffness that they add."""
    worst = one.worst_hand(*ranges) if ranges else None
    return pick(one, one.DOCUMENT) | {"worst_hand": worst and pick(worst, "* stable=is_stable")}
