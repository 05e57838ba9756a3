"""The points that links join: the device point, the ground, CORDIS's MAS (mass) and CEL (cell), the proxy."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from hapsim.laws import Law

from ..issue import Issue, did_you_mean, quote
from ..part import Module, ModuleContext, check_of
from ..quantity import MOST_CHANNELS, count, quantity, text


class DevicePoint(Module):
    """The point of the scene that the hand holds: one channel of the device."""

    type: Literal["device"] = Field(default="device", description="A point that the hand holds")
    channel: Annotated[int, count("Channel of the device, counted from 0", 0, MOST_CHANNELS - 1)]

    @check_of("channel")
    def _is_alone_on_its_channel(self, name: str, around: ModuleContext) -> Iterator[Issue]:
        points = {other: one for other, one in around.modules.items() if isinstance(one, DevicePoint)}
        sound = [other for other in points if around.knows(other, "channel")]
        first = next(other for other in sound if points[other].channel == self.channel)
        if first != name:
            sentence = f"found {self.channel}, which {quote(first)} already uses; expected an unused channel"
            yield Issue(("channel",), sentence)


class Ground(Module):
    """A fixed point."""

    can_move: ClassVar[bool] = False
    live: ClassVar[tuple[str, ...]] = ("position",)

    type: Literal["ground"] = Field(default="ground", description="A fixed point")
    position: Annotated[float, quantity("Position", "m")] = 0.0


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

    type: Literal["mass"] = Field(default="mass", description="A material point")
    position: Annotated[float, quantity("Position at the start", "m")] = 0.0
    velocity: Annotated[float, quantity("Velocity at the start", "m/s")] = 0.0

    def start(self) -> tuple[float, float]:
        return self.position, self.velocity


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
        others = {one: other.hand for one, other in around.modules.items() if isinstance(other, Proxy)}
        first = next(one for one, hand in others.items() if hand == self.hand)
        if self.hand not in around.kinds or around.kinds[self.hand] not in (None, DevicePoint):
            hint = did_you_mean(self.hand, [one for one, kind in around.kinds.items() if kind is DevicePoint])
            yield Issue(("hand",), f"found {quote(self.hand)}, expected the name of a module of type device{hint}")
        elif first != name:
            sentence = f"found {quote(self.hand)}, which {quote(first)} stands for; expected one proxy for a hand"
            yield Issue(("hand",), sentence)
