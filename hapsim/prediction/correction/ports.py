"""The scene's links at the device: which of them a correction takes together, and what it makes of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from hapsim.scene import Buffer, Damper, Scene, Spring, ViscoElastic
from hapsim.scene.choices import DamperScheme
from hapsim.scene.modules import Link, Module
from hapsim.scene.table import Table

LINEAR = (ViscoElastic, Spring, Damper)
"""Links that are a spring and a damper wherever the hand is: their sum at a device point is corrected as one."""


class Port(NamedTuple):
    """A device point, and the links that end there."""

    name: str
    channel: int
    linear: dict[str, ViscoElastic]
    contacts: dict[str, Buffer]
    others: tuple[str, ...]
    """Links that are left as they are."""

    @property
    def stiffness(self) -> float:
        """K of the linear links together, N/m."""
        return math.fsum(link.stiffness for link in self.linear.values())

    @property
    def damping(self) -> float:
        """B of the linear links together, N·s/m."""
        return math.fsum(link.damping for link in self.linear.values())


def ports_of(scene: Scene) -> list[Port]:
    """Every device point that a link ends on. A link between two hands is taken with the first of them."""
    taken: set[str] = set()
    ports = []
    for name, point in scene.device_points.items():
        links = {key: link for key, link in scene.links.items() if name in link.between and key not in taken}
        taken |= set(links)
        if links:
            linear = {key: as_viscoelastic(link) for key, link in links.items() if isinstance(link, LINEAR)}
            contacts = {key: link for key, link in links.items() if isinstance(link, Buffer)}
            others = tuple(key for key in links if key not in linear and key not in contacts)
            ports.append(Port(name, point.channel, linear, contacts, others))
    return ports


def as_viscoelastic(link: Link) -> ViscoElastic:
    """A linear link as a spring and a damper, one of which may be nothing."""
    if isinstance(link, ViscoElastic):
        return link
    stiffness = link.stiffness if isinstance(link, Spring) else 0.0
    damping = link.damping if isinstance(link, Damper) else 0.0
    return ViscoElastic(between=link.between, stiffness=stiffness, damping=damping)


def shared_out(port: Port, stiffness: float, damping: float, damper: DamperScheme | None) -> dict[str, ViscoElastic]:
    """The linear links of the port with the sums K and B (N/m, N·s/m), each with the share that it has of the scene's:
    of a stiffness or damping that none of them has, the share that it has of the other."""
    updates = {}
    for name, link in port.linear.items():
        of_stiffness = _share(link.stiffness, port.stiffness, link.damping, port.damping, len(port.linear))
        of_damping = _share(link.damping, port.damping, link.stiffness, port.stiffness, len(port.linear))
        values: dict[str, object] = {"stiffness": stiffness * of_stiffness, "damping": damping * of_damping}
        if damper is not None:
            values |= {"damper": damper, "cutoff": None}
        updates[name] = link.model_copy(update=values)  # not validated: a simulated part may well be negative
    return updates


def with_modules(scene: Scene, changed: Mapping[str, Module]) -> Scene:
    """The scene with some modules replaced, in their places; they are not validated."""
    modules = {name: changed.get(name, module) for name, module in scene.modules.items()}
    return scene.model_copy(update={"modules": Table(modules)})


def _share(own: float, whole: float, other: float, other_whole: float, links: int) -> float:
    if whole > 0.0:
        return own / whole
    return other / other_whole if other_whole > 0.0 else 1.0 / links
