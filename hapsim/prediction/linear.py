"""Scene -> what the linear theory works on: points with masses, springs and dampers between them, and what was assumed.

Each type of link is taken for what `theory/links` makes of it. A structure is taken apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from hapsim.scene import Buffer, Damper, Friction, Nonlinear, Plectrum, Scene, Spring, ViscoElastic
from hapsim.scene.modules import Link, MaterialPoint
from hapsim.theory.links.friction import friction
from hapsim.theory.links.linear import Linear, buffer, damper, plectrum, spring, viscoelastic
from hapsim.theory.links.nonlinear import nonlinear
from hapsim.theory.schemes import SCHEMES, LinkNature


class LinearLink(NamedTuple):
    """A spring and a damper between two points, named as in the scene."""

    between: tuple[str, str]
    stiffness: float
    damping: float
    damper: str = "backward"
    cutoff: float | None = None
    outside: bool = False
    """Whether the scene's scheme takes its force at the sample for the whole sample period, whatever it joins."""


class LinearScene(NamedTuple):
    """A scene as the linear theory sees it."""

    masses: dict[str, float]
    """Points that the scene moves, with their masses in kg."""
    fixed: frozenset[str]
    """Points that stay."""
    links: dict[str, LinearLink]
    """The scene's links, by name."""
    inner: list[LinearLink]
    """What its structures consist of, and what holds its material points."""
    assumptions: list[str]
    """Sentences: what was taken for what the theory does not have."""


_STAYS = "."  # what is inside a structure and stays where it is: no module is called so

_LINEAR: dict[type[Any], Callable[[Any], Linear]] = {
    ViscoElastic: lambda link: viscoelastic(link.stiffness, link.damping),
    Spring: lambda link: spring(link.stiffness),
    Damper: lambda link: damper(link.damping),
    Buffer: lambda link: buffer(link.stiffness, link.damping),
    Nonlinear: lambda link: nonlinear(link.force_over_distance, link.force_over_velocity),
    Friction: lambda link: friction(link.stiffness, link.damping),
    Plectrum: lambda link: plectrum(link.stiffness, link.damping),
}
"""Of every type of link, and of material points that pull themselves."""


def linear_of(module: Link | MaterialPoint) -> Linear:
    """What this module's own force is for small motions.

    Raises:
        KeyError: of this type it is not said.
    """
    return _LINEAR[type(module)](module)


def _is_outside(linear: Linear, scheme: str) -> bool:
    """Whether the scheme takes this force for that of the sample, whatever it joins."""
    advance = SCHEMES[scheme].advance
    nature = LinkNature(linear.in_a_matrix, linear.memoryless, at_channel=False)
    return advance is not None and not advance.inside(nature)


def linear_scene(scene: Scene) -> LinearScene:
    """What the theory takes `scene` for."""
    masses: dict[str, float] = {}
    links: dict[str, LinearLink] = {}
    assumptions = []
    for name, link in scene.links.items():
        linear = linear_of(link)
        velocity = (link.damper, link.cutoff) if isinstance(link, ViscoElastic) else ("backward", None)
        outside = _is_outside(linear, scene.scheme)
        links[name] = LinearLink(link.between, linear.stiffness, linear.damping, *velocity, outside)
        if linear.assumption:
            assumptions.append(f"{name} {linear.assumption}")
    inner: list[LinearLink] = []
    for name, point in scene.material_points.items():
        masses[name] = point.mass
        for own in _own_links(point):
            outside = _is_outside(own, scene.scheme)
            inner.append(LinearLink((name, _STAYS), own.stiffness, own.damping, outside=outside))
            if own.assumption:
                assumptions.append(f"{name} {own.assumption}")
    for name, structure in scene.structures.items():
        places = [f"{name}.{place}" for place in structure.point_names()]
        elements = structure.elements()
        masses |= dict(zip(places, elements.masses, strict=True))
        named = [*places, _STAYS]  # -1 is the last
        inner += [LinearLink((named[a], named[b]), k, z) for a, b, k, z in elements.links]
    return LinearScene(masses, frozenset([*scene.grounds, _STAYS]), links, inner, assumptions)


def _own_links(point: MaterialPoint) -> Iterator[Linear]:
    """What pulls a material point by itself."""
    held = point.held_by()
    if held is not None:
        yield viscoelastic(held.stiffness, held.damping)
    if point.pulls_itself:
        yield linear_of(point)
