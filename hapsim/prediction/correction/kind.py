"""Kinds of correction (`CORRECTIONS`), and the links of a device point that they act on (`Port`).

`poles` gives the links at the device the (K, B) whose felt (k, b) is the desired one, by the closed form of the paper's
Figure 4 (Florens et al., §5 and §6); the loop has no further parts.

`predictor` lets them answer the state that the mass will have when their force acts. For the declared mass the loop is
then that of a device without delay that senses its velocity. Florens et al., §6.3, ask for this sensor;
``theory/correction.py`` describes its substitute. Both poles can be placed anywhere below half the rate.

`sensed` takes that state from sensors of velocity and acceleration, for every link (`theory/sample.py`), and leaves the
links their values: no mass is in it. A soft element is then felt as desired, whatever the hand weighs.

`adaptive` is the predictor for a mass that is estimated while the temporary hybrid system runs (`Schedule` in
``element.py``; ``loop/adaptive.py`` estimates).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from hapsim.scene import Buffer, Scene, ViscoElastic
from hapsim.scene.choices import BY_SENSORS, DamperScheme
from hapsim.scene.modules import Link, Module
from hapsim.scene.section import Table
from hapsim.theory import Configuration
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.correction import SLOWEST, PredictedLoop, state_predictor
from hapsim.theory.interface import Ahead, StatePredictor


class ClosedLoop(Protocol):
    """Hand on a spring and damper, whose mass may differ from the one that the correction was made for."""

    def poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """Poles (..., N) in the z-plane, by decreasing modulus."""

    def equivalent(self, K: ArrayLike, B: ArrayLike) -> tuple[Floats, Floats]:
        """Felt (k, b), N/m and N·s/m; NaN if none is equivalent."""

    def solved(self, K: ArrayLike, B: ArrayLike) -> tuple[Complexes, Floats, Floats]:
        """Both: poles, k and b."""


class Observer(NamedTuple):
    """Parameters with which a predictor observes the push of the hand and answers it."""

    pole: float = SLOWEST
    """Pole of ``state_predictor``."""
    compliance: float = 0.0
    """Compliance, m/N: for the scene, the device is further by this times the push."""
    static: float | Floats | None = None
    """Stiffness for a steady push in place of the compliance, N/m, for any simulated (K, B)."""
    senses: bool = False
    """True if the observer reads velocities."""


class CorrectionKind(NamedTuple):
    """Kind of ``device.correction``."""

    name: str
    with_damper: DamperScheme | None
    """Source of the dampers' velocity at the device; None: as in the scene."""
    predicts: bool
    """True if the loop gives the scene the state in which the mass will receive the force."""
    adapts: bool
    """True if the elements follow an estimate of the mass."""
    seen_by_theory: Callable[[Configuration], Configuration]
    """Configuration with the loop's poles if the declared mass is the true one."""
    closed: Callable[[Configuration, Configuration, Observer], ClosedLoop]
    """Loop of a true configuration, the first, with a correction that was made for another, the second."""

    @property
    def by_sensors(self) -> bool:
        """True if every link answers the sensed motion ahead of its reading, and keeps the scene's values."""
        return self.name in BY_SENSORS


class Port(NamedTuple):
    """Device point, and the links that end there."""

    name: str
    channel: int
    linear: dict[str, ViscoElastic]
    contacts: dict[str, Buffer]
    others: tuple[str, ...]
    """Links that are not corrected."""

    @property
    def stiffness(self) -> float:
        """Total K of the linear links, N/m."""
        return math.fsum(link.stiffness for link in self.linear.values())

    @property
    def damping(self) -> float:
        """Total B of the linear links, N·s/m."""
        return math.fsum(link.damping for link in self.linear.values())


def ports_of(scene: Scene) -> list[Port]:
    """Returns every device point with a link. A link between two hands belongs to the first of them."""
    taken: set[str] = set()
    ports = []
    for name, point in scene.device_points.items():
        links = {key: link for key, link in scene.links.items() if name in link.between and key not in taken}
        taken |= set(links)
        if links:
            linear = {key: as_viscoelastic(link) for key, link in links.items() if link.law().is_line}
            contacts = {key: link for key, link in links.items() if isinstance(link, Buffer)}
            others = tuple(key for key in links if key not in linear and key not in contacts)
            ports.append(Port(name, point.channel, linear, contacts, others))
    return ports


def as_viscoelastic(link: Link) -> ViscoElastic:
    """Returns a linear link as a spring and a damper, one of which may be zero."""
    if isinstance(link, ViscoElastic):
        return link
    law = link.law()
    return ViscoElastic(between=link.between, when=link.when, stiffness=law.below, damping=law.dampings[0])


def distribute(port: Port, stiffness: float, damping: float, damper: DamperScheme | None) -> dict[str, ViscoElastic]:
    """Returns the linear links of the port with the sums K and B (N/m, N·s/m), each with its share of the scene's. If
    no link has a stiffness (or damping), the shares are those of the other quantity."""
    updates = {}
    for name, link in port.linear.items():
        of_stiffness = _share(link.stiffness, port.stiffness, link.damping, port.damping, len(port.linear))
        of_damping = _share(link.damping, port.damping, link.stiffness, port.stiffness, len(port.linear))
        values: dict[str, object] = {"stiffness": stiffness * of_stiffness, "damping": damping * of_damping}
        if damper is not None:
            values |= {"damper": damper, "cutoff": None}
        updates[name] = link.model_copy(update=values)  # not validated: a simulated part may be negative
    return updates


def with_modules(scene: Scene, changed: Mapping[str, Module]) -> Scene:
    """Returns the scene with some modules replaced, in their places; they are not validated."""
    modules = {name: changed.get(name, module) for name, module in scene.modules.items()}
    return scene.model_copy(update={"modules": Table(modules)})


def _share(own: float, whole: float, other: float, other_whole: float, links: int) -> float:
    if whole > 0.0:
        return own / whole
    return other / other_whole if other_whole > 0.0 else 1.0 / links


POLES = CorrectionKind(
    name="poles",
    with_damper=None,
    predicts=False,
    adapts=False,
    seen_by_theory=lambda declared: declared,
    closed=lambda true, _declared, _observer: true,
)


POLES_OF_THE_PUSH = (SLOWEST, 0.25, 0.0)
"""Possible poles of the observer: few, so that a scene that changes a little keeps its observer."""


def without_delay(declared: Configuration) -> Configuration:
    """Returns the loop as a mass that equals the declared one sees it."""
    return replace(declared, delay=0.0, sampling="ideal", damper="sensed", cutoff=None, spring_lag=0.0)


def predictor_for(declared: Configuration, observer: Observer) -> StatePredictor:
    """Returns the predictor that the loop runs."""
    return state_predictor(declared, observer.senses, observer.pole).for_compliance(observer.compliance)


def observer_of(declared: Configuration, given: Sequence[tuple[tuple[float, float], tuple[float, float]]]) -> Observer:
    """Returns the observer for some desired (k, b), real parts included, each with its simulated (K, B), 0 if not known
    yet. Its poles decay at least twice as fast as the fastest of the desired ones. K, of a sampled and held motion, is
    not k. With the compliance a steady push meets k nevertheless. With several, the smallest one is used, the
    stiffest's: with that of a soft spring, a parallel contact would answer a push many times over."""
    pole = min((float(pole_of_push(declared, k, b)) for (k, b), _ in given), default=SLOWEST)
    rest, found = state_predictor(declared).at_rest(), []
    for (k, _), (K, B) in given:
        if k > declared.stiffness and K > 0.0:
            x, v, push = rest @ [1.0, declared.stiffness - k]
            found.append((k - declared.stiffness - K * x - B * v) / (K * push))
    return Observer(pole, min(found, key=abs, default=0.0))


def pole_of_push(declared: Configuration, k: ArrayLike, b: ArrayLike) -> Floats:
    """Returns the greatest of `POLES_OF_THE_PUSH`, (...), that decays twice as fast as either pole of the mass on (k,
    b)."""
    k, b = np.asarray(k, float), np.asarray(b, float)
    decay = b + np.sqrt(np.maximum(b * b - 4.0 * k * declared.mass, 0.0))
    fast = np.exp(-decay / declared.mass * declared.period)
    return np.asarray(np.select([fast >= pole for pole in POLES_OF_THE_PUSH], POLES_OF_THE_PUSH))


PREDICTOR = CorrectionKind(
    name="predictor",
    with_damper="sensed",
    predicts=True,
    adapts=False,
    seen_by_theory=without_delay,
    closed=lambda true, declared, observer: PredictedLoop(true, predictor_for(declared, observer), observer.static),
)
ADAPTIVE = PREDICTOR._replace(name="adaptive", adapts=True)


def by_sensors(declared: Configuration) -> Configuration:
    """Returns the loop of links that answer the sensed motion ahead of its reading."""
    ahead = declared.ahead or Ahead(declared.delay)
    return replace(declared, damper="sensed", cutoff=None, spring_lag=0.0, ahead=ahead)


SENSED = CorrectionKind(
    name="sensed",
    with_damper="sensed",
    predicts=False,
    adapts=False,
    seen_by_theory=by_sensors,
    closed=lambda true, declared, _observer: replace(by_sensors(true), ahead=by_sensors(declared).ahead),
)

CORRECTIONS: dict[str, CorrectionKind] = {kind.name: kind for kind in (POLES, PREDICTOR, ADAPTIVE, SENSED)}
"""Kinds by the names of `device.correction`, except "none"."""
