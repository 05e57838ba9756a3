"""A line to a device: a port of the loop, the frames that arrive on it, and how to close it.

The same inbox serves the conversation before the loop, the loop, and the conversation after it: no byte falls between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from firmware_protocol.decoder import new_decoder
from firmware_protocol.frames import SETUP
from hapsim.loop.inbox import new_inbox, next_frame_within
from hapsim.loop.port import send_from


@dataclass
class Line:
    """An open line. `port` is a transport of hapsim.loop.port; `name` is what a user calls the port."""

    port: Any
    name: str
    close: Callable[[], None]
    baud: int | None = None
    """Bit/s, where the line has a speed of its own."""
    note: str = ""
    """What opening it had to leave undone, for the user."""
    has_timer: bool = False
    """Whether the device has a timer of its own: a mock in this process is only as punctual as this machine."""
    inbox: np.void = field(default_factory=new_inbox)
    decoder: np.void = field(default_factory=lambda: new_decoder(SETUP, to_device=False))

    def write(self, frame: bytes) -> bool:
        """Sends a frame, outside of the loop; False where the port does not take it."""
        data = np.frombuffer(frame, np.uint8).copy()
        return bool(send_from(self.port, data, data.size) == 0)

    def next_frame(self, timeout_s: float) -> tuple[bool, int]:
        """Waits for a frame, outside of the loop: (True, …) when there is one in the decoder, else (False, 0 or
        HUNG_UP or FAILED of hapsim.loop.codes)."""
        found, code = next_frame_within(self.port, self.inbox, self.decoder, int(timeout_s * 1e9))
        return bool(found), int(code)
