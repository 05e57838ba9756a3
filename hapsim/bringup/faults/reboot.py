"""A device that starts anew while it is armed: silent for a while, and then in its set-up state, disarmed."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, Format, frame_to_device
from hapsim.bringup.faults.fault import Effect, Event
from hapsim.bringup.faults.piece import Moment, Piece
from hapsim.bringup.faults.timing import Window
from hapsim.scene.quantity import Quantity


class Reboot(Event):
    """The device resets."""

    told: ClassVar[str] = "The device falls silent, and comes back in its set-up state, disarmed."
    counted: ClassVar[str] = "times"
    kind: Literal["reboot"] = "reboot"
    seconds: Annotated[float, Quantity("How long it takes to come back", "s", above=0)] = 0.5

    def effect(self, seed: str) -> Effect:
        del seed
        return _Reboot(self)

    def window(self) -> Window:
        return Window(self.at, self.after_samples, self.seconds)


class _Reboot(Effect):
    """The device behind it is disarmed, as a reset does, and what it says to that is not passed on."""

    def __init__(self, fault: Reboot) -> None:
        super().__init__(fault)
        self._wire: Format = SETUP
        """What the device was last heard to speak."""

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        if piece.found is not None and not piece.to_device:
            self._wire = piece.found.wire
        return [] if self.window.is_open(now) else [piece]

    def pass_time(self, now: Moment) -> list[Piece]:
        if self.window.opened is not None or not self.window.is_open(now):
            self.window.is_open(now)
            return []
        self.count = 1
        farewell = frame_to_device(self._wire, schema.DISARM, 0, 0, np.zeros(self._wire.channels, np.int64))
        return [Piece(farewell, to_device=True)]
