"""A scene of several devices, each at a port of its own: the scene at each port, and what does not fit together.

The scene at a port is one of one device: its points, the links that touch them, and the simulated masses if it is the
leader. Points of other devices at the far ends of these links are *away*: they are device points of that scene too, on
channels behind its own, where the loop puts the positions that the other devices publish.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, Field, PlainSerializer

from .addresses import address_of, is_address
from .choices import WITH_SENSOR
from .issue import Issue, Path, did_you_mean, one_of, quote
from .modules.links import Link
from .modules.point_modules import DevicePoint, Proxy
from .modules.structures import Structure
from .quantity import NAME, quantity, text
from .schemas import MOST_CHANNELS
from .section import Module, ModuleContext, Section, Table

CLOCK_KEYS = ("clock_ppm", "phase")
"""The keys of a mock that compare its clock with those of others."""

_LOCAL = {"localhost": "127.0.0.1"}
_HEADS = {"device": "devices", "mock": "mocks"}

_DEVICE = text("Name of the device", "the name of a device", ".+")
_POINT = text("The point in the scene of all devices", "the name of a point", ".+")


class Away(Section):
    """A point that another device brings."""

    device: Annotated[str, _DEVICE]
    point: Annotated[str, _POINT]
    friction: Annotated[float, quantity("Viscous friction of its device", "N·s/m", least=0)] = 0.0


def _written(away: Mapping[str, Away]) -> dict[str, Any]:
    return {name: one.model_dump() for name, one in away.items()}


class AtDevice(Section):
    """The device whose scene this is, of a scene of several: in records."""

    device: Annotated[str, _DEVICE]
    away: Annotated[
        Mapping[Annotated[str, NAME], Away],
        AfterValidator(Table),
        PlainSerializer(_written),
        Field(description="The points that other devices bring, by name"),
    ]


class AwayPoint(NamedTuple):
    """A point that another device brings, in the scene at a port.

    Attributes:
        name: of the device point in the scene at the port.
        port: the device that brings it.
        point: its name in the scene of all devices, such as "string.3".
        channel: in the scene at the port, behind its own.
        friction: of the device that brings it, N·s/m; 0 of a simulated mass.
    """

    name: str
    port: str
    point: str
    channel: int
    friction: float = 0.0


def device_names(scene: Mapping[str, object]) -> tuple[str, ...]:
    """Returns the names of a scene's devices, made or as written; () if it has one device without a name."""
    devices = scene.get("devices")
    return tuple(devices) if isinstance(devices, Mapping) else ()


def paths_at(name: str | None, paths: Collection[Path]) -> dict[Path, Path]:
    """Returns where these parts of a device and its mock stand in the scene, by their paths in a scene of one."""
    return {path: path if name is None else (_HEADS[str(path[0])], name, *path[1:]) for path in paths}


class Owners:
    """The device that each module moves with: a device point with its own, a proxy with its hand, everything else that
    moves with the leader. Grounds and links have none."""

    def __init__(self, around: ModuleContext, leader: object) -> None:
        self._around, self._leader = around, leader if isinstance(leader, str) else None

    def of_point(self, end: str) -> str | None:
        """Returns the device that the end of a link moves with; None for what moves with none, or is faulty."""
        around, name = self._around, self._around.holder(end)
        module = around.modules.get(name)
        if isinstance(module, Proxy):
            module = around.modules.get(module.hand) if around.knows(name, "hand") else None
        if isinstance(module, DevicePoint):
            return module.of if around.knows(name, "of") else None
        return self._leader if isinstance(module, Structure) or (module and module.can_move) else None

    def of_ends(self, name: str) -> dict[str, str | None]:
        """Returns the device of each end of a link; none for another module, or where the ends are faulty."""
        link = self._around.modules.get(name)
        known = isinstance(link, Link) and self._around.knows(name, "between")
        return {end: self.of_point(end) for end in link.between} if known else {}  # type: ignore[union-attr]

    def across(self) -> dict[str, frozenset[str]]:
        """Returns the links between two devices: the names of both, by link."""
        found = {name: frozenset(one for one in self.of_ends(name).values() if one) for name in self._around.modules}
        return {name: both for name, both in found.items() if len(both) > 1}


def modules_at(around: ModuleContext, owners: Owners, port: str) -> tuple[ModuleContext, tuple[AwayPoint, ...]]:
    """Returns the modules of the scene at a port, and its away points, on the last channels: a device may have more
    than its scene uses.

    Args:
        around: the modules of all devices, of which some may be faulty.
        owners: of these modules.
        port: the device.
    """
    own = {name for name in around.modules if owners.of_point(name) == port}
    ends = {name: owners.of_ends(name) for name in around.modules}
    links = [name for name, found in ends.items() if port in found.values()]
    ends_away = {end: str(one) for name in links for end, one in ends[name].items() if one not in (port, None)}
    away = dict[str, AwayPoint]()
    for channel, (end, owner) in enumerate(ends_away.items(), MOST_CHANNELS - len(ends_away)):
        taken = {*around.modules} | {one.name for one in away.values()}
        away[end] = AwayPoint(_free_name(end, taken), owner, end, channel)
    points = {one.name: DevicePoint(channel=one.channel) for one in away.values()}
    grounds = {around.holder(end) for name in links for end, owner in ends[name].items() if owner is None}
    names = {end: one.name for end, one in away.items()}
    modules = dict[str, Module]()
    for name, module in around.modules.items():
        if name in own or name in links or name in grounds:
            modules[name] = _at_port(module, names)
        elif name in points:
            modules[name] = points[name]
    modules |= points
    kinds = {name: DevicePoint if name in points else around.kinds[name] for name in modules}
    return ModuleContext(modules, kinds, around.faulty, frozenset(points)), tuple(away.values())


def _at_port(module: Module, away: Mapping[str, str]) -> Module:
    """Returns a module as the scene at a port has it. `away`: names of points there, by those in the whole scene."""
    if isinstance(module, DevicePoint):
        return module.model_copy(update={"of": None})
    if isinstance(module, Link) and away.keys() & {*module.between}:
        return module.model_copy(update={"between": tuple(away.get(end, end) for end in module.between)})
    return module


def _free_name(end: str, taken: Collection[str]) -> str:
    """Returns the name of an away point: that of its module, or one like "string-3" for a point of a structure."""
    name = end.replace(".", "-")
    while name != end and name in taken:
        name += "_"
    return name


def at_port_issue(issue: Issue, port: str) -> Issue:
    """Returns an issue of the scene at a port as one of the scene of all devices."""
    if issue.path and issue.path[0] in _HEADS:
        issue = replace(issue, path=(_HEADS[str(issue.path[0])], port, *issue.path[1:]))
    words = re.sub(r"\b(device|mock)\.(?=[a-z])", lambda found: f"{_HEADS[found[1]]}.{port}.", issue.sentence)
    return replace(issue, sentence=words)


def port_issues(around: ModuleContext, scene: Mapping[str, Any]) -> Iterator[Issue]:
    """Yields what does not fit together between the devices of a scene, made or as written."""
    names = device_names(scene)
    points = around.of_type(DevicePoint)
    if not names:
        yield from _issues_of_one(points, scene)
        return
    for key, instead in (("device", "devices"), ("mock", "mocks")):
        if scene.get(key) is not None:
            expected = f"expected {instead} alone: move what it says to {instead}.{names[0]}, or to another"
            yield Issue((key,), f"found {key} beside devices, {expected}", at_key=True)
    if len(names) == 1:
        yield Issue(("devices",), f"found {names[0]} alone, expected two devices or more; or write device", at_key=True)
    leader, mocks = scene.get("leader"), scene.get("mocks")
    if isinstance(leader, str) and leader not in names:
        yield Issue(("leader",), f"found {quote(leader)}, {_a_device(leader, names)}")
    for name in mocks if isinstance(mocks, Mapping) else ():
        if name not in names:
            yield Issue(("mocks", name), f"found {quote(name)}, {_a_device(name, names)}", at_key=True)
    for name in names:
        if name in around.kinds or name in (scene.get("sound") or ()):
            sentence = "found the name of a module or a pick-up too; expected one of its own"
            yield Issue(("devices", name), sentence, at_key=True)
    yield from _issues_of_points(points, around, names)
    yield from _issues_of_devices(scene, names)
    for key in ("inputs", "outputs"):
        if scene.get(key):
            sentence = "found digital words in a scene with several devices, expected none: of which is not stated"
            yield Issue((key,), sentence, at_key=True)
    if scene.get("space", 1) != 1:
        yield Issue(("space",), "found 2 with several devices, expected 1: their points are tied along a line")
    yield from _issues_across(around, scene, names)


def _issues_of_one(points: Mapping[str, DevicePoint], scene: Mapping[str, Any]) -> Iterator[Issue]:
    """Yields what only a scene of several devices can have."""
    for key in ("mocks", "leader"):
        if scene.get(key):
            expected = "expected it beside devices, such as devices: {left: …, right: …}"
            yield Issue((key,), f"found {key} in a scene of one device, {expected}", at_key=True)
    for name, point in points.items():
        if point.of is not None:
            sentence = f"found {quote(point.of)} in a scene of one device, expected no of; or write devices"
            yield Issue(("modules", name, "of"), sentence)
    mock = scene.get("mock") or {}
    for key in CLOCK_KEYS if scene.get("at") is None else ():
        if mock.get(key) if isinstance(mock, Mapping) else getattr(mock, key, None):
            sentence = f"found a {key} in a scene of one device, whose clock differs from no other"
            yield Issue(("mock", key), f"{sentence}; expected it in mocks, beside devices", at_key=True)


def _a_device(found: str, names: Collection[str]) -> str:
    return f"expected the name of a device: {one_of(names)}{did_you_mean(found, names)}"


def _issues_of_points(
    points: Mapping[str, DevicePoint], around: ModuleContext, names: Collection[str]
) -> Iterator[Issue]:
    """Yields device points of no device, and devices without one."""
    for name, point in points.items():
        if point.of is None and around.knows(name, "of"):
            sentence = f"'of' is missing, expected the name of a device: {one_of(names)}"
            yield Issue(("modules", name), sentence, at_key=True)
        elif point.of is not None and point.of not in names:
            yield Issue(("modules", name, "of"), f"found {quote(point.of)}, {_a_device(point.of, names)}")
    held = {point.of for point in points.values()}
    for name in names if None not in around.kinds.values() and None not in held else ():
        if name not in held:
            sentence = f"no module holds it, expected one such as {{type: device, of: {name}, channel: 0}}"
            yield Issue(("devices", name), sentence, at_key=True)


def _issues_of_devices(scene: Mapping[str, Any], names: Collection[str]) -> Iterator[Issue]:
    """Yields ports that are one, and clocks of several kinds."""
    places, clocks = dict[str, str](), dict[str, str]()
    for name in names:
        if isinstance(port := _stated(scene, name, "port"), str):
            first = places.setdefault(same_port(port), name)
            if first != name:
                sentence = f"found {quote(port)}, the port of {first} too; expected another port for each device"
                yield Issue(("devices", name, "port"), sentence)
        clocks[name] = str(_stated(scene, name, "clock") or "device")
        if clocks[name] != (own := clocks[next(iter(names))]):
            sentence = f"found {clocks[name]} beside {own}; expected one kind of clock for all devices"
            yield Issue(("devices", name, "clock"), sentence)


def same_port(port: str) -> str:
    """Returns what two names of one port have in common: the device file behind links, or an address."""
    if not is_address(port):
        return os.path.realpath(port)
    text = port.lower()
    address = address_of(text)
    return str(address._replace(host=_LOCAL.get(address.host, address.host))) if address else text


def _stated(scene: Mapping[str, Any], name: str, key: str) -> Any:
    """Returns a value of a device, made or as written."""
    device = scene["devices"][name]
    return device.get(key) if isinstance(device, Mapping) else getattr(device, key, None)


def _issues_across(around: ModuleContext, scene: Mapping[str, Any], names: Collection[str]) -> Iterator[Issue]:
    """Yields what links between two devices exclude, sound from other devices, and too many channels."""
    leader = scene.get("leader") or next(iter(names))
    owners = Owners(around, leader)
    for link, both in owners.across().items():
        yield from _issues_of_link(link, around)
        for name in (one for one in names if one in both):
            for key, right in (("correction", "none"), ("law", "host")):
                if (found := _stated(scene, name, key) or right) != right:
                    why = f"{quote(link)} ties it to {' and '.join(sorted(both - {name}))}, whose clock is another"
                    yield Issue(("devices", name, key), f"found {found}, expected {right}: {why}")
    for name, one in scene["sound"].items() if isinstance(scene.get("sound"), Mapping) else ():
        point = one.get("from") if isinstance(one, Mapping) else one.point
        if isinstance(point, str) and (owner := owners.of_point(point)) not in (None, leader):
            sentence = f"found {quote(point)}, a point of {owner}; expected one that moves with {leader}, the leader"
            yield Issue(("sound", name, "from"), sentence)
    for name in names:
        if _stated(scene, name, "mode") == "admittance":
            sentence = "found admittance beside other devices, expected impedance; or a scene of its own"
            yield Issue(("devices", name, "mode"), sentence)
        at_port, away = modules_at(around, owners, name)
        own = [one for one in at_port.modules if one not in at_port.away]
        most = max((c for one in own for c in getattr(at_port.modules[one], "all_channels", ())), default=-1)
        if away and most >= away[0].channel:
            sentence = f"found {most + 1} channels, and {len(away)} points of other devices on its links"
            yield Issue(("devices", name), f"{sentence}; expected at most {MOST_CHANNELS} together", at_key=True)


def _issues_of_link(name: str, around: ModuleContext) -> Iterator[Issue]:
    """Yields what a link between two devices cannot be: only positions of a hand and of a mass are known elsewhere."""
    link = around.modules[name]
    for end in link.between if isinstance(link, Link) else ():
        if isinstance(around.modules.get(end), Proxy):
            sentence = f"found {quote(end)}, a proxy, on a link to another device; expected a device point or a mass"
            yield Issue(("modules", name, "between"), sentence)
    if around.knows(name, "damper") and (damper := getattr(link, "damper", None)) in WITH_SENSOR:
        sentence = f"found {damper} between two devices, which do not pass on what they sense; expected backward"
        yield Issue(("modules", name, "damper"), sentence)
