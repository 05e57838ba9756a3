"""Scene -> what the linear theory works on: points with masses, springs and dampers between them, and what was assumed.

Each type of link is taken for what `theory/links` makes of it. A structure is taken apart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from hapsim.scene import Buffer, Damper, Friction, Nonlinear, Plectrum, Scene, Spring, ViscoElastic
from hapsim.theory.links.friction import friction
from hapsim.theory.links.linear import Linear, buffer, cell, damper, plectrum, spring
from hapsim.theory.links.nonlinear import nonlinear


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
    """What its structures and cells consist of."""
    assumptions: list[str]
    """Sentences: what was taken for what the theory does not have."""


_IN_A_MATRIX = (ViscoElastic, Spring, Damper)
_REMEMBER = (Friction, Plectrum)


def _is_outside(link: Any, scheme: str) -> bool:
    """Whether a link is outside of a scheme that asks links between two samples: one that no matrix can hold, or that
    remembers. A new type of link is outside of a matrix, until it is said to be inside."""
    if scheme in ("midpoint", "exact"):
        return not isinstance(link, _IN_A_MATRIX)
    return scheme == "rk4" and isinstance(link, _REMEMBER)


_STAYS = "."  # what is inside a structure and stays where it is: no module is called so

_LINEAR: dict[type[Any], Callable[[Any], Linear]] = {
    ViscoElastic: lambda link: Linear(link.stiffness, link.damping),
    Spring: lambda link: spring(link.stiffness),
    Damper: lambda link: damper(link.damping),
    Buffer: lambda link: buffer(link.stiffness, link.damping),
    Nonlinear: lambda link: nonlinear(link.force_over_distance, link.force_over_velocity),
    Friction: lambda link: friction(link.stiffness, link.damping),
    Plectrum: lambda link: plectrum(link.stiffness, link.damping),
}


def linear_scene(scene: Scene) -> LinearScene:
    """What the theory takes `scene` for."""
    masses = {name: mass.mass for name, mass in scene.masses.items()}
    links: dict[str, LinearLink] = {}
    assumptions = []
    for name, link in scene.links.items():
        linear = _LINEAR[type(link)](link)
        velocity = (link.damper, link.cutoff) if isinstance(link, ViscoElastic) else ("backward", None)
        outside = _is_outside(link, scene.scheme)
        links[name] = LinearLink(link.between, linear.stiffness, linear.damping, *velocity, outside)
        if linear.assumption:
            assumptions.append(f"{name} {linear.assumption}")
    inner: list[LinearLink] = []
    for name, one in scene.cells.items():
        masses[name] = one.mass
        held = cell(one.stiffness, one.damping)
        inner.append(LinearLink((name, _STAYS), held.stiffness, held.damping))
    for name, structure in scene.structures.items():
        places = [f"{name}.{place}" for place in structure.point_names()]
        elements = structure.elements()
        masses |= dict(zip(places, elements.masses, strict=True))
        named = [*places, _STAYS]  # -1 is the last
        inner += [LinearLink((named[a], named[b]), k, z) for a, b, k, z in elements.links]
    return LinearScene(masses, frozenset([*scene.grounds, _STAYS]), links, inner, assumptions)
