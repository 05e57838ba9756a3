"""What `hapsim check` prints of hands that move masses, or each other."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.markup import escape

from hapsim.cli.output import spoken, table
from hapsim.documents import pick
from hapsim.number_format import number
from hapsim.units import Units

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.prediction import FeltTogether, Prediction, Weight

_FREQUENCIES = 5  # of a sentence


def show_together(out: Console, prediction: Prediction) -> None:
    """Prints k, b and static stiffness of these hands beside what was asked for, and what they are of."""
    rows = [row for one in prediction.together for row in _rows(one)]
    if rows:
        out.print(table("", ("", "asked for", "felt", "static", ""), rows, box=None))
    for sentence in _sentences(prediction):
        out.print(sentence)


def _rows(together: FeltTogether) -> Iterator[tuple[str, str, str, str, str]]:
    """Yields rows for each hand, and for each pair of hands: what the first feels of the second."""
    felt, asked, static = together.felt, together.asked_for, together.static_stiffness
    if felt.reason:
        return
    names = [escape(name) for name in together.names]
    for i, name in enumerate(names):
        others = [(j, 1.0, name) if j == i else (j, -1.0, f"{name} of {names[j]}") for j in range(len(names))]
        for j, sign, who in sorted(others, key=lambda one: one[0] != i):
            unit = spoken(together.channels[i])
            k, b = (number(sign * float(one[i, j])) for one in (felt.k, felt.b))
            wanted_k, wanted_b = (number(sign * float(one[i, j])) for one in (asked.k, asked.b))
            yield f"{who}: k", wanted_k, k, number(sign * float(static[i, j])), unit.name("N/m")
            yield f"{who}: b", wanted_b, b, "", unit.name("N·s/m")


def _sentences(prediction: Prediction) -> Iterator[str]:
    """Yields what the rows are of, or what is felt where there are none."""
    for one in prediction.together:
        whys = "; ".join(f"[bold]{escape(name)}[/bold] {escape(prediction.coupled[name])}" for name in one.names)
        felt = one.felt
        if not felt.reason:
            held = " (of another hand: as of a spring and damper between them)" if len(one.names) > 1 else ""
            yield (
                f"{whys}. Felt are the spring and damper that it swings on{held}; asked for are the same without "
                "sampling and delay"
            )
        else:
            yield f"{whys}: no single k and b say what it feels, for {felt.reason}{_modes(felt.frequencies_hz)}"
            yield from (_at_frequencies(one, i, spoken(channel)) for i, channel in enumerate(one.channels))
        if (weight := _weight_of(prediction, one)) is not None:
            yield _weight(weight)


def _weight_of(prediction: Prediction, one: FeltTogether) -> Weight | None:
    """Return its weight; None for rotary motion, for which `HAND_STIFFNESS` is no hand's."""
    motions = prediction.scene.device.motions(prediction.scene.channels)
    return one.weight if motions[one.channels[0]] == "linear" else None


def _modes(frequencies: tuple[float, ...]) -> str:
    if not frequencies:
        return ""
    shown = [number(one, 3) for one in sorted(frequencies[:_FREQUENCIES])]
    *first, last = shown
    return f" (modes of {', '.join(first)} and {last} Hz)" if first else f" (a mode of {last} Hz)"


def _at_frequencies(one: FeltTogether, i: int, units: Units) -> str:
    from hapsim.prediction import HAND_HZ

    static, (k_moved, b_moved) = float(one.static_stiffness[i, i]), one.at_frequencies
    pairs = zip(HAND_HZ, k_moved[i].tolist(), b_moved[i].tolist(), strict=True)
    moved = [f"at {hz:g} Hz {units(k, 'N/m', 4)} and {units(b, 'N·s/m', 3)}" for hz, k, b in pairs if math.isfinite(k)]
    inertia = " (below 0: there it feels a mass, no spring)" if any(k < 0.0 for k in k_moved[i]) else ""
    on, it = "", ", the hand"
    if len(one.names) > 1:
        on, it = f" on {escape(one.names[i])}", " while the others are held, it"
    steady = f"A steady push{on} meets {units(static, 'N/m', 4)}"
    return f"{steady}; moved to and fro{it} meets {', '.join(moved)}{inertia}"


def _weight(weight: Weight) -> str:
    """Returns what a linear hand feels of masses."""
    from hapsim.prediction import HAND_STIFFNESS

    told = f"The free masses weigh {number(weight.mass, 4)} kg. Shaken by a hand of {HAND_STIFFNESS:g} N/m they feel "
    told += f"like {number(weight.felt, 4)} kg (without sampling and delay: {number(weight.continuous, 4)} kg)"
    if math.isfinite(weight.within_10_percent_hz):
        told += f". Up to {number(weight.within_10_percent_hz, 2)} Hz they feel like themselves, within 10 %"
    if math.isfinite(weight.to_simulate):
        told += f". Simulate {number(weight.to_simulate, 4)} kg to feel {number(weight.mass, 4)}"
    return told


def together_document(prediction: Prediction) -> list[dict[str, Any]]:
    """Returns the same as a JSON document."""
    from hapsim.prediction import HAND_HZ

    return [
        {
            "device_points": one.names,
            "k": _matrix(one.felt.k),
            "b": _matrix(one.felt.b),
            "continuous": {"k": _matrix(one.asked_for.k), "b": _matrix(one.asked_for.b)},
            "static_stiffness": _matrix(one.static_stiffness),
            **pick(one.felt, "kinetic_share=share other_motions=others frequencies_hz reason"),
            "weight": _weight_of(prediction, one),
            "moved": [
                {"frequency_hz": hz, "k": k, "b": b}
                for hz, k, b in zip(HAND_HZ, *(part[0].tolist() for part in one.at_frequencies), strict=True)
            ],
        }
        for one in prediction.together
    ]


def _matrix(values: np.ndarray[Any, Any]) -> Any:
    return values if np.isfinite(values).all() else None
