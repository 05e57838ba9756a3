"""Sessions of a device, written by hand from PROTOCOL.md.

`make_vectors` writes them to sessions.json; PROTOCOL.md ("Test vectors") explains the entries. Each session quotes the
sentence that it is about.
"""

from __future__ import annotations

from firmware_protocol import schema
from firmware_protocol.sessions_of_faults import FAULTS
from firmware_protocol.sessions_of_samples import SAMPLES
from firmware_protocol.sessions_of_setup import SETUP
from firmware_protocol.story import DEVICES, Entry


def sessions() -> Entry:
    """All of sessions.json."""
    return {
        "about": "Sessions of a device, step by step; PROTOCOL.md explains them. Bytes are hexadecimal.",
        "version": schema.VERSION,
        "schema_hash": schema.SCHEMA_HASH,
        "devices": [{"name": name} | device for name, device in DEVICES.items()],
        "sessions": [tell().entry() for tell in (*SETUP, *SAMPLES, *FAULTS)],
    }
