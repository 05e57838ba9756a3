"""Lines of `hapsim check` about a scene in the plane: places, principal directions, slides, and stretches of a line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from hapsim.cli.output import Line, output_units, table
from hapsim.documents import pick
from hapsim.number_format import angle
from hapsim.prediction.verdict_words import slide_sentences

if TYPE_CHECKING:
    from hapsim.prediction import Prediction
    from hapsim.prediction.predict_plane import Stretch
    from hapsim.scene import Scene
    from hapsim.scene.chain import Point

ALONG = "hand angle_deg k b desired_k desired_b static_stiffness"
"""Keys of what a hand feels along a direction."""


def place_lines(prediction: Prediction) -> Iterator[Line]:
    """Yields where the hands are, and the states of the links there; nothing on a line."""
    if not prediction.hands:
        return
    units = output_units()
    hands = [f"{escape(name)} at {_place(prediction.places[name])} {units.name('mm')}" for name in prediction.hands]
    states = [f"{escape(one.name)} is {one.state}" for one in prediction.links if one.acts and one.state]
    yield f"{', '.join(hands)}: {', '.join(states) or 'no contact is touched'}"
    yield from (f"Also, {sentence}" for sentence in [*slide_sentences(prediction)][1:])


def here_document(prediction: Prediction) -> dict[str, Any]:
    """Returns the scene as it is linearised: its poles and verdict; in the plane, its places, links and slides too."""
    here = pick(prediction, "verdict=verdict_here stable=stable_as_taken spectral_radius=spectral_radius_here")
    here |= pick(prediction, "poles_in_all poles")
    here["poles_method"] = prediction.poles_method or "every pole (memories, at zero, are not listed)"
    if not prediction.hands:
        return here
    acting = [one for one in prediction.links if one.acts]
    links = {one.name: pick(one, "distance_m=distance state normal force_n=tension") for one in acting}
    return here | {"places_m": prediction.places, "links": links, "slides": prediction.slides}


def along(scene: Scene, ends: Sequence[Point], json: bool) -> list[Line] | dict[str, Any]:
    """Returns the stretches of a line of the first hand: their table, or a JSON document."""
    from hapsim.prediction.predict_plane import stretches_along

    found = stretches_along(scene, *ends)
    if json:
        return {"along_m": ends, "stretches": [_stretch_document(one) for one in found]}
    units = output_units()
    headings = (f"<from  {units.name('mm')}", "<to", "<links", f"felt k  {units.name('N/m')}", "at", "felt k", "<")
    rows = [_stretch_row(one) for one in found]
    return [table("", headings, rows, "felt k: along the principal directions, in the middle", box=None)]


def _stretch_row(one: Stretch) -> tuple[str, ...]:
    cells = [output_units().number(each.k, "N/m", 4) for each in one.felt] or ["–", "–"]
    first = angle(one.felt[0].angle_deg) if one.felt else "–"
    states = {name: "" if state == "touched" else state for name, state in one.links.items()}
    links = ", ".join(f"{escape(name)} {state}".rstrip() for name, state in states.items())
    return _place(one.begin), _place(one.end), links or "none", cells[0], first, cells[1], one.middle.verdict_here


def _stretch_document(one: Stretch) -> dict[str, Any]:
    of_middle = "from_m=begin to_m=end links verdict=middle.verdict_here slides=middle.slides"
    return pick(one, of_middle) | {"principal": [pick(each, ALONG) for each in one.felt]}


def _place(place: Point) -> str:
    """Returns x and y to the nanometre: a boundary that halving found beside 0 is printed as 0."""
    return ", ".join(output_units().number(round(value, 9) + 0.0, "mm", 4) for value in place)
