"""A connection to a device: a transport, the frames that arrive over it, and how to close it.

The same inbox serves the conversation before the loop, the loop, and the conversation after it: no byte falls between.
Here it is read in plain Python, by the same functions that the loop is compiled from.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from firmware_protocol.compiled import new_record
from firmware_protocol.decoder import begin_decoding, next_frame, use_format
from firmware_protocol.frames import SETUP, Format
from hapsim.loop.buffers import INBOX, fetch_in_python
from hapsim.loop.transport import PythonTransport

_REMEMBERED = 128  # frames of the conversation, for a report


def _new_inbox() -> Any:
    inbox = new_record(INBOX)
    begin_decoding(inbox.decoder, SETUP, to_device=False)
    return inbox


@dataclass
class Connection:
    """An open connection. `name` is what a user calls the port."""

    transport: PythonTransport
    name: str
    close: Callable[[], None]
    baud: int | None = None
    """Bit/s, where the port has a speed of its own."""
    note: str = ""
    """What opening it had to leave undone, for the user."""
    has_timer: bool = False
    """Whether the device has a timer of its own: a mock in this process is only as punctual as this machine."""
    in_hand: bool = False
    """Whether a hand may hold the device: nobody holds a mock in this process."""
    inbox: Any = field(default_factory=_new_inbox)
    """INBOX"""
    _written: deque[bytes] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))

    @property
    def decoder(self) -> Any:
        """What the last frame carried, and what was refused."""
        return self.inbox.decoder

    def use_format(self, wire: Format) -> None:
        """From the next byte on, expects frames of this format."""
        use_format(self.decoder, wire)

    def write(self, frame: bytes) -> bool:
        """Sends a frame, outside of the loop; False where the port does not take it."""
        self._written.append(frame)
        return self.transport.send(frame) == 0

    def take_written(self) -> bytes:
        """The last that `write` sent since this was asked before."""
        written = b"".join(self._written)
        self._written.clear()
        return written

    def next_frame(self, timeout_s: float) -> tuple[bool, int]:
        """Waits for a frame, outside of the loop: (True, 0) when there is one in the decoder, else (False, 0 or HUNG_UP
        or FAILED of hapsim.loop.endings)."""
        give_up = time.monotonic() + timeout_s
        while not self._frame_is_waiting():
            left = max(give_up - time.monotonic(), 0.0)
            count = fetch_in_python(self.inbox, self.transport, round(left * 1e9))
            if count <= 0:
                return False, count
        return True, 0

    def _frame_is_waiting(self) -> bool:
        """Whether the bytes at hand hold a whole frame; it is then in the decoder."""
        inbox = self.inbox
        inbox.start, found = next_frame(inbox.decoder, inbox.bytes, int(inbox.start), int(inbox.stop))
        return bool(found)
