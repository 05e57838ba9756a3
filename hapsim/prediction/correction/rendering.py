"""Scene that runs in place of another, so that the hand feels the scene as it is written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

from hapsim.prediction.correction.coupled import MOST_STATES, is_small, is_stable, match_modes
from hapsim.prediction.correction.element import Element, Schedule, element_for, felt_error, schedule_for
from hapsim.prediction.correction.kind import (
    CORRECTIONS,
    POLES,
    CorrectionKind,
    Observer,
    Port,
    distribute,
    observer_of,
    ports_of,
    predictor_for,
    with_modules,
    without_delay,
)
from hapsim.prediction.linear import configuration_of, coupling_reason, hand_of, linear_scene, network_of, with_device
from hapsim.prediction.timing import on_wire
from hapsim.scene import Buffer, Scene
from hapsim.scene.modules import Module
from hapsim.theory import Configuration, Network
from hapsim.theory.interface import StatePredictor

GOOD = 0.05
"""Error of k and b that a correction which leaves the links their values is meant to stay below."""

_WHY_LEFT = "its force is not that of one spring and damper everywhere"


class Corrected(NamedTuple):
    """Correction at one device point."""

    name: str
    channel: int
    desired: tuple[float, float]
    """Desired (k, b) in N/m and N·s/m, real parts included; NaN if the hand moves masses or other hands."""
    written: tuple[float, float]
    """Total (K, B) of the scene's linear links."""
    element: Element
    """Simulated (K, B) in their place; of an adaptive correction for the declared mass."""
    declared: Configuration
    """Device as the scene describes it."""
    schedule: Schedule | None = None
    """Elements by mass of an adaptive correction."""
    rest: float = 0.0
    """Position at which the linear links together have no force, m, with their other ends at rest."""

    @property
    def rendered(self) -> tuple[float, float]:
        """Simulated (K, B) of the linear links."""
        return self.element.stiffness, self.element.damping

    @property
    def made_for(self) -> float:
        """Mass for which the force is right, kg."""
        return self.element.made_for

    @property
    def reached(self) -> bool:
        """True if the hand feels the desired k and b, by prediction."""
        return self.element.reached

    @property
    def predictor(self) -> StatePredictor:
        """Predictor of the element."""
        if self.schedule is not None:
            return self.schedule.predictor(self.declared, self.made_for)
        return predictor_for(replace(self.declared, mass=self.made_for), self.element.observer)

    def settled(self, mass: float) -> Corrected:
        """Returns the correction for a hand of this mass, once an estimate has settled."""
        return self if self.schedule is None else self._replace(element=self.schedule.settled(mass))


@dataclass(frozen=True)
class Rendering:
    """Scene with the one that runs and the one that is predicted in its place."""

    desired: Scene
    """Scene as it is written."""
    scene: Scene
    """Scene as it is run."""
    seen: Scene
    """Scene as the theory sees it: the one that runs, with the delay of its wire. With a predictor the device has no
    delay, with an adaptive correction the mass is the declared one."""
    kind: CorrectionKind | None
    ports: tuple[Corrected, ...]
    notes: tuple[str, ...]
    """Sentences on parts that are not corrected, and why."""

    def predictor_of(self, port: Corrected) -> StatePredictor:
        """Returns the predictor whose state this port's force answers, once an estimate of the mass has settled."""
        return port.predictor._replace(differences=port.rendered == (0.0, 0.0))  # contacts alone

    def on_device(self, network: Network) -> Network:
        """Returns a network of `seen` with the declared device and its predictors, if the correction has some; an
        estimate of the mass has settled."""
        if self.kind is None or not self.kind.predicts:
            return network
        device, made = self.desired.device, self.predictors()
        made |= {port.channel: self.predictor_of(port) for port in self.ports}
        predictors = [made[point.channel] for point in self.desired.device_points.values()]
        return replace(network, delay=device.delay, sampling=device.sampling, predictors=predictors)

    def predictors(self) -> dict[int, StatePredictor]:
        """Returns the predictor of every channel with a device point; empty if the correction has none."""
        if self.kind is None or not self.kind.predicts:
            return {}
        scene = self.desired
        # Without a link, the least mass is assumed: links that are added during the run are simulated for it.
        spans, observer = scene.device.mass_spans(scene.channels), Observer(senses=bool(scene.sensed_links))
        made = {point.channel: (spans[point.channel][0], observer) for point in scene.device_points.values()}
        for port in self.ports:
            element = port.element if port.schedule is None else port.schedule.elements[0]
            made[port.channel] = element.made_for, element.observer
        return {
            channel: predictor_for(replace(configuration_of(scene, channel), mass=mass), observer)
            for channel, (mass, observer) in made.items()
        }


def rendered(scene: Scene) -> Rendering:
    """Returns the scene that runs in place of `scene` so that the hand feels it, by its ``device.correction``."""
    kind = CORRECTIONS.get(scene.device.correction)
    if kind is None:
        return Rendering(scene, scene, on_wire(scene), None, (), ())
    return _Correction(kind, on_wire(scene)).rendering()


class _Correction:
    """Kind of correction applied to a scene: it finds the element of each port."""

    def __init__(self, kind: CorrectionKind, scene: Scene) -> None:
        self.kind, self.scene = kind, scene
        self.linear, self.ports = linear_scene(scene), ports_of(scene)
        self.spans = scene.device.mass_spans(scene.channels)
        self.declared = {port.name: hand_of(scene, self.linear, port.name)[0] for port in self.ports}
        self.coupling_reason = {port.name: coupling_reason(scene, self.linear, port.name) for port in self.ports}

    def rendering(self) -> Rendering:
        """Returns the corrected scene, with notes on parts that the correction does not cover."""
        notes: list[str] = []
        elements: dict[str, Element] = {}
        schedules: dict[str, Schedule] = {}
        if self.kind.by_sensors:
            elements = {port.name: self.as_written(port) for port in self.ports}
        left = [port for port in self.ports if port.name not in elements]
        are_small = any(self.coupling_reason.values()) and is_small(self.scene)
        for port in (one for one in left if not self.coupling_reason[one.name] or not are_small):
            schedule = self.schedule(port) if self.kind.adapts else None
            if schedule is not None:
                schedules[port.name] = schedule
            elements[port.name] = self.lone(port) if schedule is None else schedule.elements[0]
            if why := self.coupling_reason[port.name]:
                notes.append(
                    f"{port.name} {why}: its neighbours are assumed fixed, because the scene has more than "
                    f"{MOST_STATES} numbers in its state"
                )
        together = [port for port in left if port.name not in elements and port.linear]
        notes += self.match(together, elements)
        if self.kind.predicts:
            for port in (one for one in self.ports if one.name in elements and one.name not in schedules):
                element = elements[port.name]
                model = replace(self.declared[port.name], mass=element.made_for)
                elements[port.name] = element._replace(observer=self.observer(port, model, element))
        settled = dict(elements)
        for port in self.ports:
            if port.name in schedules:
                settled[port.name] = schedules[port.name].settled(self.declared[port.name].mass)
            notes += [f"{name} is not corrected: {_WHY_LEFT}" for name in port.others if not self.kind.by_sensors]
        run, seen = self.with_elements(elements), self.as_seen(self.with_elements(settled))
        corrected = [
            Corrected(
                name=port.name,
                channel=port.channel,
                desired=(math.nan, math.nan) if self.coupling_reason[port.name] else self.desired(port),
                written=(port.stiffness, port.damping),
                element=settled[port.name],
                declared=self.declared[port.name],
                schedule=schedules.get(port.name),
                rest=self.rest(port),
            )
            for port in self.ports
            if port.name in elements
        ]
        found = Rendering(self.scene, run, seen, self.kind, tuple(corrected), tuple(notes))
        return replace(found, notes=(*notes, *self.span_notes(found, together)))

    def as_seen(self, scene: Scene) -> Scene:
        """Returns the scene with the device that the loop seems to have."""
        return with_device(scene, delay=0.0, sampling="ideal") if self.kind.predicts else scene

    def desired(self, port: Port, K: float = 0.0, B: float = 0.0) -> tuple[float, float]:
        """Desired (k, b) at this port, real parts included; `K`, `B`: of a contact that is touched."""
        declared = self.declared[port.name]
        return port.stiffness + K + declared.stiffness, port.damping + B + declared.friction

    def with_elements(self, elements: Mapping[str, Element]) -> Scene:
        """Returns the scene with its links at each named port replaced by that port's element."""
        changed: dict[str, Module] = {}
        for port in self.ports:
            if port.name in elements:
                element = elements[port.name]
                changed |= distribute(port, element.stiffness, element.damping, self.kind.with_damper)
                changed |= self.contacts(port, element)
        return with_modules(self.scene, changed)

    def as_written(self, port: Port) -> Element:
        """Returns the port's own values, and whether the hand then feels them within `GOOD`."""
        declared = self.declared[port.name]
        loop, desired = self.kind.closed(declared, declared, Observer()), self.desired(port)
        error = felt_error(loop.equivalent(port.stiffness, port.damping), desired, declared.mass)
        return Element(port.stiffness, port.damping, declared.mass, bool(error <= GOOD))

    def lone(self, port: Port, more: tuple[float, float] = (0.0, 0.0)) -> Element:
        """Returns the element of a port with fixed neighbours; `more`: K and B of a contact that is touched."""
        declared, span = self.declared[port.name], self.spans[port.channel]
        if port.stiffness + more[0] == 0.0 and port.damping + more[1] == 0.0:
            # The element of a contact is searched for a predictor of the least mass, as that of links is.
            return Element(0.0, 0.0, span[0] if self.kind.predicts else declared.mass, True)
        return element_for(self.kind, declared, span, self.desired(port, *more))

    def touched(self, port: Port, contact: Buffer) -> Element:
        """Returns the element of a port while this contact is touched. A contact uses the difference of positions: with
        a predictor, of the predicted ones, as in a loop without delay. Beside links, which use velocities, it is
        assumed to use them too."""
        added, span = (contact.stiffness, contact.damping), self.spans[port.channel]
        if not self.kind.predicts or port.linear or span[0] < span[1]:
            return self.lone(port, added)
        device = replace(without_delay(self.declared[port.name]), damper="backward")
        return element_for(POLES, device, span, self.desired(port, *added))

    def schedule(self, port: Port) -> Schedule | None:
        """Returns the schedule of a port; None if it has no linear link, or no span of masses."""
        span = self.spans[port.channel]
        if span[0] == span[1] or port.stiffness == port.damping == 0.0:
            return None
        contacts = [(contact.stiffness, contact.damping) for contact in port.contacts.values()]
        if len(contacts) > 1:
            contacts.append((math.fsum(K for K, _ in contacts), math.fsum(B for _, B in contacts)))
        observed = partial(self.observer, port)
        return schedule_for(self.declared[port.name], span, self.desired(port), contacts, observed)

    def observer(self, port: Port, model: Configuration, element: Element) -> Observer:
        """Returns the observer of the element and of each contact that may be added to it; without a compliance beside
        a link of any other kind, whose stiffness is unknown."""
        given = [(self.desired(port), (element.stiffness, element.damping))]
        changed = self.contacts(port, element)
        for name, contact in port.contacts.items():
            simulated = changed.get(name, contact)
            moving = simulated.damping if port.linear else 0.0  # at rest the difference of positions is 0
            both = element.stiffness + simulated.stiffness, element.damping + moving
            given.append((self.desired(port, contact.stiffness, contact.damping), both))
        observer, senses = observer_of(model, given), bool(self.scene.sensed_links)
        return observer._replace(compliance=0.0 if port.others else observer.compliance, senses=senses)

    def contacts(self, port: Port, base: Element) -> dict[str, Buffer]:
        """Returns each contact with its addition to the linear links while it is touched. Contacts that do not change
        are omitted: all of them if the links follow an estimate."""
        changed: dict[str, Buffer] = {}
        for name, contact in (port.contacts if not self.kind.by_sensors and not self.kind.adapts else {}).items():
            touched = self.touched(port, contact)
            stiffness, damping = touched.stiffness - base.stiffness, touched.damping - base.damping
            if stiffness >= 0.0 and damping >= 0.0:
                changed[name] = contact.model_copy(update={"stiffness": stiffness, "damping": damping})
        return changed

    def match(self, ports: list[Port], elements: dict[str, Element]) -> list[str]:
        """Adds the elements of hands that move more than themselves to `elements`; returns notes."""
        if not ports:
            return []
        alone = {port.name: self.lone(port) for port in ports}
        starts = [
            [(port.stiffness, port.damping) for port in ports],
            [(one.stiffness, one.damping) for one in alone.values()],
        ]
        matched = match_modes(self.scene, self.as_seen(self.scene), ports, self.kind.with_damper, starts)
        names = ", ".join(alone)
        if matched is None:
            elements |= {name: one._replace(reached=False) for name, one in alone.items()}
            why = (
                f"no stiffness and damping at {names} places the slowest mode as desired: neighbours are assumed fixed"
            )
            return [why]
        masses = self.scene.device.masses(self.scene.channels)
        found, is_reached = matched
        for port, (K, B) in zip(ports, found, strict=True):
            elements[port.name] = Element(K, B, masses[port.channel], is_reached)
        near = f"no stiffness and damping at {names} places the slowest modes exactly as desired: the nearest are used"
        return [] if is_reached else [near]

    def span_notes(self, rendering: Rendering, ports: list[Port]) -> list[str]:
        """Returns notes on hands that move more than themselves and whose mass is a span: its middle is assumed."""
        open_ports = [port for port in ports if self.spans[port.channel][0] < self.spans[port.channel][1]]
        if not open_ports:
            return []
        middle = ", ".join(
            f"{port.name} of {self.scene.units_of(port.channel)(port.made_for, 'kg', '.3g')}"
            for port in rendering.ports
            if port.name in {one.name for one in open_ports}
        )
        placed = f"the modes are placed for {middle}, the middle of the span"
        placed += "; no estimate follows the mass of a hand that moves masses or another hand" * self.kind.adapts
        for end, words in enumerate(("least", "greatest")):
            scene = with_device(rendering.seen, mass=tuple(span[end] for span in self.spans))
            if not is_stable(rendering.on_device(network_of(scene, linear_scene(scene))[0])):
                return [f"{placed}: with the {words} mass of the span the scene is unstable"]
        return [f"{placed}; the scene is stable with the least and the greatest mass, too"]

    def rest(self, port: Port) -> float:
        """Position at which the linear links together have no force, m."""
        grounds = [
            (link.stiffness, self.scene.grounds[end].position)
            for link in port.linear.values()
            for end in link.between
            if end in self.scene.grounds
        ]
        whole = math.fsum(stiffness for stiffness, _ in grounds)
        return math.fsum(stiffness * at for stiffness, at in grounds) / whole if whole > 0.0 else 0.0
