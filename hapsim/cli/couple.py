"""`hapsim couple`: the stiffest virtual couplings of a scene's hands, and what they feel like."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from hapsim.cli.command_options import Json, SceneFile, load, option, require_positive, require_units, scene_name
from hapsim.cli.live import at_work
from hapsim.cli.output import Line, document, show, stderr, stdout, table
from hapsim.number_format import number, rounded_down

if TYPE_CHECKING:
    from hapsim.prediction.virtual_coupling import FeltCoupling, HandCouplings
    from hapsim.scene import Scene


def couple(
    scene: SceneFile,
    json: Json = False,
    proxy_mass: float | None = option("KG", "Mass of the proxy in kg [default: a tenth of the hand's]", unit="kg"),
) -> None:
    """Choose a virtual coupling: a spring and a damper between the hand and the scene that keep any hand stable.

    A proxy stands in the scene for the hand, and the coupling joins both. The hand feels the coupling's stiffness at
    most. Two are shown for each hand: one for any hand, and one for the hand of the scene alone.
    """
    from hapsim.prediction.virtual_coupling import virtual_couplings

    loaded = load(scene)
    for point in loaded.device_points.values():
        require_units(loaded.units_of(point.channel), proxy_mass)
    require_positive("--proxy-mass", proxy_mass, loaded.units.si.name("kg"))
    with at_work(stderr(), "searching for the stiffest couplings"):
        found = virtual_couplings(loaded, proxy_mass)
    if json:
        print(document({"scene": scene, "hands": [couplings_document(one) for one in found]}))
    else:
        for one in found:
            show(stdout(), _lines(loaded, scene_name(scene), one))


def _lines(scene: Scene, name: str, one: HandCouplings) -> Iterator[Line]:
    units, (least, most) = scene.units_of(one.channel), one.masses
    hand = units(least, "kg") if least == most else f"{units.number(least, 'kg')} to {units(most, 'kg')}"
    rows = [
        _row(scene, one, who, of)
        for who, of in (("any hand", one.any_hand), (f"a hand of {hand}", one.this_hand))
        if of is not None
    ]
    headings = ("<stable with", f"Kc  {units.name('N/m')}", f"Bc  {units.name('N·s/m')}", "felt k", "felt b")
    yield table(f"Virtual couplings of {escape(one.name)} in {escape(name)}", headings, rows)
    yield "Felt: while the proxy stands still. No scene holds the hand with more stiffness than Kc."
    proxy, needed = units(one.proxy_mass, "kg"), units(one.needed_friction, "N·s/m")
    known = f"{needed} (declared: {units.number(one.friction, 'N·s/m')})"
    yield (
        "Stable is every scene behind it that is passive in the backward difference: walls, dampers, friction, masses "
        f"with implicit steps. Masses of a scene have explicit steps. With a proxy of {proxy} and the first coupling "
        f"this scene needs a friction of {known if math.isfinite(one.needed_friction) else 'an unknown size'}."
    )
    yield f"In the file, let the links of {escape(one.name)} end at {escape(one.name)}_proxy, and add under modules:"
    stiffness, damping = (rounded_down(value, 6) for value in one.any_hand.coupling)
    lines = (
        f"  {one.name}_proxy: {{type: mass, mass: {number(one.proxy_mass)}}}",
        f"  {one.name}_coupling:",
        "    type: viscoelastic",
        f"    between: [{one.name}, {one.name}_proxy]",
        f"    stiffness: {stiffness}",
        f"    damping: {damping}",
    )
    yield from map(escape, lines)


def _row(scene: Scene, one: HandCouplings, who: str, of: FeltCoupling) -> tuple[str, ...]:
    units = scene.units_of(one.channel)
    (stiffness, damping), k, b = of.coupling, units.number(of.k, "N/m"), units.number(of.b, "N·s/m")
    return who, units.number(stiffness, "N/m"), units.number(damping, "N·s/m"), k, b


def couplings_document(one: HandCouplings) -> dict[str, Any]:
    """Returns the couplings of one hand as a JSON document."""

    def shown(of: FeltCoupling | None) -> dict[str, float] | None:
        return None if of is None else {**of.coupling._asdict(), "k": of.k, "b": of.b}

    return {
        "name": one.name,
        "channel": one.channel,
        "friction": one.friction,
        "any_hand": shown(one.any_hand),
        "this_hand": shown(one.this_hand),
        "proxy_mass": one.proxy_mass,
        "needed_friction": one.needed_friction,
    }
