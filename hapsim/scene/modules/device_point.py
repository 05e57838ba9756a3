"""The device point: what the hand holds."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from ..issue import Issue, quote
from ..quantity import MOST_CHANNELS, Count
from .module import Check, Module, ModuleContext


class DevicePoint(Module):
    """The point of the scene that the hand holds: one channel of the device."""

    type: Literal["device"] = Field(default="device", description="A point that the hand holds")
    channel: Annotated[int, Count("Channel of the device, counted from 0", 0, MOST_CHANNELS - 1)]

    def checks(self) -> list[Check]:
        return [Check(("channel",), self._is_alone_on_its_channel)]

    def _is_alone_on_its_channel(self, name: str, around: ModuleContext) -> Iterator[Issue]:
        for other, module in around.modules.items():
            if other == name:
                return
            if not isinstance(module, DevicePoint) or not around.knows(other, "channel"):
                continue
            if module.channel == self.channel:
                yield Issue(
                    ("modules", name, "channel"),
                    f"found {self.channel}, which {quote(other)} has already; expected a channel of its own",
                )
                return
