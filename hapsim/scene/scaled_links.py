"""Links with scales between two hands: `gain`, the share of the force that the second end feels, and `ratio`.

    d = x1 - r x2        the first end feels -F(d), the second g r F(d)

A ratio keeps the power, as a lever does. A gain does not: moved by dx2, the link gives the second hand (g - 1) r F dx2
more than it took. With the energy of that hand over g, it is a passive link again: each module has a weight, the
product of 1/g along the links that lead to it. Weights exist only where they agree on every way between two modules.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from .issue import Issue, Path
from .modules.links import Link, ViscoElastic
from .modules.point_modules import Ground, Proxy
from .section import Module, ModuleContext

if TYPE_CHECKING:
    from .scene import Scene

_USUAL = {
    "space": 1, "scheme": "cordis", "device.law": "host", "device.correction": "none", "device.mode": "impedance",
}  # fmt: skip
"""Values that a scene with a scale needs."""
_SAME = 1e-9  # relative: of two products of gains


def scale_issues(
    around: ModuleContext, parts: Mapping[Path, Mapping[str, Any]], scene: Mapping[str, object]
) -> Iterator[Issue]:
    """Yields what does not go with a link with a scale."""
    device = {f"device.{key}": value for key, value in parts[("device",)].items()}
    scaled = {name: one.scale for name, one in around.of_type(ViscoElastic).items() if one.scale}
    for name, key in scaled.items():
        for of, usual in _USUAL.items():
            if (found := {**scene, **device}.get(of, usual)) != usual:
                sentence = f"found a {key} with {of}: {found}, expected {of}: {usual}"
                yield Issue(("modules", name, key), sentence, at_key=True)
    for name in _weights(around)[1] if scaled else ():
        sentence = "found a way between its ends with another product of gains than its own; expected the same product"
        yield Issue(("modules", name), f"{sentence}: else their energies have no common account", at_key=True)


def energy_weights(scene: Scene) -> dict[str, float]:
    """Returns the weight of each module's energy, at least 1; none is named, and all are 1, without a scale."""
    return _weights(ModuleContext.of(scene.modules))[0] if scene.scaled_links else {}


def _weights(around: ModuleContext) -> tuple[dict[str, float], list[str]]:
    """Returns the weights, of modules that links join the least at 1, and links that do not agree with them."""
    near, found, unlike = defaultdict[str, list[tuple[str, str, float]]](list), dict[str, float](), dict[str, None]()
    for name, module in around.modules.items():
        ends: tuple[str, ...] = ()
        if around.knows(name, "between", "gain", "hand"):
            ends = (
                module.between if isinstance(module, Link) else (name, module.hand) if isinstance(module, Proxy) else ()
            )
        first, second = map(around.holder, ends or ("", ""))
        if ends and Ground not in (around.kinds.get(first), around.kinds.get(second)):
            share = getattr(module, "share", 1.0)
            near[first].append((name, second, 1.0 / share))
            near[second].append((name, first, share))
    for start in near:
        part, waiting = {start: 1.0}, [start]
        while waiting and start not in found:
            one = waiting.pop()
            for name, other, factor in near[one]:
                if other not in part:
                    part[other] = part[one] * factor
                    waiting.append(other)
                elif not math.isclose(part[other], part[one] * factor, rel_tol=_SAME):
                    unlike[name] = None
        found = {one: weight / min(part.values()) for one, weight in part.items()} | found
    return found, [*unlike]


def with_points_held(scene: Scene, points: Collection[str]) -> dict[str, Module]:
    """Returns the modules of a scene whose points of these names are grounds at 0: links with a scale to them are plain
    ones."""
    held: dict[str, Module] = {name: Ground() for name in points}
    for name, link in scene.scaled_links.items():
        if held.keys() & {*link.between}:
            held[name] = link.at_end(next((end for end in link.between if end not in points), link.between[0]))
    return {**scene.modules, **held}


def scale_sentences(scene: Scene) -> Iterator[str]:
    """Yields for each link with a gain the energy that it gives or takes, and how the guard counts it."""
    weights = energy_weights(scene)
    for name, link in scene.scaled_links.items():
        (first, second), share = link.between, link.share
        heavy = max(link.between, key=weights.__getitem__)
        if share != 1.0:
            yield (
                f"{name}: {second} feels {share:.4g} of its force. Of each joule that {first} gives, {second} gets "
                f"{share:.4g} J; of each that {second} gives, {first} gets {1.0 / share:.4g} J. The link takes or "
                f"gives the rest, and the energy guard counts the energy of {heavy} {weights[heavy]:.4g} times."
            )
