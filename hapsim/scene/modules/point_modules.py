"""The points that links join: the device point, the ground, CORDIS's MAS (mass) and CEL (cell), the proxy."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from hapsim.laws import Law

from ..issue import Issue, did_you_mean, quote
from ..quantity import count, counts, quantity, text
from ..schemas import MOST_CHANNELS
from ..section import Module, ModuleContext, check_of

_CHANNEL = count("Channel of the device, counted from 0", 0, MOST_CHANNELS - 1, left_out="`channels`")
_CHANNELS = counts("Channels of x and y of the device, in a scene with space: 2", 2, 0, MOST_CHANNELS - 1, "`channel`")
_OF = text("Name of its device, in a scene with several", "the name of a device", "[^ ]+", "the only device")


class DevicePoint(Module):
    """The point of the scene that the hand holds: one channel of the device, or two in a scene with space: 2."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    type: Literal["device"] = Field(default="device", description="A point that the hand holds")
    channel: Annotated[int, _CHANNEL] = Field(default=None, validate_default=False)  # type: ignore[assignment]
    channels: Annotated[tuple[int, int] | None, _CHANNELS] = None
    of: Annotated[str | None, _OF] = None

    @property
    def all_channels(self) -> tuple[int, ...]:
        """Channels of the device that it holds: those of x and y, or the single one; none where its keys are faulty."""
        return (self.channel,) if self.channel is not None else self.channels or ()

    def along(self, axis: int) -> DevicePoint:
        """Returns its coordinate x (0) or y (1) as a point."""
        return DevicePoint(channel=self.all_channels[axis])

    @check_of("channel", "channels")
    def _is_alone_on_its_channels(self, name: str, around: ModuleContext) -> Iterator[Issue]:
        points = {
            other: one for other, one in around.of_type(DevicePoint, "channel", "channels").items() if one.of == self.of
        }
        key = "channel" if self.channels is None else "channels"
        if self.channels and self.channels[0] == self.channels[1]:
            yield Issue(("channels",), f"found {self.channels[0]} twice; expected two channels, of x and of y")
        for channel in dict.fromkeys(self.all_channels):
            first = next(other for other, one in points.items() if channel in one.all_channels)
            if first != name:
                yield Issue((key,), f"found {channel}, which {quote(first)} already uses; expected an unused channel")


class Ground(Module):
    """A fixed point."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    can_move: ClassVar[bool] = False
    live: ClassVar[tuple[str, ...]] = ("position",)

    type: Literal["ground"] = Field(default="ground", description="A fixed point")
    position: Annotated[float, quantity("Position", "m", coordinates=True)] = 0.0

    def along(self, axis: int) -> Ground:
        """Returns its coordinate x (0) or y (1) as a point."""
        return self.model_copy(update={"position": coordinate(self.position, axis)})


def coordinate(value: float | Sequence[float], axis: int) -> float:
    """Returns x (0) or y (1) of a value of the plane; a number is that of both."""
    return value[axis] if isinstance(value, Sequence) else value


class Held(NamedTuple):
    """A spring and a damper from a point to where it rests: N/m, N·s/m, m."""

    stiffness: float
    damping: float
    rest: float


class MaterialPoint(Module):
    """A point with a mass at a place of its own, which forces move."""

    #: It pulls itself by a force of its own that is more than `held_by` says, or another: it has a part of the program
    #: under every scheme, and a `law`.
    pulls_itself: ClassVar[bool] = False
    initial: ClassVar[tuple[str, ...]] = ("position", "velocity")

    mass: Annotated[float, quantity("Mass", "kg", above=0)]

    @abstractmethod
    def start(self) -> tuple[float, float]:
        """Returns position and velocity at the start, m and m/s."""

    def held_by(self) -> Held | None:
        """Returns the spring and the damper of its own; None where it has none."""
        return None

    def law(self) -> Law:
        """Returns what it does over its position where it pulls itself."""
        raise NotImplementedError


class Mass(MaterialPoint):
    """A simulated material point."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    type: Literal["mass"] = Field(default="mass", description="A material point")
    position: Annotated[float, quantity("Position at the start", "m", coordinates=True)] = 0.0
    velocity: Annotated[float, quantity("Velocity at the start", "m/s", coordinates=True)] = 0.0

    def start(self) -> tuple[float, float]:
        return self.position, self.velocity

    def along(self, axis: int) -> Mass:
        """Returns its coordinate x (0) or y (1) as a point."""
        own = {name: coordinate(getattr(self, name), axis) for name in self.initial}
        return self.model_copy(update=own)


class Cell(MaterialPoint):
    """A material point on a spring and a damper of its own, which hold it to a fixed point."""

    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "rest")

    type: Literal["cell"] = Field(default="cell", description="A material point that is held where it rests")
    stiffness: Annotated[float, quantity("Stiffness of the spring that holds it", "N/m", least=0)]
    damping: Annotated[float, quantity("Viscosity of the damper that holds it", "N·s/m", least=0)] = 0.0
    rest: Annotated[float, quantity("Rest position", "m")] = 0.0
    position: Annotated[float | None, quantity("Position at the start", "m", left_out="where it rests")] = None
    velocity: Annotated[float, quantity("Velocity at the start", "m/s")] = 0.0

    def start(self) -> tuple[float, float]:
        return self.rest if self.position is None else self.position, self.velocity

    def held_by(self) -> Held:
        return Held(self.stiffness, self.damping, self.rest)


HAND = text("The device point that the coupling joins it to, by name", "the name of a module of type device", ".+")


class Proxy(MaterialPoint):
    """A point that stands for a hand in the scene: a virtual coupling, a spring and a damper, joins both."""

    live: ClassVar[tuple[str, ...]] = ("stiffness", "damping")

    type: Literal["proxy"] = Field(
        default="proxy", description="A material point with an implicit step that a virtual coupling joins to a hand"
    )
    hand: Annotated[str, HAND]
    stiffness: Annotated[float, quantity("Stiffness of the coupling", "N/m", least=0)]
    damping: Annotated[float, quantity("Viscosity of the coupling", "N·s/m", least=0)] = 0.0
    position: Annotated[float, quantity("Position at the start", "m")] = 0.0
    velocity: Annotated[float, quantity("Velocity at the start", "m/s")] = 0.0

    def start(self) -> tuple[float, float]:
        return self.position, self.velocity

    @check_of("hand")
    def _stands_for_one_hand(self, name: str, around: ModuleContext) -> Iterator[Issue]:
        first = next(one for one, other in around.of_type(Proxy).items() if other.hand == self.hand)
        if self.hand not in around.kinds or around.kinds[self.hand] not in (None, DevicePoint):
            hint = did_you_mean(self.hand, [one for one, kind in around.kinds.items() if kind is DevicePoint])
            yield Issue(("hand",), f"found {quote(self.hand)}, expected the name of a module of type device{hint}")
        elif first != name:
            sentence = f"found {quote(self.hand)}, which {quote(first)} stands for; expected one proxy for a hand"
            yield Issue(("hand",), sentence)
