"""Scenes of several devices: what the hands of one device feel, and those that links tie to hands of another.

Each device has its own clock. Hands that only links of their own device reach are predicted as those of one device.
The others are one network of several clocks (``theory/several_clocks.py``): the verdict on it is that of the worst
phase, and what its hands feel lies between a least and a largest value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from hapsim.errors import UsageError
from hapsim.prediction.felt_alone import Felt
from hapsim.prediction.linear import LinearLink
from hapsim.prediction.part import Part
from hapsim.prediction.prediction import Places, Prediction
from hapsim.prediction.stability import LinkMargin
from hapsim.prediction.swings import Shaking
from hapsim.prediction.timing import on_wire
from hapsim.scene import Ground, Link, Scene
from hapsim.scene.at_port import Owners
from hapsim.scene.device import Device
from hapsim.scene.drive import Transmission
from hapsim.scene.mock import Mock
from hapsim.scene.modules.point_modules import DevicePoint
from hapsim.scene.section import ModuleContext, Table
from hapsim.theory import Network
from hapsim.theory.interface import Clocks, PortInterface
from hapsim.theory.network import part_of_each, state_size

_MOST_STATES = 400  # of what links tie across devices: a minute for all phases

Section = tuple[str, ...]
"""Devices whose points links join, in the scene's order."""


def sections_of(scene: Scene) -> dict[Section, frozenset[str]]:
    """Names of the modules that move with the same devices, directly or by links; grounds are in none."""
    around, links = ModuleContext.of(scene.modules), scene.links
    points = [name for name, one in scene.modules.items() if not isinstance(one, Link | Ground)]
    number, owners = {name: i for i, name in enumerate(points)}, Owners(around, scene.leader)
    ends = {name: [number.get(around.holder(end), -1) for end in link.between] for name, link in links.items()}
    part = part_of_each(np.array([*ends.values()], np.intp).reshape(-1, 2), len(points)).tolist()
    moved = {name: part[number[name]] for name in points}
    moved |= {name: part[max(own)] for name, own in ends.items() if max(own) >= 0 and name not in moved}
    with_hands = {its: set[str]() for its in (moved[name] for name in scene.device_points)}
    for name in points:
        with_hands.get(moved[name], set()).add(str(owners.of_point(name)))
    sections = {its: tuple(port for port in scene.ports if port in of) for its, of in with_hands.items()}
    of_leader = next(one for one in sections.values() if scene.leader in one)  # what no hand moves is there
    every = {name: sections.get(its, of_leader) for name, its in moved.items()}
    found = sorted({*every.values()}, key=lambda one: (len(one), [scene.ports.index(port) for port in one]))
    return {own: frozenset(name for name, of in every.items() if of == own) for own in found}


def section_scene(scene: Scene, ports: Section, names: frozenset[str]) -> Scene:
    """Returns the scene of one device with these modules alone. The channels of several devices, or some of one, follow
    each other in it."""
    hands = {name: one for name, one in scene.device_points.items() if name in names}
    counts = {port: scene.at_port(port).channels for port in ports}
    each = [(scene.devices[str(one.of)], counts[str(one.of)], one.channel) for one in hands.values()]
    whole = len(ports) == 1 and len(each) == len([one for one in scene.device_points.values() if one.of == ports[0]])
    base = scene.devices[ports[0]]
    kept = {name: one for name, one in scene.modules.items() if name in names or isinstance(one, Ground)}
    kept |= {
        name: DevicePoint(channel=one.channel if whole else number) for number, (name, one) in enumerate(hands.items())
    }
    around = ModuleContext.of(scene.modules)
    own = {
        "device": base if whole else base.model_copy(update=_joined_device(each, len(ports) > 1)),
        "mock": scene.mocks.get(ports[0]) if whole else Mock(quantum=_coarsest(scene, ports)),
        "modules": Table(kept),
        "sound": {name: one for name, one in scene.sound.items() if around.holder(one.point) in names},
    }
    return scene.model_copy(update=own | {"devices": {}, "mocks": {}, "leader": None})


def _coarsest(scene: Scene, ports: Section) -> float:
    return max(count for port in ports for count in scene.at_port(port).mock_device.quantum)


def _joined_device(each: Sequence[tuple[Device, int, int]], is_across: bool) -> dict[str, Any]:
    """Keys of a device with these channels, each (device, its number of channels, channel)."""
    drives = [device.drives(count)[c] for device, count, c in each]
    travels = [device.travels(count)[c] for device, count, c in each]
    keys: dict[str, Any] = {
        "motion": tuple(device.motions(count)[c] for device, count, c in each),
        "mass": tuple(device.masses(count)[c] for device, count, c in each),
        "friction": tuple(device.frictions(count)[c] for device, count, c in each),
        "stiffness": tuple(device.stiffnesses(count)[c] for device, count, c in each),
        "motor_lag": tuple(one.lag for one in drives),
        "transmission": None,
        "travel": tuple(travels) if any(math.isfinite(low + high) for low, high in travels) else None,
        "travel_margin": None,
        "origin": None,
        "mass_at": None,
        "force_limit": max(device.force_limit for device, *_ in each),
    }
    if any(one.is_elastic for one in drives):
        own: dict[str, Any] = {key: tuple(getattr(one, key) for one in drives) for key in Transmission.model_fields}
        keys["transmission"] = Transmission.model_construct(**own)
    return keys | ({"port": None, "correction": "none"} if is_across else {})


class AcrossPorts(Prediction):
    """Prediction of hands that links tie across devices, at the worst phase of their clocks.

    Attributes:
        ports: the devices.
    """

    def __init__(self, whole: Scene, ports: Section, names: frozenset[str], at: Places = None, **options: bool) -> None:
        """`whole`: the scene of all devices. `names`: of its modules that are predicted here."""
        self.ports = ports
        self._owners = Owners(ModuleContext.of(whole.modules), whole.leader)
        devices = (on_wire(whole.at_port(port)).device for port in ports)
        self._interfaces = tuple(PortInterface(one.delay, one.hold, one.sampling, one.decimation) for one in devices)
        self._is_one_clock = whole.devices[ports[0]].clock == "host"
        super().__init__(section_scene(whole, ports, names), at, **options)

    @property
    def links_across(self) -> dict[str, LinearLink]:
        """Links between points of two devices, by name."""
        return {name: self._linear.links[name] for name in self._owners.across() if name in self._linear.links}

    def _on_clocks(self, network: Network) -> Network:
        owners = tuple(self.ports.index(str(self._owners.of_point(point))) for point in self.points)
        phases = () if self._is_one_clock else (0.0,) * len(self.ports)
        found = replace(network, clocks=Clocks(owners, self._interfaces, phases))
        if (size := state_size(found)) > _MOST_STATES:
            ports = " and ".join(self.ports)
            raise UsageError(f"found {size} numbers in the state of what links tie across {ports}: too many to predict")
        return found


class PortsPrediction(Prediction):
    """Prediction of a scene of several devices, made of those of its sections. What belongs to one section, such as its
    poles, has to be asked of that.

    Attributes:
        sections: predictions by the devices whose points links join: of one device alone, or across several.
    """

    def __init__(self, scene: Scene, at: Places = None, **options: bool) -> None:
        """Arguments as of `Prediction`."""
        self.scene, self.rate = scene, scene.rate
        self.sections: dict[Section, Prediction] = {
            ports: AcrossPorts(scene, ports, names, at, **options)
            if len(ports) > 1
            else Prediction(section_scene(scene, ports, names), at, **options)
            for ports, names in sections_of(scene).items()
        }

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        sections = ", ".join(" and ".join(ports) for ports in self.sections)
        raise UsageError(
            f"found a scene with several devices, expected one of its predictions by `sections`: {sections}"
        )

    @property
    def every(self) -> tuple[Prediction, ...]:
        """The predictions of its sections."""
        return tuple(self.sections.values())

    def work_out(self) -> None:
        """Works out what takes long, also what hands feel at each phase of the clocks."""
        super().work_out()
        _ = [part.over_phases for part in self.parts]

    @property
    def worst(self) -> Prediction:
        """The first unstable section; of stable ones that with the slowest decay."""
        unstable = (one for one in self.every if not one.stable)
        return next(unstable, max(self.every, key=lambda one: one.spectral_radius))

    @property
    def stable(self) -> bool:
        """True if every section is stable, at every phase of the clocks."""
        return all(one.stable for one in self.every)

    @property
    def verdict(self) -> str:
        """Verdict on the whole, as of `Prediction`."""
        return self.worst.verdict

    @cached_property
    def spectral_radius(self) -> float:
        """Largest modulus of a pole, at the worst phase."""
        return max(one.spectral_radius for one in self.every)

    @property
    def shaking(self) -> Shaking | None:
        """Motion that surely grows at some phase; None if there is none."""
        return next((one.shaking for one in self.every if one.shaking), None)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Parts of every section; those across devices have `over_phases`."""
        return tuple(part for one in self.every for part in one.parts)

    @cached_property
    def felt(self) -> tuple[Felt, ...]:
        """Closed forms of the hands on grounds."""
        return tuple(felt for one in self.every for felt in one.felt)

    @cached_property
    def margins(self) -> tuple[LinkMargin, ...]:
        """Gain margins, one for each link, at the worst phase."""
        return tuple(margin for one in self.every for margin in one.margins)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Sentences on the simplifications of the theory for this scene."""
        return tuple(dict.fromkeys(sentence for one in self.every for sentence in one.assumptions))
