"""Gates: links that act, and motors that are on, only while an input of the scene is on (`when`)."""

from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import TYPE_CHECKING, Any

from .choices import PREDICTS
from .device import Mock
from .issue import Issue, Path, did_you_mean, quote
from .modules.links import Link
from .modules.point_modules import DevicePoint, Ground, Proxy
from .modules.surfaces import Shape
from .section import ModuleContext, Table

if TYPE_CHECKING:
    from .scene import Scene

MOST_COMBINED = 4
"""Inputs of which every combination is judged; of more, all, none, and each one alone on or off."""

_NO_INPUT = "expected the name of an input of this scene, such as inputs: {touch: {bit: 0}}"


def used_inputs(scene: "Scene") -> tuple[str, ...]:
    """Returns the inputs that `when` names, in the scene's order."""
    named = {scene.device.when, *(link.when for link in scene.gated.values())}
    return tuple(name for name in scene.inputs if name in named)


def input_states(scene: "Scene") -> list[frozenset[str]]:
    """Returns the inputs that are on, in every state in which the scene is judged beside that of all."""
    used = used_inputs(scene)
    counts = range(len(used)) if len(used) <= MOST_COMBINED else (len(used) - 1, 1, 0)
    return [frozenset(on) for count in reversed(counts) for on in combinations(used, count)]


def with_inputs(scene: "Scene", on: frozenset[str]) -> "Scene":
    """Returns the scene without gates in which only the inputs `on` are on, as `Scene.with_inputs` does."""
    modules, device = dict(scene.modules), scene.device
    for name, link in scene.gated.items():
        modules[name] = link.model_copy(update={"when": None})
        if link.when not in on:
            del modules[name]
    if device.when is not None and device.when not in on:
        modules = dict(_without_motor(modules, scene.space))
    parts: dict[str, Any] = {"modules": Table(modules), "device": device.model_copy(update={"when": None})}
    return scene.model_copy(update=parts)


def _without_motor(modules: Mapping[str, Any], space: int) -> Iterator[tuple[str, Any]]:
    """Yields the modules where no hand feels a force: the links of a hand end on a ground, from which they are driven
    as from the hand, and those that then join no masses are left out."""
    held = Ground(position=0.0).model_copy(update={} if space == 1 else {"position": (0.0,) * space})
    still = {name for name, one in modules.items() if isinstance(one, Ground | DevicePoint)}
    for name, one in modules.items():
        if isinstance(one, DevicePoint):
            yield name, one
            yield f"{name}-held", held
        elif not isinstance(one, Link):
            yield name, one
        elif not still.issuperset(one.between):
            ends = tuple(f"{end}-held" if isinstance(modules.get(end), DevicePoint) else end for end in one.between)
            yield name, one.model_copy(update={"between": ends})


def with_mock_inputs_on(scene: "Scene") -> "Scene":
    """Returns the scene with every input that a gate needs on from the start, on the mock; except those whose changes
    the scene names."""
    if not (used := used_inputs(scene)):
        return scene
    mock = scene.mock or Mock()
    inputs = Table(dict.fromkeys(used, (0.0,)) | dict(mock.inputs))
    return scene.model_copy(update={"mock": mock.model_copy(update={"inputs": inputs})})


def gate_issues(
    around: ModuleContext, parts: Mapping[Path, Mapping[str, Any]], scene: Mapping[str, object]
) -> Iterator[Issue]:
    """Yields `when`s that name no input, or that go with something for which no gate is worked out."""
    device, inputs = parts[("device",)], scene.get("inputs", {})
    links = {name: one for name, one in around.modules.items() if isinstance(one, Link) and around.knows(name, "when")}
    gates = {("modules", name): one.when for name, one in links.items()} | {("device",): device.get("when")}
    for path, when in gates.items():
        if isinstance(when, str) and isinstance(inputs, Mapping) and when not in inputs:
            yield Issue((*path, "when"), f"found {quote(when)}, {_NO_INPUT}{did_you_mean(when, inputs)}")
    if device.get("when") and Proxy in around.kinds.values():
        sentence = "found a motor with a gate in a scene with a proxy, expected none: write when at its links"
        yield Issue(("device", "when"), sentence, at_key=True)
    together = dict[tuple[str, ...], str | None]()
    correction = device.get("correction", "none")
    for name, link in links.items():
        if link.when and correction in PREDICTS:
            sentence = f"found a gate with correction: {correction}, whose predictor follows the scene without it"
            yield Issue(("modules", name, "when"), f"{sentence}; expected correction: none, poles or sensed")
        for words, *owner in _owners(link, around, correction) if around.knows(name, "between") else ():
            found, before = link.when and f"when: {link.when}", together.setdefault((words, *owner), link.when)
            if before != link.when:
                sentence = f"found {found or 'no when'}, unlike {words}; expected the same"
                yield Issue(("modules", name), sentence, at_key=True)


def _owners(link: Link, around: ModuleContext, correction: str) -> Iterator[tuple[str, ...]]:
    """Yields what all links that share it need the same `when` for: first in words."""
    if isinstance(link, Shape):
        yield "a shape with the same ends before it, with which it is one surface", *link.between
    if correction == "poles":
        for end in link.between:
            if around.kinds.get(end) is DevicePoint:
                yield f"a link of {quote(end)} before it, and correction: poles is for all of them together", end
