"""Lines for the harness, and what it answers, of a device with one channel; the Arduino sketch with other constants."""

from __future__ import annotations

import re
from pathlib import Path

import firmware_protocol
from firmware_protocol import schema
from firmware_protocol.frames import SETUP, armed_format, frame_to_device

SKETCH = Path(firmware_protocol.__file__).parent / "firmware" / "arduino" / "examples" / "motor" / "motor.ino"
ARM = f"bytes {frame_to_device(SETUP, schema.ARM, 100, schema.PACED_BY_DEVICE, [schema.SCHEMA_HASH]).hex()}"
DISARM = f"bytes {frame_to_device(armed_format(1), schema.DISARM, 0, 0, [0]).hex()}"
FAULT = f"register {schema.REG_FAULT}"
IDLE, ARMED, LATCHED = "0", "1", "2"


def force(sample: int, counts: int) -> str:
    return f"bytes {frame_to_device(armed_format(1), schema.FORCE, sample, 50, [counts]).hex()}"


def position_of(frame: str) -> int:
    """The counts of a POSITION of one channel."""
    stuffed = bytearray.fromhex(frame)
    at = 0
    while at < 7:
        stuffed[at], at = 0, at + stuffed[at]
    return int.from_bytes(stuffed[3:7], "little", signed=True)


def write_sketch(folder: Path, constants: dict[str, object]) -> Path:
    text = SKETCH.read_text("utf-8")
    for name, value in constants.items():
        text, found = re.subn(
            rf"^#define {name}\b *(?:[^ /\n]\S*)?", f"#define {name} {value}", text, flags=re.MULTILINE
        )
        assert found == 1, name
    path = folder / "motor.ino"
    path.write_text(text, "utf-8")
    return path
