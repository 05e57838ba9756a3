"""The checks of a scene's space: what its modules need to have one coordinate, or two."""

from collections.abc import Iterator, Mapping
from typing import Any

from hapsim.dampers import DAMPERS

from .chain import TooRoundError
from .issue import Issue, one_of
from .modules.links import Nonlinear, ViscoElastic
from .modules.point_modules import DevicePoint
from .modules.surfaces import Shape, crossed, surfaces_of
from .schemas import MOST_CHANNELS
from .section import Module, ModuleContext
from .values import Area
from .written_units import in_si

#: What a scene with two coordinates takes alone, by its path.
_ALONE = {
    ("scheme",): ("cordis", "the scheme that moves its points"),
    ("device", "correction"): ("none", "corrections are derived for one coordinate"),
    ("device", "motion"): ("linear", "x and y are lengths"),
    ("device", "decimation"): ("last", "the mean of forces is derived for one coordinate"),
}


def space_issues(around: ModuleContext, scene: Mapping[str, object], device: Mapping[str, object]) -> Iterator[Issue]:
    """Yields what does not fit the scene's space. `device`: its sound fields."""
    space = scene.get("space", 1)
    if space not in (1, 2):
        return
    for name, module in around.modules.items():
        kind = around.kinds[name]
        if kind is not None and space not in kind.spaces:
            sentence = f"found {module.type} in a scene with space: {space}, expected {one_of(_types(space))}"
            if kind.spaces == (2,):
                sentence = f"found {module.type} in a scene with one coordinate; write space: 2"
            yield Issue(("modules", name, "type"), sentence)
        else:
            yield from _of_one(name, module, around) if space == 1 else _of_two(name, module, around)
    if isinstance(travel := device.get("travel"), Area | dict):
        yield from _travel_issues(travel if isinstance(travel, dict) else travel.model_dump(), space, around)
    if space == 2:
        for path, (right, why) in _ALONE.items():
            found = (device if path[1:] else scene).get(path[-1], right)
            if (isinstance(found, str) and found != right) or isinstance(found, list | tuple):
                shown = found if isinstance(found, str) else "a list"
                yield Issue(path, f"found {shown} in a scene with space: 2, expected {right}: {why}")
        yield from _surface_issues(around)
        if scene.get("sound"):
            yield Issue(("sound",), "found pick-ups in a scene with space: 2, expected none", at_key=True)


def _surface_issues(around: ModuleContext) -> Iterator[Issue]:
    """Yields surfaces that leave no place free, or that have no outline."""
    shapes = around.of_type(Shape, "form", "round", "side", "between")
    for surface in surfaces_of({name: one for name, one in shapes.items() if one.form.fault() is None}):
        try:
            _ = surface.outline
        except TooRoundError:
            continue  # its own check has found it
        except ValueError as error:
            *others, last = surface.shapes
            hand, with_others = surface.between[0], f"together with {', '.join(others)}"
            sentence = f"found a form that, {with_others}, leaves no place free"
            is_full = type(error) is not ValueError  # else the error is a sentence
            yield Issue(("modules", last, "form"), f"{sentence}; expected room for {hand}" if is_full else str(error))


def _travel_issues(travel: dict[str, Any], space: object, around: ModuleContext) -> Iterator[Issue]:
    """Yields what does not fit an area, as the file has it."""
    kind = "polygon" if "polygon" in travel else "disc"
    path = ("device", "travel")
    if space == 1:
        yield Issue(path, f"found a {kind} in a scene with one coordinate, expected [the least, the most]")
    for name, hand in around.of_type(DevicePoint).items():
        if hand.channels and hand.channels != (x := hand.channels[0] // 2 * 2, x + 1):
            sentence = f"found a {kind} with {name} on channels {list(hand.channels)}, expected a list of pairs"
            yield Issue(path, f"{sentence}, one per channel; or channels such as [{x}, {x + 1}]")
    corners = [[in_si(one, "m") if isinstance(one, str) else one for one in each] for each in travel.get("polygon", ())]
    if corners and (why := crossed(tuple((x, y) for x, y in corners), closed=True)):
        yield Issue((*path, "polygon"), why)


def _types(space: int) -> list[str]:
    from .modules import MODULE_TYPES

    return [name for name, kind in MODULE_TYPES.items() if space in kind.spaces]


def _of_one(name: str, module: Module, around: ModuleContext) -> Iterator[Issue]:
    for field in module.model_fields_set:
        if (
            field in ("position", "velocity")
            and around.knows(name, field)
            and isinstance(getattr(module, field), tuple)
        ):
            sentence = "found two coordinates, expected a number (m); or write space: 2"
            yield Issue(("modules", name, field), sentence)
    if isinstance(module, DevicePoint) and around.knows(name, "channel", "channels"):
        if module.channels is not None:
            sentence = "found channels in a scene with one coordinate, expected channel; or write space: 2"
            yield Issue(("modules", name, "channels"), sentence)
        elif module.channel is None:
            sentence = f"'channel' is missing, expected a whole number from 0 to {MOST_CHANNELS - 1}"
            yield Issue(("modules", name), sentence, at_key=True)
    if around.knows(name, "length") and getattr(module, "length", None) is not None:
        sentence = "found a length in a scene with one coordinate, where a link is at rest where its ends coincide"
        yield Issue(("modules", name, "length"), f"{sentence}; expected none, or space: 2", at_key=True)


def _of_two(name: str, module: Module, around: ModuleContext) -> Iterator[Issue]:
    for field in ("position", "velocity"):
        if field in module.model_fields_set and around.knows(name, field):
            found = getattr(module, field)
            if not isinstance(found, tuple) and found != 0.0:
                unit = "m" if field == "position" else "m/s"
                sentence = f"found ‹{found!r} {unit}› alone, expected [x, y] in a scene with space: 2"
                yield Issue(("modules", name, field), sentence)
    if isinstance(module, DevicePoint) and around.knows(name, "channel", "channels") and not module.channels:
        found = "no channels" if module.channel is None else "channel"
        sentence = f"found {found}, expected channels: two of the device, of x and y, in a scene with space: 2"
        yield Issue(("modules", name, *(() if module.channel is None else ("channel",))), sentence, at_key=True)
    elif isinstance(module, DevicePoint) and module.channel is not None:
        yield Issue(("modules", name, "channel"), "found channel beside channels, expected channels alone", at_key=True)
    if isinstance(module, ViscoElastic) and around.knows(name, "damper") and module.damper != "backward":
        sentence = f"found {module.damper} in a scene with space: 2, expected backward"
        yield Issue(("modules", name, "damper"), f"{sentence}, {DAMPERS['backward'].meaning}")
    if isinstance(module, Nonlinear) and around.knows(name, "force_over_velocity") and module.force_over_velocity:
        sentence = "found a curve over velocity in a scene with space: 2, expected force_over_distance alone"
        yield Issue(("modules", name, "force_over_velocity"), sentence, at_key=True)
    if isinstance(module, Nonlinear) and around.knows(name, "force_over_distance") and module.branches:
        sentence = "found two branches in a scene with space: 2, expected one list of points"
        yield Issue(("modules", name, "force_over_distance"), sentence)
