"""Bytes that arrived and are not yet read as frames, shared by the conversation and the loop."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol.decoder import DECODER
from hapsim.compiling.native import record_at
from hapsim.loop.transport import TRANSPORT, PythonTransport

INBOX = np.dtype(
    [
        ("transport", TRANSPORT),
        ("decoder", DECODER),
        ("start", np.int64),  # of what is not yet looked at
        ("stop", np.int64),
        ("bytes", np.uint8, 8192),
    ],
    align=True,
)
"""A transport, the bytes that arrived over it, and the frames that are found in them."""

inbox_at = record_at(INBOX)


def fetch_in_python(inbox: Any, transport: PythonTransport, timeout_ns: int) -> int:
    """Reads what has arrived into an inbox that is used up, outside of the compiled loop: the count, or a code of
    codes.py."""
    inbox.start = inbox.stop = 0
    count = transport.receive(inbox.bytes, timeout_ns)
    inbox.stop = max(count, 0)
    return count
