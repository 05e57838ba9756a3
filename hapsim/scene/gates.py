"""Gates: links that act, and motors that are on, only while an input of the scene is on (`when`)."""

from collections.abc import Iterator, Mapping
from typing import Any

from .choices import PREDICTS
from .issue import Issue, Path, did_you_mean, quote
from .modules.links import Link
from .modules.point_modules import DevicePoint, Proxy
from .modules.surfaces import Shape
from .section import ModuleContext

_NO_INPUT = "expected the name of an input of this scene, such as inputs: {touch: {bit: 0}}"


def gate_issues(
    around: ModuleContext, parts: Mapping[Path, Mapping[str, Any]], scene: Mapping[str, object]
) -> Iterator[Issue]:
    """Yields `when`s that name no input, or that go with something for which no gate is worked out."""
    device, inputs = parts[("device",)], scene.get("inputs", {})
    links = around.of_type(Link, "when")
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
