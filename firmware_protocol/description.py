"""What a device says of itself: a Description, and the registers it travels in."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema


@dataclass(frozen=True)
class Description:
    """A device as it describes itself, SI units, one entry per channel where a tuple stands."""

    name: str
    """At most 16 printable ASCII characters travel."""
    rate_hz: float
    pacings: int
    """Bit 0: paced by the device, bit 1: by the host, bit 2: lockstep."""
    max_watchdog_samples: int
    position_scale: tuple[float, ...]
    """m per count."""
    force_scale: tuple[float, ...]
    """N per count."""
    force_limit: tuple[float, ...]
    """N, which the device itself never exceeds."""
    velocity_scale: tuple[float, ...] = ()
    """(m/s) per count; empty where the device senses no velocity."""
    version: int = schema.VERSION
    schema_hash: int = schema.SCHEMA_HASH

    @property
    def channels(self) -> int:
        return len(self.position_scale)

    @property
    def senses_velocity(self) -> bool:
        """Whether the device can send velocities: it has a scale above 0 for every channel's."""
        return bool(self.velocity_scale) and all(scale > 0 for scale in self.velocity_scale)

    def paces(self, pacing: int) -> bool:
        """Whether the device can be paced so: PACED_BY_DEVICE, PACED_BY_HOST or LOCKSTEP."""
        return bool(self.pacings >> pacing & 1)


def to_registers(description: Description) -> NDArray[np.int64]:
    """Every register as an unsigned 32-bit value, shape (REGISTERS,).

    A name is cut at 16 characters; what is not printable ASCII becomes a question mark. Raises ValueError unless there
    are 1 to 16 channels, each with both scales and a limit, and velocity scales for all of them or for none.
    """
    _require_channels(description.channels)
    if not description.channels == len(description.force_scale) == len(description.force_limit):
        raise ValueError("every channel needs a position scale, a force scale and a force limit")
    if len(description.velocity_scale) not in (0, description.channels):
        raise ValueError("a device that senses velocity needs a velocity scale for every channel")
    registers = np.zeros(schema.REGISTERS, np.int64)
    registers[schema.REG_VERSION] = description.version
    registers[schema.REG_SCHEMA] = description.schema_hash
    registers[schema.REG_CHANNELS] = description.channels
    registers[schema.REG_PACINGS] = description.pacings
    registers[schema.REG_MAX_WATCHDOG] = description.max_watchdog_samples
    _put_f64(registers, schema.REG_RATE, description.rate_hz)
    name = _printable(description.name).encode("ascii")[: 4 * schema.NAME_WORDS]
    words = struct.unpack(f"<{schema.NAME_WORDS}I", name.ljust(4 * schema.NAME_WORDS, b"\0"))
    registers[schema.REG_NAME : schema.REG_NAME + schema.NAME_WORDS] = words
    for c in range(description.channels):
        base = schema.REG_CHANNEL + c * schema.CHANNEL_WORDS
        _put_f64(registers, base + schema.REG_POSITION_SCALE, description.position_scale[c])
        _put_f64(registers, base + schema.REG_FORCE_SCALE, description.force_scale[c])
        _put_f64(registers, base + schema.REG_FORCE_LIMIT, description.force_limit[c])
        if description.velocity_scale:
            _put_f64(registers, base + schema.REG_VELOCITY_SCALE, description.velocity_scale[c])
    return registers


def registers_of_a_description(channels: int) -> list[int]:
    """The registers to be asked for, once the number of channels is known."""
    wanted = [schema.REG_PACINGS, schema.REG_RATE, schema.REG_RATE + 1, schema.REG_MAX_WATCHDOG]
    wanted += range(schema.REG_NAME, schema.REG_NAME + schema.NAME_WORDS)
    for c in range(channels):
        base = schema.REG_CHANNEL + c * schema.CHANNEL_WORDS
        wanted += range(base, base + schema.REG_VELOCITY_SCALE + 2)
    return wanted


def from_registers(registers: NDArray[np.int64]) -> Description:
    """The description that stands in the registers, shape (REGISTERS,), unsigned 32-bit values.

    The name ends at the first zero byte; a watchdog longer than sample numbers can tell apart is taken for the longest
    that they can; velocity scales that are all zero are none. Raises ValueError unless there are 1 to 16 channels.
    """
    _require_channels(int(registers[schema.REG_CHANNELS]))
    channels = range(int(registers[schema.REG_CHANNELS]))

    def per_channel(which: int) -> tuple[float, ...]:
        return tuple(_get_f64(registers, schema.REG_CHANNEL + c * schema.CHANNEL_WORDS + which) for c in channels)

    velocity_scale = per_channel(schema.REG_VELOCITY_SCALE)
    words = registers[schema.REG_NAME : schema.REG_NAME + schema.NAME_WORDS]
    name = struct.pack(f"<{schema.NAME_WORDS}I", *words.tolist()).partition(b"\0")[0]
    return Description(
        name=_printable(name.decode("latin-1")),
        rate_hz=_get_f64(registers, schema.REG_RATE),
        pacings=int(registers[schema.REG_PACINGS]),
        max_watchdog_samples=min(int(registers[schema.REG_MAX_WATCHDOG]), schema.MAX_WATCHDOG_SAMPLES),
        position_scale=per_channel(schema.REG_POSITION_SCALE),
        force_scale=per_channel(schema.REG_FORCE_SCALE),
        force_limit=per_channel(schema.REG_FORCE_LIMIT),
        velocity_scale=velocity_scale if any(velocity_scale) else (),
        version=int(registers[schema.REG_VERSION]),
        schema_hash=int(registers[schema.REG_SCHEMA]),
    )


def _require_channels(channels: int) -> None:
    if not 1 <= channels <= schema.MAX_CHANNELS:
        raise ValueError(f"{channels} channels: the protocol carries 1 to {schema.MAX_CHANNELS}")


def _printable(name: str) -> str:
    """A name that can be shown on a terminal, whatever the device holds in its registers."""
    return "".join(c if " " <= c <= "~" else "?" for c in name)


def _put_f64(registers: NDArray[np.int64], at: int, value: float) -> None:
    registers[at : at + 2] = struct.unpack("<II", struct.pack("<d", value))


def _get_f64(registers: NDArray[np.int64], at: int) -> float:
    value: float = struct.unpack("<d", struct.pack("<II", int(registers[at]), int(registers[at + 1])))[0]
    return value
