"""What a correction is (`CorrectionKind`), and the links of a device point that it acts on (`Port`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from numpy.typing import ArrayLike

from hapsim.scene import Buffer, Damper, Scene, Spring, ViscoElastic
from hapsim.scene.choices import CorrectionName, DamperScheme
from hapsim.scene.modules import Link, Module
from hapsim.scene.part import Table
from hapsim.theory import Configuration
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.correction import SLOWEST


class ClosedLoop(Protocol):
    """A hand on a spring and damper, whose mass may differ from what the correction was made for."""

    def poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """(..., N) in the z-plane, by decreasing modulus."""

    def equivalent(self, K: ArrayLike, B: ArrayLike) -> tuple[Floats, Floats]:
        """The (k, b) that it feels, N/m and N·s/m; NaN where none is equivalent."""


class Observer(NamedTuple):
    """How a predictor follows the hand that pushes, and what it makes of the push."""

    pole: float = SLOWEST
    """Of ``state_predictor``."""
    compliance: float = 0.0
    """m/N: by so much of the push the scene sees the device further."""
    static: float | Floats | None = None
    """N/m: in place of the compliance, the stiffness that a steady push is to meet, whatever (K, B) are simulated."""
    senses: bool = False
    """Whether it reads velocities."""


class CorrectionKind(NamedTuple):
    """One of ``device.correction``."""

    name: CorrectionName
    with_damper: DamperScheme | None
    """Where the dampers at the device take their velocity from; None: as the scene says."""
    predicts: bool
    """Whether the loop hands the scene the state in which the mass will meet the force."""
    adapts: bool
    """Whether what the force is made of follows an estimate of the mass."""
    seen_by_theory: Callable[[Configuration], Configuration]
    """The configuration whose poles the loop has where the declared mass is the true one."""
    closed: Callable[[Configuration, Configuration, Observer], ClosedLoop]
    """The loop of a true configuration, the first, with a correction that was made for another, the second."""


LINEAR = (ViscoElastic, Spring, Damper)
"""Links that are a spring and a damper everywhere: their sum at a device point is corrected as one."""


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
