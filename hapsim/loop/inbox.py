"""Bytes that arrived and are not yet read as frames, shared by the conversation and the loop."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol.decoder import DECODER
from hapsim.compiling.native import record_at
from hapsim.loop.last_bytes import KEPT, LAST_BYTES, next_place
from hapsim.loop.transport import TRANSPORT, PythonTransport

AT_ONCE = 8192
"""Bytes that are taken in one go, at most."""

INBOX = np.dtype(
    [
        ("transport", TRANSPORT),
        ("decoder", DECODER),
        ("start", np.int64),  # of what is not yet looked at
        ("stop", np.int64),
        ("last", LAST_BYTES),
        ("bytes", np.uint8, KEPT + AT_ONCE),
    ],
    align=True,
)
"""A transport, the bytes that arrived over it, and the frames that are found in them."""

inbox_at = record_at(INBOX)


def fetch_in_python(inbox: Any, transport: PythonTransport, timeout_ns: int) -> int:
    """Reads what has arrived into an inbox that is used up, outside of the compiled loop: the count, or a code of
    codes.py."""
    at = int(next_place(inbox.last))
    inbox.start = inbox.stop = at
    count = transport.receive(inbox.bytes[at : at + AT_ONCE], timeout_ns)
    inbox.stop = inbox.last.at = at + max(count, 0)
    return count
