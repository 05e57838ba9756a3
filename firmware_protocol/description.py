"""A device's description of itself, and the registers that carry it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.lines import SHIFTS, Lines, line_units, lines_of


class Servo(NamedTuple):
    """Servo that follows position commands: SI units, tuples with one entry per channel."""

    speed_limit: tuple[float, ...]
    """m/s, which the device itself never exceeds."""
    braking: tuple[float, ...]
    """m/s², at which it comes to rest when its host is silent."""
    bandwidth_hz: tuple[float, ...]
    """Natural frequency of the second-order servo; 0: it follows commands exactly, in straight lines."""
    damping: tuple[float, ...]
    """Damping ratio of the servo; 1: critical."""


@dataclass(frozen=True)
class Description:
    """A device as it describes itself: SI units, tuples with one entry per channel."""

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
    acceleration_scale: tuple[float, ...] = ()
    """(m/s²) per count; empty where the device senses no acceleration."""
    hand_force_scale: tuple[float, ...] = ()
    """N per count; empty where the device senses no force between hand and handle."""
    hand_force_range: tuple[float, ...] = ()
    """N, beyond which that sensor saturates; empty like its scale."""
    rotary: int = 0
    """Bit c: channel c turns, in rad and N·m. 0: not declared."""
    bridge: int = 0
    """1: the actuators are behind another protocol; what this one promises ends there."""
    sensors: int = 0
    """Bit 0: acceleration is sensed; bit 1: hand force; bit 2: there are digital words; bit 3: lines are followed; bit
    4: position commands are followed."""
    lines: Lines | None = None
    """Board that follows lines; None if the device does not."""
    servo: Servo | None = None
    """Servo that follows position commands; None if the device does not."""
    version: int = schema.VERSION
    schema_hash: int = schema.SCHEMA_HASH

    @property
    def channels(self) -> int:
        """Number of the device's channels."""
        return len(self.position_scale)

    @property
    def sensed(self) -> tuple[str, ...]:
        """Names of the parts of POSITION that the device can send: those with a scale above 0 on every channel."""
        scales = {part.name: self.scale(part.name) for part in schema.SENSED}
        return tuple(name for name, scale in scales.items() if scale and all(one > 0 for one in scale))

    def scale(self, part: str) -> tuple[float, ...]:
        """Returns the scales of a part of POSITION, in SI units per count; empty where the device has none."""
        scale: tuple[float, ...] = getattr(self, f"{part}_scale")
        return scale

    @property
    def motions(self) -> tuple[Literal["linear", "rotary"], ...]:
        """Motion of each channel; linear where none is declared."""
        return schema.motions(self.rotary, self.channels)

    @property
    def has_words(self) -> bool:
        """True if the device has a digital word each way."""
        return bool(self.sensors & schema.HAS_DIGITAL_WORD)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of all parts of POSITION and FORCE that the device can send or take."""
        others = {"line": self.lines, "command": self.servo, "inputs": self.has_words}
        return (*self.sensed, *(name for name, has in others.items() if has))

    def paces(self, pacing: int) -> bool:
        """Returns whether the device offers PACED_BY_DEVICE, PACED_BY_HOST or LOCKSTEP."""
        return bool(self.pacings >> pacing & 1)


_WORDS = {
    "version": schema.REG_VERSION,
    "schema_hash": schema.REG_SCHEMA,
    "channels": schema.REG_CHANNELS,
    "pacings": schema.REG_PACINGS,
    "max_watchdog_samples": schema.REG_MAX_WATCHDOG,
    "rotary": schema.REG_ROTARY,
    "bridge": schema.REG_BRIDGE,
    "sensors": schema.REG_SENSORS,
}
_NAME = slice(schema.REG_NAME, schema.REG_NAME + schema.NAME_WORDS)
_NAME_BYTES = 4 * schema.NAME_WORDS
_DECLARED = [part for part in schema.SENSED if part.declared_by]  # their scales are outside of CHANNEL_REGISTERS
_OF_LINES = slice(schema.REG_BOARD_STEPS, schema.REG_KEPT_REPORTS + 1)


def to_registers(description: Description) -> NDArray[np.int64]:
    """Returns every register as an unsigned 32-bit value, shape (REGISTERS,).

    A name is cut at 16 characters; what is not printable ASCII becomes a question mark. Raises ValueError unless there
    are 1 to 16 channels, each with both scales and a limit, and scales of velocity for all of them or for none, so of
    acceleration, of hand force and of a servo; and for scales of lines that no shift gives.
    """
    channels = description.channels
    schema.require_channels(channels)
    if not channels == len(description.force_scale) == len(description.force_limit):
        raise ValueError("every channel needs a position scale, a force scale and a force limit")
    for part in schema.SENSED:
        if len(description.scale(part.name)) not in (0, channels):
            raise ValueError(f"a device that senses {part.name} needs a scale of it for every channel")
    if len(description.hand_force_range) != len(description.hand_force_scale):
        raise ValueError("a device that senses hand_force needs a range of it for every channel")
    if any(len(each) != channels for each in description.servo or ()):
        raise ValueError("a device that follows position commands needs all values of its servo for every channel")
    registers = np.zeros(schema.REGISTERS, "<u4")
    for name, register in _WORDS.items():
        registers[register] = getattr(description, name)
    doubles, per_channel = _doubles_of(registers)
    doubles[schema.REG_RATE // 2] = description.rate_hz
    for name, register in schema.CHANNEL_REGISTERS.items():
        per_channel[:channels, register // 2] = getattr(description, name) or 0.0
    for part in _DECLARED:
        doubles[_scales_at(part, channels)] = description.scale(part.name) or 0.0
    doubles[_places(schema.REG_HAND_FORCE_RANGE, channels)] = description.hand_force_range or 0.0
    if description.servo:
        for name, register in schema.SERVO_REGISTERS.items():
            doubles[_places(register, channels)] = getattr(description.servo, name)
    if description.lines:
        _put_lines(registers, description, description.lines)
    characters = _printable(description.name).encode("ascii")[:_NAME_BYTES]
    registers[_NAME] = np.frombuffer(characters.ljust(_NAME_BYTES, b"\0"), "<u4")
    return registers.astype(np.int64)


def registers_of_a_description(channels: int, sensors: int) -> list[int]:
    """Returns the registers that a host reads once it knows the number of channels and REG_SENSORS."""
    wanted = [schema.REG_PACINGS, schema.REG_RATE, schema.REG_RATE + 1, schema.REG_MAX_WATCHDOG]
    scales = [*range(schema.REG_CHANNEL, schema.REG_CHANNEL + channels * schema.CHANNEL_WORDS)]
    for part in _DECLARED:
        if sensors & part.declared_by:
            scales += _both_words(part.scale_register, channels)
    if sensors & schema.SENSES_FORCE:
        scales += _both_words(schema.REG_HAND_FORCE_RANGE, channels)
    if sensors & schema.FOLLOWS_COMMANDS:
        scales += [n for register in schema.SERVO_REGISTERS.values() for n in _both_words(register, channels)]
    if sensors & schema.FOLLOWS_LINES:
        scales += [*range(schema.REGISTERS)[_OF_LINES], *(n for c in range(channels) for n in _line_registers(c))]
    return [*wanted, schema.REG_ROTARY, schema.REG_BRIDGE, *range(_NAME.start, _NAME.stop), *scales]


def from_registers(registers: NDArray[np.int64]) -> Description:
    """Returns the description in the registers, shape (REGISTERS,), unsigned 32-bit values.

    The name ends at the first zero byte. A watchdog longer than sample numbers can distinguish becomes the longest that
    they can. Scales of a part that are all zero, or that REG_SENSORS does not declare, are none. Raises ValueError
    unless there are 1 to 16 channels.
    """
    words: dict[str, Any] = {name: int(registers[register]) for name, register in _WORDS.items()}
    channels = words.pop("channels")
    schema.require_channels(channels)
    held = registers.astype("<u4")
    doubles, per_channel = _doubles_of(held)
    scales: dict[str, Any] = {
        name: tuple(per_channel[:channels, register // 2].tolist())
        for name, register in schema.CHANNEL_REGISTERS.items()
    }
    for part in _DECLARED:
        declared = words["sensors"] & part.declared_by
        scales[f"{part.name}_scale"] = tuple(doubles[_scales_at(part, channels)].tolist()) if declared else ()
    for part in schema.SENSED:
        if not any(scales[f"{part.name}_scale"]):
            scales[f"{part.name}_scale"] = ()
    if scales["hand_force_scale"]:
        scales["hand_force_range"] = tuple(doubles[_places(schema.REG_HAND_FORCE_RANGE, channels)].tolist())
    if words["sensors"] & schema.FOLLOWS_COMMANDS:
        each = {name: doubles[_places(at, channels)].tolist() for name, at in schema.SERVO_REGISTERS.items()}
        scales["servo"] = Servo(**{name: tuple(values) for name, values in each.items()})
    words["max_watchdog_samples"] = min(words["max_watchdog_samples"], schema.MAX_WATCHDOG_SAMPLES)
    characters = held[_NAME].tobytes().partition(b"\0")[0].decode("latin-1")
    rate = float(doubles[schema.REG_RATE // 2])
    description = Description(name=_printable(characters), rate_hz=rate, **words, **scales)
    return replace(description, lines=_lines_in(registers, description))


def _line_registers(channel: int) -> tuple[int, int]:
    """Returns the registers of a channel's shifts and of its largest counts."""
    return schema.REG_LINE_SHIFTS + channel * schema.MORE_WORDS, schema.REG_LARGEST + channel * schema.MORE_WORDS


def line_registers(registers: NDArray[np.int64], channel: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Returns the shifts of stiffness and damping of a channel's line, and their largest counts."""
    shifts, most = registers[[*_line_registers(channel)]].tolist()
    low, high = (((shifts >> bits & 0xFF) ^ 0x80) - 0x80 for bits in (0, 8))
    return (low, high), (most >> 16 & 0xFFFF, most & 0xFFFF)


def _units(description: Description, steps: int, window: int) -> list[tuple[float, float]]:
    window_s = window / (steps * description.rate_hz)
    scales = zip(description.force_scale, description.position_scale, strict=True)
    return [line_units(force / position, window_s) for force, position in scales]


def _put_lines(registers: NDArray[np.uint32], description: Description, lines: Lines) -> None:
    registers[_OF_LINES] = lines.steps, lines.delay, lines.window, lines.kept
    for c, units in enumerate(_units(description, lines.steps, lines.window)):
        *scales, most_k, most_b = lines.scales(c)
        shifts = [round(math.log2(unit / scale)) for unit, scale in zip(units, scales, strict=True)]
        if any(shift not in SHIFTS for shift in shifts):
            raise ValueError(f"channel {c}: shifts {shifts} of its line, expected {SHIFTS[0]} to {SHIFTS[-1]}")
        most = round(most_k / scales[0]) << 16 | round(most_b / scales[1])
        registers[[*_line_registers(c)]] = (shifts[0] & 0xFF) | (shifts[1] & 0xFF) << 8, most


def _lines_in(registers: NDArray[np.int64], description: Description) -> Lines | None:
    """Returns how the device follows lines; None if it does not, or if what it says of them is no description."""
    steps, delay, window, kept = registers[_OF_LINES].tolist()
    if not description.sensors & schema.FOLLOWS_LINES or not (steps and window and kept and description.rate_hz > 0.0):
        return None
    if not all(math.isfinite(one) and one > 0.0 for one in (*description.position_scale, *description.force_scale)):
        return None
    shifts, largest = [], []
    for c in range(description.channels):
        of_shifts, most = line_registers(registers, c)
        shifts.append(of_shifts)
        largest.append(most)
    if any(shift not in SHIFTS for each in shifts for shift in each):
        return None
    return lines_of((steps, delay, window, kept), _units(description, steps, window), shifts, largest)


def _doubles_of(registers: NDArray[np.uint32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns (the registers as doubles, those of the channels with a row for each), which share their memory."""
    doubles = registers.view("<f8")
    rows = doubles[schema.REG_CHANNEL // 2 : schema.REG_MORE // 2]
    return doubles, rows.reshape(schema.MAX_CHANNELS, schema.CHANNEL_WORDS // 2)


def _scales_at(part: schema.Part, channels: int) -> slice:
    """Returns the places of a part's scales among the registers as doubles."""
    return _places(part.scale_register, channels, part.register_step)


def _places(register: int, channels: int, step: int = schema.MORE_WORDS) -> slice:
    """Returns the places among the registers as doubles of one per channel; `register`: channel 0's."""
    return slice(register // 2, (register + channels * step) // 2, step // 2)


def _both_words(register: int, channels: int) -> list[int]:
    """Returns the registers of a double of each channel; `register`: channel 0's."""
    first = range(register, register + channels * schema.MORE_WORDS, schema.MORE_WORDS)
    return [low + half for low in first for half in (0, 1)]


def _printable(name: str) -> str:
    """A name that a terminal can show, whatever the device holds in its registers."""
    return "".join(c if " " <= c <= "~" else "?" for c in name)
