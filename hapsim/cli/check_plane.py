"""Lines of `hapsim check` about a scene in the plane: places, principal directions, slides, and stretches of a line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from hapsim.cli.output import Line, output_units, table
from hapsim.documents import pick
from hapsim.number_format import duration, number

if TYPE_CHECKING:
    from hapsim.prediction import FeltTogether, Prediction
    from hapsim.prediction.predict_plane import PlanePrediction, Stretch
    from hapsim.scene import Scene
    from hapsim.scene.chain import Point

_NONE = 1e-9  # of the largest stiffness: what rounding leaves
_DIRECTION = "angle_deg k=felt.k b=felt.b desired_k desired_b static_stiffness=static"


def in_plane(prediction: Prediction) -> PlanePrediction | None:
    """Returns the prediction if it is of a scene in the plane."""
    from hapsim.prediction.predict_plane import PlanePrediction

    return prediction if isinstance(prediction, PlanePrediction) else None


def is_sliding(prediction: Prediction) -> bool:
    """Returns whether a hand or a mass slides off, and nothing shakes."""
    plane = in_plane(prediction)
    return plane is not None and plane.verdict == "slides"


def is_held(prediction: Prediction) -> bool:
    """Returns whether a hand can be measured where it is: on a line, or in the plane where a link acts on it and it
    does not slide off."""
    plane = in_plane(prediction)
    if plane is None:
        return True
    return not is_sliding(prediction) and any(one.acts and plane.hands[0] in one.link.between for one in plane.links)


def slide_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields the slides, the fastest first; nothing on a line."""
    for one in getattr(prediction, "slides", ()):
        slides = "slides off" if f"{one.module}.x" in prediction.scene.device_points else "moves off"
        fast = f"grows e-fold in {duration(one.e_fold_s)}"
        yield f"{escape(one.module)} {slides} along {_angle(one.angle_deg)}: {fast}"


def place_lines(prediction: Prediction) -> Iterator[Line]:
    """Yields where the hands are, and the states of the links there; nothing on a line."""
    if (plane := in_plane(prediction)) is None:
        return
    units = output_units()
    hands = [f"{escape(name)} at {_place(plane.places[name])} {units.name('mm')}" for name in plane.hands]
    states = [f"{escape(one.name)} is {one.state}" for one in plane.links if one.acts and one.state]
    yield f"{', '.join(hands)}: {', '.join(states) or 'no contact is touched'}"
    yield from (f"Also, {sentence}" for sentence in [*slide_sentences(plane)][1:])


def principal_rows(prediction: PlanePrediction, together: FeltTogether) -> Iterator[tuple[str, ...]]:
    """Yields rows for each hand along its principal directions, as of `check_hands.together_lines`."""
    for name in (one for one in prediction.hands if f"{one}.x" in together.names):
        every = prediction.principal(name)
        least = _NONE * max((abs(one.static) for one in every), default=0.0)
        for one in every:
            units, who = output_units(), f"{escape(name)} at {_angle(one.angle_deg)}"
            k = (units.number(value * (abs(value) > least), "N/m") for value in (one.desired_k, one.felt.k, one.static))
            b = (units.number(value, "N·s/m") for value in (one.desired_b, one.felt.b))
            yield f"{who}: k", *k, units.name("N/m")
            yield f"{who}: b", *b, "", units.name("N·s/m")


def principal_document(prediction: PlanePrediction, together: FeltTogether) -> list[dict[str, Any]]:
    """Returns the same as a JSON document."""
    hands = [name for name in prediction.hands if f"{name}.x" in together.names]
    return [{"hand": name} | pick(one, _DIRECTION) for name in hands for one in prediction.principal(name)]


def plane_document(prediction: Prediction) -> dict[str, Any]:
    """Returns the keys of `hapsim check --json` that a scene in the plane has alone."""
    if (plane := in_plane(prediction)) is None:
        return {}
    links = {one.name: pick(one, "distance_m=distance state normal force_n=tension") for one in plane.links if one.acts}
    return {"verdict": plane.verdict, "places_m": plane.places, "links": links, "slides": plane.slides}


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
    felt = one.middle.principal(one.middle.hands[0])
    cells = [output_units().number(each.felt.k, "N/m", 4) for each in felt] or ["–", "–"]
    angle = _angle(felt[0].angle_deg) if felt else "–"
    states = {name: "" if state == "touched" else state for name, state in one.links.items()}
    links = ", ".join(f"{escape(name)} {state}".rstrip() for name, state in states.items())
    return _place(one.begin), _place(one.end), links or "none", cells[0], angle, cells[1], one.middle.verdict


def _stretch_document(one: Stretch) -> dict[str, Any]:
    (hand, *_), middle = one.middle.hands, one.middle
    directions = [pick(each, _DIRECTION) for each in middle.principal(hand)]
    return pick(one, "from_m=begin to_m=end links verdict=middle.verdict slides=middle.slides") | {
        "principal": directions
    }


def _place(place: Point) -> str:
    """Returns x and y to the nanometre: a boundary that halving found beside 0 is printed as 0."""
    return ", ".join(output_units().number(round(value, 9) + 0.0, "mm", 4) for value in place)


def _angle(degrees: float) -> str:
    return f"{number(round(degrees, 6), 4)}°"
