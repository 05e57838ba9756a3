"""The device point: what the hand holds."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ..issue import Issue, quote
from ..quantity import MOST_CHANNELS, Count
from .module import Module, ModuleContext


class DevicePoint(Module):
    """The point of the scene that the hand holds: one channel of the device."""

    shared: ClassVar[tuple[str, ...]] = ("channel",)

    type: Literal["device"] = Field(default="device", description="A point that the hand holds")
    channel: Annotated[int, Count("Channel of the device, counted from 0", 0, MOST_CHANNELS - 1)]

    def issues(self, name: str, around: ModuleContext) -> Iterator[Issue]:
        """Its channel, where a module before it has it."""
        for other, module in around.sound.items():
            if other == name:
                return
            if isinstance(module, DevicePoint) and module.channel == self.channel:
                yield Issue(
                    ("modules", name, "channel"),
                    f"found {self.channel}, which {quote(other)} has already; expected a channel of its own",
                )
                return
