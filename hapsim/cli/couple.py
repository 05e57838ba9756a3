"""`hapsim couple`: the stiffest virtual couplings of a scene's hands, and what they feel like."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.markup import escape

from hapsim.cli.command_options import Json, SceneFile, load, option, require_positive, require_units, scene_name
from hapsim.cli.live import at_work
from hapsim.cli.output import Line, document, show, stderr, stdout, table
from hapsim.number_format import number, rounded_down

if TYPE_CHECKING:
    from hapsim.prediction.virtual_coupling import HandCouplings
    from hapsim.scene import Scene
    from hapsim.units import Units


def couple(
    scene: SceneFile,
    json: Json = False,
    proxy_mass: float | None = option("KG", "Mass of the proxy in kg [default: a tenth of the hand's]", unit="kg"),
) -> None:
    """Choose a virtual coupling: a spring and a damper between the hand and the scene that keep any hand stable.

    A proxy stands in the scene for the hand, and the coupling joins both. A steady push meets the coupling's stiffness
    at most. Two are shown for each hand: one for any hand, and one for the hand of the scene alone. A hand that has a
    proxy is judged too.
    """
    from hapsim.prediction.virtual_coupling import virtual_couplings

    loaded = load(scene)
    for point in loaded.device_points.values():
        require_units(loaded.units_of(point.channel), proxy_mass)
    require_positive("--proxy-mass", proxy_mass, loaded.units.si.name("kg"))
    with at_work(stderr(), "searching for the stiffest couplings"):
        found = virtual_couplings(loaded, proxy_mass)
    if json:
        print(document({"scene": scene, "hands": found}))
    else:
        for one in found:
            show(stdout(), _lines(loaded, scene_name(scene), one))


def _lines(scene: Scene, name: str, one: HandCouplings) -> Iterator[Line]:
    units, (least, most) = scene.units_of(one.channel), one.masses
    hand = units(least, "kg") if least == most else f"{units.number(least, 'kg')} to {units(most, 'kg')}"
    couplings = {"any hand": one.any_hand, f"a hand of {hand}": one.this_hand, "(in the scene)": one.present}
    values = {who: (*of.coupling, of.k, of.b) for who, of in couplings.items() if of is not None}
    rows = [(who, *map(units.number, each, ("N/m", "N·s/m") * 2)) for who, each in values.items()]
    headings = ("<stable with", f"Kc  {units.name('N/m')}", f"Bc  {units.name('N·s/m')}", "felt k", "felt b")
    yield table(f"Virtual couplings of {escape(one.name)} in {escape(name)}", headings, rows)
    yield (
        "Felt: as the hand swings while the proxy stands still. A steady push meets Kc and the device's own spring at "
        "most."
    )
    if reason := next((of.reason for of in couplings.values() if of and of.reason), ""):
        yield f"–: no felt k and b, because {reason}."
    yield from _judgement(one, units)
    if one.present is not None:
        return
    if one.misfit:
        yield f"Not every link of the scene can end on a proxy. {escape(one.misfit)}"
    yield f"In the file, let the links of {escape(one.name)} end at {escape(one.name)}_proxy, and add under modules:"
    stiffness, damping = (rounded_down(value, 6) for value in one.any_hand.coupling)
    lines = (
        f"  {one.name}_proxy:",
        "    type: proxy",
        f"    hand: {one.name}",
        f"    mass: {number(one.proxy_mass)}",
        f"    stiffness: {stiffness}",
        f"    damping: {damping}",
    )
    yield from map(escape, lines)


def _judgement(one: HandCouplings, units: Units) -> Iterator[str]:
    """Yields what is felt with nothing behind the scene's coupling, or else the first one, and what it needs."""
    from hapsim.prediction import HAND_STIFFNESS

    own, whose = (one.any_hand, "the first coupling") if one.present is None else (one.present, "the scene's coupling")
    declared = f"(declared: {units.number(one.friction, 'N·s/m')})"
    if math.isfinite(own.free_b):
        by = f"(of {units(one.proxy_mass, 'kg')}, moved by a hand of {units(HAND_STIFFNESS, 'N/m')})"
        weight = f" and {units(own.free_mass, 'kg', 4)} {by}" if math.isfinite(own.free_mass) else ""
        yield f"With nothing behind {whose}, the hand feels {units(own.free_b, 'N·s/m')}{weight} and no stiffness."
    needs = f"needs a friction of {units(own.needed_friction, 'N·s/m')} {declared} for any hand, if what is behind it"
    yield f"{whose.capitalize()} {needs} is passive in the backward difference (walls, contacts, springs, dampers)."
    if one.is_passive_behind:
        yield "In this scene it is."
    elif not one.misfit:
        needed = units(one.needed_friction, "N·s/m") if math.isfinite(one.needed_friction) else "unknown"
        why = "it has masses with explicit steps, a force that falls with distance, or another link at the hand"
        yield f"In this scene it is not: {why}. The friction that the scene needs for any hand is {needed} {declared}."
        yield from (f"Assumed: {escape(sentence)}." for sentence in one.assumptions)
