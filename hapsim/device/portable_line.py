"""A line that is read and written from Python, for the portable loop."""

from __future__ import annotations

import time
from dataclasses import dataclass

from hapsim.compiled import jit
from hapsim.device.line import Line
from hapsim.loop.inbox import frame_waiting


@jit
def _frame_is_waiting(inbox, decoder):  # type: ignore[no-untyped-def]
    return frame_waiting(inbox, decoder)


@dataclass
class PortableLine(Line):
    """`port` is a PortablePort."""

    def write(self, frame: bytes) -> bool:
        """Sends a frame, outside of the loop; False where the port does not take it."""
        return bool(self.port.send(frame) == 0)

    def next_frame(self, timeout_s: float) -> tuple[bool, int]:
        """Waits for a frame, outside of the loop; as `Line.next_frame`."""
        give_up = time.monotonic() + timeout_s
        while not _frame_is_waiting(self.inbox, self.decoder):
            count = self.port.receive(self.inbox, round((give_up - time.monotonic()) * 1e9))
            if count <= 0:
                return False, int(count)
        return True, 0
