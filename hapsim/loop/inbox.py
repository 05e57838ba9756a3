"""Bytes that arrived and are not yet read as frames, shared by the conversation and the loop."""

from __future__ import annotations

import numpy as np

from firmware_protocol.decoder import next_frame
from hapsim.compiled import inlined, jit
from hapsim.loop.port import receive

INBOX = np.dtype([("start", np.int64), ("stop", np.int64), ("bytes", np.uint8, 8192)], align=True)


def new_inbox() -> np.void:
    """An empty inbox."""
    inbox: np.void = np.zeros(1, INBOX)[0]
    return inbox


@inlined
def frame_waiting(inbox, decoder):
    """Whether the bytes at hand hold a whole frame; it is then in the decoder."""
    if inbox.start == inbox.stop:
        return False
    inbox.start, found = next_frame(decoder, inbox.bytes, inbox.start, inbox.stop)
    return found


@inlined
def fetch(port, inbox, timeout_ns):
    """Reads what has arrived into an inbox that is used up: the count, or a code of codes.py."""
    inbox.start = 0
    inbox.stop = 0
    count = receive(port, inbox.bytes, 0, timeout_ns)
    if count > 0:
        inbox.stop = count
    return count


@jit
def next_frame_within(port, inbox, decoder, timeout_ns):
    """Waits for a frame: (1, whatever) when there is one, else (0, a code of codes.py)."""
    if frame_waiting(inbox, decoder):
        return True, 0
    count = fetch(port, inbox, timeout_ns)
    return count > 0 and frame_waiting(inbox, decoder), min(count, 0)
