"""A connection to a device: a transport, the frames that arrive over it, and how to close it.

The conversation before and after the loop and the loop itself share one inbox, so no byte is lost between them. Here
plain Python reads it, by the functions that the loop is compiled from.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from firmware_protocol.compiled import new_record
from firmware_protocol.decoder import next_frame, use_format
from firmware_protocol.frames import SETUP, Format, framing_of
from hapsim.loop.buffers import INBOX, fetch_in_python
from hapsim.loop.transport import PythonTransport

_REMEMBERED = 128  # frames of the conversation, for a report


def _new_inbox() -> Any:
    inbox = new_record(INBOX)
    inbox.decoder.framing = framing_of(SETUP, to_device=False)
    return inbox


@dataclass
class Connection:
    """An open connection. `name` is the port's for the user."""

    transport: PythonTransport
    name: str
    close: Callable[[], None]
    baud: int | None = None
    """Bit/s, where the port has a speed of its own."""
    note: str = ""
    """For the user: what could not be set when it was opened."""
    round_trip_s: float = 0.0
    """The shortest time from a question to its answer while the device described itself; 0 before."""
    behind_port: bool = False
    """Whether the device may have a timer and a hand of its own. A mock in this process has no hand, and is only as
    punctual as this machine."""
    mock: Any = None
    """MOCK, where the device is the one in this process."""
    inbox: Any = field(default_factory=_new_inbox)
    """INBOX"""
    _written: deque[bytes] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))

    @property
    def decoder(self) -> Any:
        """The fields of the last frame, and the counts of rejected ones."""
        return self.inbox.decoder

    def use_format(self, wire: Format) -> None:
        """Expects frames of this format from the next byte on."""
        use_format(self.decoder, wire)

    def write(self, frame: bytes) -> bool:
        """Sends a frame, outside of the loop. Returns False where the port does not take it."""
        self._written.append(frame)
        return self.transport.send(frame) == 0

    def take_written(self) -> bytes:
        """Returns what `write` sent since the last call, at most 128 frames."""
        written = b"".join(self._written)
        self._written.clear()
        return written

    def next_frame(self, timeout_s: float) -> tuple[bool, int]:
        """Waits for a frame, outside of the loop. Returns (True, 0) with one in the decoder, else (False, 0 or HUNG_UP
        or FAILED of hapsim.loop.endings)."""
        inbox = self.inbox
        give_up = time.monotonic() + timeout_s
        while True:
            inbox.start, found = next_frame(inbox.decoder, inbox.bytes, int(inbox.start), int(inbox.stop))
            if found:
                return True, 0
            left = max(give_up - time.monotonic(), 0.0)
            count = fetch_in_python(inbox, self.transport, round(left * 1e9))
            if count <= 0:
                return False, count
