"""The scene: what the user wrote, validated, in SI units. Its parts never change once it is made."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import (
    AfterValidator,
    Field,
    PlainSerializer,
    PrivateAttr,
    SerializationInfo,
    ValidationInfo,
    WrapValidator,
    model_validator,
)
from pydantic_core import PydanticCustomError, PydanticKnownError

from hapsim.errors import UsageError
from hapsim.number_format import listed
from hapsim.units import Motion, Units, Written

from .at_port import CLOCK_KEYS, AtDevice, Away, AwayPoint, Owners, modules_at
from .choices import SCHEME, SENT, WITH_SENSOR, SchemeName
from .cross_checks import cross_check_issues, motions_of, per_channel_paths
from .device import Device
from .issue import Path
from .mock import Mock, MockDevice, resolve
from .modules import MODULE_TYPES, TypedModule
from .modules.links import Link, Nonlinear, ViscoElastic
from .modules.point_modules import DevicePoint, Ground, Mass, MaterialPoint, Proxy
from .modules.structures import Structure
from .quantity import NAME, count, quantity, text
from .quantity import version as format_version
from .scaled_links import with_points_held
from .section import Module, ModuleContext, Section, Table
from .sound_channels import PickUp
from .words import Input, Output
from .yaml_file import ACROSS

VERSION = 1

AXES = ("x", "y")
"""Coordinates in the plane."""

M = TypeVar("M", bound=Module)


def _written(parts: Mapping[str, Section], info: SerializationInfo) -> dict[str, Any]:
    """Serializes modules and other parts, without None if `exclude_none` is set: a file accepts none."""
    return {name: part.model_dump(exclude_none=info.exclude_none) for name, part in parts.items()}


P = TypeVar("P")
ByName = Annotated[Mapping[Annotated[str, NAME], P], AfterValidator(Table), PlainSerializer(_written)]
"""Parts of a scene by their names."""

_CLOSED: dict[str, Any] = {"additionalProperties": False}


@dataclass(frozen=True)
class Origin:
    """Text that a scene was read from. All are equal, so that two scenes are compared by their values."""

    text: str = field(compare=False)
    folder: str | None = field(compare=False)
    """Directory of the files that the text names; None if it may name none."""
    scene: "Scene" = field(compare=False)
    """The scene of the text."""


_NO_TEXT = Origin("", None, None)  # type: ignore[arg-type]


_ABSENT: Any = object()


def _one_or_several(value: Any, validated: Callable[[Any], Device], info: ValidationInfo) -> Device:
    """Returns the device of a scene. Raises that it is missing where the scene has no other."""
    if value is _ABSENT and not info.data.get("devices", True):
        raise PydanticKnownError("missing")
    return _ABSENT if value is _ABSENT else validated(value)


_LEADER = text("The device with which simulated masses move", "the name of a device", ".+", left_out="the first")


class Scene(Section):
    """A scene for hapsim, version 1: the device that the hand holds, and what it feels. SI units.

    Made by `hapsim.scene.load_scene` from a file. Made in Python from parts, it goes through the same checks.

    Attributes:
        version: of the format, 1.
        rate: of the device's samples, in Hz: one over the sample period.
        substeps: steps of the modules per sample.
        device: the device that the hand holds; UsageError in a scene with several.
        mock: differences of the mock device from it.
        devices, mocks: several devices and their mocks, by name, in place of `device` and `mock`.
        leader: the device with which simulated masses move; None in a scene of one device.
        at: the device whose scene this is, of a scene of several; None in any other.
        modules: by name, in the order of the file.
        sound: the pick-ups, by name, in the order of the output channels.
        inputs, outputs: the bits of the device's digital words, by name.

    Raises:
        pydantic.ValidationError: made in Python from parts that do not fit.
    """

    version: Annotated[int, format_version(VERSION, "scene")]
    rate: Annotated[float, quantity("Rate of the device's samples: one over the sample period", "Hz", above=0)]
    substeps: Annotated[int, count("Steps of the modules per sample of the device", 1, 1000)] = 1
    devices: ByName[Device] = Field(
        default_factory=dict,
        validate_default=True,
        description="Several devices, each at a port of its own, by name; in place of `device`",
        json_schema_extra=_CLOSED,
    )
    device: Annotated[Device, WrapValidator(_one_or_several)] = Field(
        default_factory=lambda: _ABSENT, validate_default=True, description="The device that the hand holds"
    )
    mock: Mock | None = Field(
        default=None, description="Differences of the mock device from `device`, and additions to it"
    )
    mocks: ByName[Mock] = Field(
        default_factory=dict,
        validate_default=True,
        description="Differences of the mocks from `devices`, by the names of these",
        json_schema_extra=_CLOSED,
    )
    leader: Annotated[str | None, _LEADER] = None
    at: AtDevice | None = Field(default=None, description="The device of several whose scene this is: in records")
    space: Annotated[int, count("Coordinates of each point: 1, along a line; 2, x and y in the plane", 1, 2)] = 1
    precision: Literal["double", "single"] = Field(
        default="double",
        description="Precision of the real values in the scene's computation: 64 bits (double), or 32 (single)",
    )
    scheme: SchemeName = Field(default="cordis", description=SCHEME)
    modules: ByName[TypedModule] = Field(
        description="The modules of the scene, by name",
        json_schema_extra={"minProperties": 1} | _CLOSED,
    )
    sound: ByName[PickUp] = Field(
        default_factory=dict,
        validate_default=True,
        description="Output channels of the sound, by name",
        json_schema_extra=_CLOSED,
    )
    inputs: ByName[Input] = Field(
        default_factory=dict,
        validate_default=True,
        description="Bits that the device reads with its positions, by name",
        json_schema_extra=_CLOSED,
    )
    outputs: ByName[Output] = Field(
        default_factory=dict,
        validate_default=True,
        description="Bits that the device sets with its forces, by name",
        json_schema_extra=_CLOSED,
    )

    _path: str | None = PrivateAttr(None)
    _files: tuple[str, ...] = PrivateAttr(())
    _written: tuple[Written, ...] = PrivateAttr(())
    _origin: Origin = PrivateAttr(_NO_TEXT)
    _ranges: Mapping[Path, tuple[float, float]] = PrivateAttr({})
    _is_auxiliary: bool = PrivateAttr(False)
    _device_name: str | None = PrivateAttr(None)

    def __getattr__(self, name: str) -> Any:
        if name == "device" and self.ports:  # it is not among the fields then
            several = f"the scene has several devices, {listed(self.ports)}"
            raise UsageError(f"{several}: name one, such as --device {self.ports[0]}")
        return super().__getattr__(name)  # type: ignore[misc]

    @model_validator(mode="after")
    def _parts_fit(self) -> "Scene":
        if self.device is _ABSENT:
            del self.__dict__["device"]
        issues = cross_check_issues(self._context, self._per_channel(), dict(self))
        stated = self._stated_motions
        fill = Units.parse([*stated.values()] if isinstance(stated, dict) else stated).filled
        lines = [f"{'.'.join(map(str, issue.path))}: {fill(issue.sentence)}" for issue in issues]
        if lines:
            raise PydanticCustomError(ACROSS, "{faults}", {"faults": "\n".join(lines)})
        if turned := {name: link.turning_over(self.least_turn(link)) for name, link in self._of(Nonlinear).items()}:
            self.__dict__["modules"] = Table(dict(self.modules) | turned)  # as validated: a frozen field
        if self.ports:
            self.__dict__["leader"] = self.leader or self.ports[0]
        return self

    def least_turn(self, link: Nonlinear) -> float:
        """Returns the least `turn` of a link's branches, m, that is safe in any hand at its ends: 0 if every one is,
        infinite if none is."""
        hands = (point for name, point in self._of(DevicePoint).items() if link.branches and name in link.between)
        least = (
            link.branches.least_turn(self.rate, device.lag - 0.5, device.frictions(channel + 1)[channel])
            for hand in hands
            for channel in hand.all_channels
            if link.branches and (device := self.devices[hand.of] if hand.of else self.device)
        )
        return max(least, default=0.0)

    def __repr__(self) -> str:
        plane = " in the plane" if self.space > 1 else ""
        counts = f"{len(self.modules)} modules, {self.channels} channel{'s' * (self.channels > 1)}{plane}"
        return f"<Scene {self.path or 'without a file'}: {counts}, {self.rate:g} Hz>"

    __str__ = __repr__

    @property
    def document(self) -> dict[str, Any]:
        """The scene as its file would have it, with every value, in SI units, without ranges."""
        found = self.model_dump(mode="json", exclude_none=True)
        of_several = ("devices", "mocks")
        return {key: found[key] for key in Scene.model_fields if key in found and (found[key] or key not in of_several)}

    @property
    def ranged_document(self) -> dict[str, Any]:
        """The same with the ranges of its values."""
        document = self.document
        for (*above, key), ends in self.ranges.items():
            part: Any = document
            for step in above:
                part = part.get(step, {})
            if key in part:
                part[key] = {"value": part[key], "range": list(ends)}
        return document

    def to_yaml(self) -> str:
        """Returns the scene as the text of a file, with every value, in SI units."""
        return yaml.safe_dump(self.ranged_document, sort_keys=False, allow_unicode=True)

    def changed(self, changes: Mapping[str, Any]) -> "Scene":
        """Returns the scene with other values, without its `path`: `{"touch.stiffness": "2 N/mm", "device.delay": 0}`,
        or nested by part, `{"touch": {"stiffness": 2000}}`. Values are as in a file; None stands for what it
        leaves out.

        Raises UsageError for a path that the scene does not have, and SceneError for a value that a file could not
        have.
        """
        from .varied import changed_scene  # which reads scenes, and imports this file

        return changed_scene(self, changes)

    def with_inputs(self, on: frozenset[str]) -> "Scene":
        """Returns the scene as it is while only the inputs `on` are on: without links whose input is off, and without
        gates. Where the motor is off, no link ends on a hand; those that move masses end on a ground in its place."""
        from .input_states import with_inputs  # which imports this file

        return with_inputs(self, on)

    @property
    def path(self) -> str | None:
        """The file that the scene was loaded from, as the user named it; None where it came from no file."""
        return self._path

    @property
    def files(self) -> tuple[str, ...]:
        """The files beside that one from which the curves of its links were read."""
        return self._files

    @property
    def origin(self) -> Origin | None:
        """The text that the scene was read from, before any change; None for a scene that was made in Python."""
        return None if self._origin is _NO_TEXT else self._origin

    def read_from(self, path: str | None, origin: Origin | None = None) -> "Scene":
        """Returns the scene as one that was read from a file, as the user names it. `origin`: the file's, where that
        had other values."""
        found = self.model_copy()
        found._path, found._origin = path, origin or self._origin
        return found

    @property
    def written(self) -> tuple[Written, ...]:
        """The units of its file, other than SI units: reports are in them."""
        return self._written

    @property
    def ranges(self) -> Mapping[Path, tuple[float, float]]:
        """The ranges that the file gives live values for a slider, in SI units, by the paths of these values."""
        return self._ranges

    @property
    def is_auxiliary(self) -> bool:
        """True if hapsim made its values for a measurement, so that none is a user's mistake."""
        return self._is_auxiliary

    @property
    def ports(self) -> tuple[str, ...]:
        """The names of its devices, in the order of the file; () for one device."""
        return tuple(self.devices)

    @property
    def device_name(self) -> str | None:
        """The name of its device where the file has several; None where it has one."""
        return self.at.device if self.at else self._device_name

    @property
    def motions(self) -> tuple[Motion, ...]:
        """Motion of each channel; of several devices one after the other."""
        if not self.ports:
            return self.device.motions(self.channels)
        return tuple(one for name in self.ports for one in self.at_port(name).motions)

    @property
    def away(self) -> tuple[AwayPoint, ...]:
        """In the scene at a port: the points that other devices bring, by channel; () in any other."""
        known = self.at.away if self.at else {}
        points = self._of(DevicePoint)
        every = ((name, one, points[name].channel) for name, one in known.items())
        return tuple(AwayPoint(name, one.device, one.point, channel, one.friction) for name, one, channel in every)

    def _away(self, one: AwayPoint) -> Away:
        """Returns the section of a point that another device brings."""
        hands = {name: hand for name, hand in self.device_points.items() if hand.of == one.port}
        count, friction = 1 + max(max(hand.all_channels) for hand in hands.values()), 0.0
        if one.point in hands:
            friction = self.devices[one.port].frictions(count)[hands[one.point].channel]
        return Away(device=one.port, point=one.point, friction=friction)

    def at_port(self, name: str) -> "Scene":
        """Returns the scene of one of several devices: its points, the links that touch them, and the simulated masses
        if it is the leader. Points of other devices on these links are `away`: device points on the last channels.
        Raises UsageError for the name of no device."""
        if name not in self.devices:
            known = ", ".join(self.ports) or "none: it has one device, without a name"
            raise UsageError(f"found the device '{name}', expected one of this scene ({known})")
        around, away = modules_at(self._context, Owners(self._context, self.leader), name)
        at = AtDevice(device=name, away={one.name: self._away(one) for one in away})
        own = self.sound if name == self.leader else {}
        made = {"device": self.devices[name], "mock": self.mocks.get(name), "modules": Table(around.modules), "at": at}
        found = self.model_copy(update=made | {"devices": {}, "mocks": {}, "leader": None, "sound": dict(own)})
        found._ranges = {path: one for path, one in self.ranges.items() if path[1] in {*around.modules, *own}}
        return found

    def with_others_held(self, name: str) -> "Scene":
        """Returns the scene of one of several devices alone: points of the others are held still at 0. Raises
        UsageError for the name of no device."""
        return self.at_port(name).held

    @property
    def held(self) -> "Scene":
        """The scene at a port with the points that other devices bring held still at 0; any other scene as it is."""
        if self.at is None:
            return self
        modules = Table(with_points_held(self, [one.name for one in self.away]))
        mock = self.mock and self.mock.model_copy(update=dict.fromkeys(CLOCK_KEYS, 0.0))
        alone = self.model_copy(update={"at": None, "modules": modules, "mock": mock})
        alone._device_name, alone._path, alone._origin = self.at.device, None, _NO_TEXT  # no file has it
        return alone

    @property
    def period(self) -> float:
        """The sample period T, in s."""
        return 1.0 / self.rate

    @property
    def step_rate(self) -> float:
        """Steps of the modules per second, Hz."""
        return self.rate * self.substeps

    @property
    def channels(self) -> int:
        """Number of channels of the device: one more than the highest that a module holds; lists have this length."""
        return 1 + max(max(one.all_channels) for one in self._own_points.values())

    @property
    def all_channels(self) -> int:
        """The same, with the channels of points that other devices bring."""
        return max([self.channels, *(1 + one.channel for one in self.away)])

    @property
    def channel_groups(self) -> tuple[tuple[int, ...], ...]:
        """The channels of each hand, in the order of the file."""
        return tuple(one.all_channels for one in self._own_points.values())

    def hand_of(self, channel: int) -> tuple[int, ...]:
        """Returns the channels of the hand that holds a channel: those of x and y, or that one alone."""
        return next((hand for hand in self.channel_groups if channel in hand), (channel,))

    def hand_on(self, channel: int) -> str:
        """Returns the name of the hand that holds a channel."""
        return next(name for name, one in self._of(DevicePoint).items() if channel in one.all_channels)

    @property
    def travel_margins(self) -> tuple[float, ...]:
        """Width of the band outside the travel of each channel, m; x and y of a hand have one."""
        each = self.device.travel_margins(self.channels)
        return tuple(min(each[one] for one in self.hand_of(c)) for c in range(self.channels))

    @property
    def units(self) -> Units:
        """The units of its channels: those of its file, else SI units."""
        return Units.of(self.motions, self._written)

    def units_of(self, channel: int) -> Units:
        """The units of one channel; of a point that another device brings those of the scene."""
        motions = self.device.motions(self.channels)
        return Units.of([motions[channel]], self._written) if channel < len(motions) else self.units

    def units_at(self, name: str) -> Units:
        """The units of a module: those of the channel that it hangs on."""
        if not self.ports and not isinstance(self.device.motion, tuple):
            return self.units
        motion = motions_of(self._context, self._stated_motions).get(name)
        return self.units if motion is None else Units.of([motion], self._written)

    def coordinates_of(self, point: str) -> tuple[str, ...]:
        """Returns the names of a point's coordinates: on a line its own, in the plane "name.x" and "name.y"."""
        return (point,) if self.space == 1 else tuple(f"{point}.{axis}" for axis in AXES)

    def require_line(self, why: str) -> None:
        """Raises UsageError for a scene in the plane. `why`: what it cannot do there, as a clause."""
        if self.space > 1:
            raise UsageError(f"{self.path or 'the scene'}: found space: 2, expected a scene with one coordinate: {why}")

    def require_impedance(self, why: str) -> None:
        """Raises UsageError for a scene in admittance. `why`: what is asked of forces alone, as a clause."""
        if self.device.is_admittance:
            found = "found admittance, expected impedance"
            raise UsageError(f"{self.path or 'the scene'}: device.mode: {found}: {why}")

    @property
    def device_points(self) -> dict[str, DevicePoint]:
        """The points that the hand holds, by name, in the order of the file."""
        return self._points(DevicePoint)

    @property
    def grounds(self) -> dict[str, Ground]:
        """The fixed points, by name, in the order of the file."""
        return self._points(Ground)

    @property
    def masses(self) -> dict[str, Mass]:
        """The material points without a spring of their own, by name, in the order of the file."""
        return self._points(Mass)

    @property
    def material_points(self) -> dict[str, MaterialPoint]:
        """All points with a mass of their own, by name; those of one type together, in the order of the file."""
        types = list(MODULE_TYPES.values())
        points: dict[str, MaterialPoint] = self._points(MaterialPoint)  # type: ignore[type-abstract]
        return dict(sorted(points.items(), key=lambda item: types.index(type(item[1]))))

    @property
    def structures(self) -> dict[str, Structure]:
        """Many masses under one name each, in the order of the file."""
        return self._of(Structure)  # type: ignore[type-abstract]

    @property
    def links(self) -> dict[str, Link]:
        """The elements between two points of a line, by name, in the order of the file; then the couplings of the
        proxies."""
        couplings: dict[str, Link] = {
            name: ViscoElastic(between=(one.hand, name), stiffness=one.stiffness, damping=one.damping)
            for name, one in self.proxies.items()
        }
        return {} if self.plane_links else self._of(Link) | couplings

    @property
    def scaled_links(self) -> dict[str, ViscoElastic]:
        """The links with a scale between two hands, by name."""
        return {name: link for name, link in self._of(ViscoElastic).items() if link.scale}

    @property
    def gated(self) -> dict[str, Link]:
        """The links that act only while an input is on, by name."""
        return {name: link for name, link in self._of(Link).items() if link.when is not None}

    @property
    def plane_links(self) -> dict[str, Link]:
        """The elements between two points of the plane, by name, in the order of the file; `between` names modules,
        whose coordinates are the points "name.x" and "name.y"."""
        return self._of(Link) if self.space > 1 else {}

    @property
    def proxies(self) -> dict[str, Proxy]:
        """The points that stand for hands, by name, in the order of the file."""
        return self._of(Proxy)

    @property
    def links_at_proxies(self) -> dict[str, Link]:
        """The links that end on a proxy, couplings aside."""
        proxies = self.proxies.keys()
        return {name: link for name, link in self._of(Link).items() if proxies & {*link.between}}

    @property
    def sensed_links(self) -> tuple[str, ...]:
        """Names of the links whose damper is driven by the device's own velocity sensor."""
        return tuple(name for name, link in self._of(ViscoElastic).items() if link.damper in WITH_SENSOR)

    @property
    def sensed(self) -> tuple[str, ...]:
        """The values that the device sends beside its positions, of `SENT`, in their order."""
        wanted = {"velocity": bool(self.sensed_links), "hand_force": self.device.is_admittance}
        return tuple(name for name in SENT if name in self.device.sensors or wanted.get(name))

    @property
    def has_words(self) -> bool:
        """True if a digital word each way is on the wire."""
        return bool(self.inputs or self.outputs)

    @property
    def follows_modules(self) -> bool:
        """True if an output follows a module."""
        return any(not one.is_set_by_programs for one in self.outputs.values())

    def word_values(self, inputs: Any, outputs: Any) -> dict[str, Any]:
        """Returns the values of all inputs (1: on) and outputs in the two digital words, or in arrays of words, by
        "inputs.touch" and "outputs.code"."""
        found = {f"inputs.{name}": one.is_on(inputs) * 1 for name, one in self.inputs.items()}
        return found | {f"outputs.{name}": one.value(outputs) for name, one in self.outputs.items()}

    @property
    def mock_device(self) -> MockDevice:
        """The mock as it is to be simulated: ``mock`` where it speaks, ``device`` where it is silent."""
        return resolve(self.device, self.mock, self.channels)

    @property
    def _context(self) -> ModuleContext:
        return ModuleContext.of(self.modules, self.at.away if self.at else ())

    @property
    def _own_points(self) -> dict[str, DevicePoint]:
        away = self.at.away if self.at else ()
        return {name: one for name, one in self._of(DevicePoint).items() if name not in away}

    @property
    def _stated_motions(self) -> object:
        return {name: one.motion for name, one in self.devices.items()} if self.ports else self.device.motion

    def _per_channel(self) -> dict[Path, dict[str, object]]:
        return {path: dict(self._part(path) or ()) for path in per_channel_paths(dict(self))}

    def _part(self, path: Path) -> Any:
        """Returns a part of a device, or of a mock or its default, at a path of `per_channel_paths`."""
        head, *keys = path
        part = getattr(self, str(head))
        if self.ports:
            part = part.get(keys.pop(0))
        part = Mock() if part is None else part
        for key in keys:
            part = getattr(part, str(key))
        return part

    def _points(self, kind: type[M]) -> dict[str, M]:
        """The points of a kind, by the names of their coordinates."""
        found: dict[str, Any] = self._of(kind)
        if self.space == 1:
            return found
        return {at: one.along(i) for name, one in found.items() for i, at in enumerate(self.coordinates_of(name))}

    def _of(self, kind: type[M]) -> dict[str, M]:
        assert isinstance(self.modules, Table)
        return self.modules.of_kind(kind)
