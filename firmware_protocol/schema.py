"""The wire's constants, version 1: frame types, fields, registers, lengths and times. PROTOCOL.md explains each.

They import no compiler. `SCHEMA` is their canonical text; its hash is the start value of the check on every frame of
an armed device, so that two sides with different meanings reject each other's frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Literal

VERSION = 1
MAX_CHANNELS = 16
MAX_WORDS = 62  # of a payload: the longest body that COBS stuffs by a single byte has 253 bytes
SAMPLE_MODULUS = 4096  # sample numbers travel in 12 bits
MAX_WATCHDOG_SAMPLES = SAMPLE_MODULUS // 2 - 1  # below half the modulus: an age is never ambiguous
MAX_TIME_TO_LIVE_SAMPLES = 255
SHORT_CRC_WORDS = 3  # up to here a payload leaves a frame within 135 bits, where CRC-16/DNP has distance 6

# Host to device.
DESCRIBE, ARM, FORCE, DISARM = 0x1, 0x2, 0x3, 0x4
# Device to host.
DESCRIPTION, POSITION, POSITION_HELD, STATUS = 0x9, 0xA, 0xB, 0xC
TYPES = {
    DESCRIBE: "DESCRIBE",
    ARM: "ARM",
    FORCE: "FORCE",
    DISARM: "DISARM",
    DESCRIPTION: "DESCRIPTION",
    POSITION: "POSITION",
    POSITION_HELD: "POSITION_HELD",
    STATUS: "STATUS",
}
POSITIONS = (POSITION, POSITION_HELD)

# The pacing of an armed device's samples, in ARM's argument beside the bits of PARTS.
PACED_BY_DEVICE, PACED_BY_HOST, LOCKSTEP = 0, 1, 2
PACINGS = {PACED_BY_DEVICE: "device", PACED_BY_HOST: "host", LOCKSTEP: "lockstep"}

# States and faults, in a status frame.
IDLE, ARMED, LATCHED = 0, 1, 2
STATES = {IDLE: "idle", ARMED: "armed", LATCHED: "latched"}
NO_FAULT, HOST_QUIET, POSITION_OUT_OF_RANGE, WRONG_SCHEMA, WRONG_PACING, WRONG_WATCHDOG = range(6)
HARDWARE, WRONG_SENSING = 6, 7
FAULTS = {
    NO_FAULT: "no fault",
    HOST_QUIET: "the host was quiet for longer than the watchdog allows",
    POSITION_OUT_OF_RANGE: "a position left the range of its counts",
    WRONG_SCHEMA: "the host speaks another schema of this protocol",
    WRONG_PACING: "the device cannot be paced in the way that was asked",
    WRONG_WATCHDOG: "the watchdog asked for is outside what the device allows",
    HARDWARE: "the device found a fault in its own hardware",
    WRONG_SENSING: "the device does not have the velocity, acceleration, hand force, line, position command or "
    "digital word that was asked for",
}

# Registers of the description, each 32 bits; an f64 takes two, low word first.
REG_VERSION, REG_SCHEMA, REG_CHANNELS, REG_PACINGS, REG_RATE = range(5)
REG_MAX_WATCHDOG, REG_FAULT, REG_ACCEPTED, REG_REJECTED, REG_HELD, REG_EXPIRED, REG_LIMITED = range(6, 13)
REG_ROTARY = 13  # a bit for each channel; not in SCHEMA, whose hash boards in the field have: there it reads 0
REG_BRIDGE = 14  # 1: guards end at a bridge to another protocol; not in SCHEMA either
REG_SENSORS = 15  # a bit for each kind of sensor, below; not in SCHEMA either
SENSES_ACCELERATION, SENSES_FORCE, HAS_DIGITAL_WORD, FOLLOWS_LINES, FOLLOWS_COMMANDS = 1, 2, 4, 8, 16
REG_NAME, NAME_WORDS = 16, 4
REG_BOARD_STEPS, REG_BOARD_DELAY, REG_BOARD_WINDOW, REG_KEPT_REPORTS = range(20, 24)  # of lines; not in SCHEMA
REG_CHANNEL, CHANNEL_WORDS = 32, 8  # CHANNEL_WORDS of them for each channel, with these inside:
REG_POSITION_SCALE, REG_FORCE_SCALE, REG_FORCE_LIMIT, REG_VELOCITY_SCALE = range(0, CHANNEL_WORDS, 2)
CHANNEL_REGISTERS = {
    "position_scale": REG_POSITION_SCALE,
    "force_scale": REG_FORCE_SCALE,
    "force_limit": REG_FORCE_LIMIT,
    "velocity_scale": REG_VELOCITY_SCALE,
}
REG_MORE, MORE_WORDS = REG_CHANNEL + MAX_CHANNELS * CHANNEL_WORDS, 16  # again for each channel; not in SCHEMA
REG_LINE_SHIFTS, REG_LARGEST = REG_MORE + 2, REG_MORE + 3  # of channel 0's line
REG_HAND_FORCE_SCALE, REG_HAND_FORCE_RANGE = REG_MORE + 4, REG_MORE + 6  # of channel 0's force sensor
REG_SPEED_LIMIT, REG_BRAKING, REG_BANDWIDTH, REG_SERVO_DAMPING = range(REG_MORE + 8, REG_MORE + MORE_WORDS, 2)
SERVO_REGISTERS = {  # of channel 0's servo
    "speed_limit": REG_SPEED_LIMIT,
    "braking": REG_BRAKING,
    "bandwidth_hz": REG_BANDWIDTH,
    "damping": REG_SERVO_DAMPING,
}
REGISTERS = REG_MORE + MAX_CHANNELS * MORE_WORDS


@dataclass(frozen=True)
class Part:
    """A part of POSITION behind the positions, or of FORCE behind the forces. ARM requests each by its own bit."""

    name: str
    """As in a scene; `Description` has the scale of what is sensed as `NAME_scale`."""
    bit: int
    """Bit of ARM's argument."""
    mark: int
    """Word that changes the check's start value where the part is on the wire."""
    scale_register: int = 0
    """Register of channel 0's scale: an f64, SI units per count; 0 where the channel senses none."""
    register_step: int = MORE_WORDS
    """Registers from one channel to the next."""
    declared_by: int = 0
    """Bit of REG_SENSORS without which its registers are not read; 0: they always are."""
    to_device: bool = False
    """True for a part of FORCE, and so of every frame to the device."""
    words_each: int = 1
    """Words per channel."""
    per_channel: bool = True
    """False: one word for all channels."""

    def words(self, channels: int) -> int:
        """Returns its words in a payload."""
        return self.words_each * channels if self.per_channel else 1


# "VEL", "ACC", "FRC", "SIG", "LIN" and "CMD", and a byte: such that a device of one channel, with velocities,
# accelerations, or velocities and words, never takes the echo of its own position for a frame of the host. A test fails
# where a changed schema needs another byte.
SENSED = (
    Part("velocity", 0x80, 0x56454C01, REG_CHANNEL + REG_VELOCITY_SCALE, CHANNEL_WORDS),
    Part("acceleration", 0x20, 0x41434302, REG_MORE, MORE_WORDS, SENSES_ACCELERATION),
    Part("hand_force", 0x40, 0x46524304, REG_HAND_FORCE_SCALE, MORE_WORDS, SENSES_FORCE),
)
"""Parts of POSITION, in their order on the wire. The last is the force of the hand on the handle."""
LINE = Part("line", 0x04, 0x4C494E03, declared_by=FOLLOWS_LINES, to_device=True, words_each=2)
"""Stiffness, damping and bounds of a force (lines.py)."""
COMMAND = Part("command", 0x08, 0x434D4405, declared_by=FOLLOWS_COMMANDS, to_device=True)
"""Position that the device's servo follows, in counts of position. The forces in the same frame are ignored."""
INPUTS = Part("inputs", 0x10, 0x5349470E, declared_by=HAS_DIGITAL_WORD, per_channel=False)
OUTPUTS = Part("outputs", 0x10, 0, declared_by=HAS_DIGITAL_WORD, to_device=True, per_channel=False)
"""A digital word each way, of 32 bits. One bit of ARM requests both; the mark of one serves for both."""
PARTS = (*SENSED, INPUTS, LINE, COMMAND, OUTPUTS)
"""All parts, those of each direction in their order on the wire."""

WITH_VELOCITY, WITH_ACCELERATION, WITH_FORCE = (part.bit for part in SENSED)
WITH_LINE, WITH_COMMANDS, WITH_WORDS = LINE.bit, COMMAND.bit, INPUTS.bit
PART_BITS = WITH_VELOCITY | WITH_ACCELERATION | WITH_FORCE | WITH_LINE | WITH_COMMANDS | WITH_WORDS
"""Any other bit of ARM's argument belongs to the pacing: a device refuses one that it does not know."""
MOTION_BITS = WITH_VELOCITY | WITH_ACCELERATION
ADMITTANCE = WITH_FORCE | WITH_COMMANDS
"""Parts that a host needs in admittance."""
COMBINATIONS = tuple(
    words | way | sensed
    for words in (0, WITH_WORDS)
    for way in (0, WITH_LINE, ADMITTANCE)
    for sensed in (0, WITH_VELOCITY, WITH_ACCELERATION, MOTION_BITS)
)
"""Combinations of parts that a host may request."""

SCHEMA = f"""hapsim wire {VERSION}
frame cobs(header:u16be argument:u8[host] payload:i32le*words) crc7bit zero
words channels, from device with_velocity 2*channels
header type:4 number:12
crc longest words<={SHORT_CRC_WORDS} crc16dnp else crc32c
host describe={DESCRIBE:x} arm={ARM:x} force={FORCE:x} disarm={DISARM:x}
device description={DESCRIPTION:x} position={POSITION:x} held={POSITION_HELD:x} status={STATUS:x}
describe number=register
arm number=watchdog_samples argument=pacing|with_velocity payload0=schema
force number=sample argument=time_to_live_samples payload=force
description number=register payload0=value
position held number=sample payload=position,velocity[with_velocity]
status number=sample payload0=state:u8,fault:u8
pacing device={PACED_BY_DEVICE} host={PACED_BY_HOST} lockstep={LOCKSTEP} with_velocity={WITH_VELOCITY:x}
state idle={IDLE} armed={ARMED} latched={LATCHED}
fault host_quiet={HOST_QUIET} position_out_of_range={POSITION_OUT_OF_RANGE} wrong_schema={WRONG_SCHEMA}
fault wrong_pacing={WRONG_PACING} wrong_watchdog={WRONG_WATCHDOG} hardware={HARDWARE} wrong_sensing={WRONG_SENSING}
register version={REG_VERSION} schema={REG_SCHEMA} channels={REG_CHANNELS} pacings={REG_PACINGS} rate={REG_RATE}:f64
register max_watchdog={REG_MAX_WATCHDOG} fault={REG_FAULT} accepted={REG_ACCEPTED} rejected={REG_REJECTED}
register held={REG_HELD} expired={REG_EXPIRED} limited={REG_LIMITED} name={REG_NAME}:{NAME_WORDS}
register channel={REG_CHANNEL}+{CHANNEL_WORDS}c position_scale={REG_POSITION_SCALE}:f64
register force_scale={REG_FORCE_SCALE}:f64 force_limit={REG_FORCE_LIMIT}:f64 velocity_scale={REG_VELOCITY_SCALE}:f64
"""


def _crc32c(text: bytes) -> int:
    """CRC-32C bit by bit: it needs no compiler."""
    crc = 0xFFFFFFFF
    for byte in text:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


SCHEMA_HASH = _crc32c(SCHEMA.encode("ascii"))
SETUP_SEED = 0x4853  # "HS": the same in every version, so that versions can name each other


def folded(word: int) -> int:
    """Returns the 16-bit start value that belongs to one of 32 bits."""
    return (word ^ (word >> 16)) & 0xFFFF


def parts_of(names: Iterable[str]) -> int:
    """Returns ARM's bits of the parts with these names."""
    asked = set(names)
    return sum({part.bit for part in PARTS if part.name in asked})


def in_parts(parts: int, to_device: bool = False) -> list[Part]:
    """Returns the parts of one direction with these bits of ARM, in their order on the wire."""
    return [part for part in PARTS if parts & part.bit and part.to_device == to_device]


def seed_word(parts: int) -> int:
    """Returns the word from which the start value of an armed format is made."""
    word = SCHEMA_HASH
    for part in PARTS:
        word ^= part.mark if parts & part.bit else 0
    return word


def require_channels(channels: int) -> None:
    """Raises ValueError for a number of channels that the protocol does not carry."""
    if not 1 <= channels <= MAX_CHANNELS:
        raise ValueError(f"{channels} channels: the protocol carries 1 to {MAX_CHANNELS}")


@cache
def words(channels: int, to_device: bool, parts: int = 0) -> int:
    """Returns the words of a frame's payload. `parts`: ARM's bits of what stands behind positions and forces."""
    return channels + sum(part.words(channels) for part in in_parts(parts, to_device))


def _longest(channels: int, parts: int) -> int:
    return max(words(channels, to_device, parts) for to_device in (False, True))


def fits(channels: int, parts: int) -> bool:
    """Returns whether the longest frame of this format stays within MAX_WORDS."""
    return _longest(channels, parts) <= MAX_WORDS


def require_words(channels: int, parts: int) -> None:
    """Raises ValueError for a number of channels or a payload that the protocol does not carry."""
    require_channels(channels)
    if not fits(channels, parts):
        names = ", ".join(part.name for part in PARTS if part.bit & parts)
        raise ValueError(
            f"{channels} channels with {names}: a frame of {_longest(channels, parts)} words, expected at most "
            f"{MAX_WORDS}: request fewer parts, or build the device with fewer channels"
        )


def motions(rotary: int, channels: int) -> tuple[Literal["linear", "rotary"], ...]:
    """Returns the motion of each channel by REG_ROTARY; linear where none is declared."""
    return tuple("rotary" if rotary >> channel & 1 else "linear" for channel in range(channels))


def has_long_check(channels: int, parts: int = 0) -> bool:
    """Returns whether the check has 32 bits. The format's longest frame decides for both directions."""
    return _longest(channels, parts) > SHORT_CRC_WORDS


def encoded_bytes(channels: int, to_device: bool, parts: int = 0) -> int:
    """Returns the bytes before the check: COBS code, header, argument (to the device only) and payload."""
    return 1 + 2 + int(to_device) + 4 * words(channels, to_device, parts)


def frame_bytes(channels: int, to_device: bool, parts: int = 0) -> int:
    """Returns the bytes of a whole frame on the wire, with check and delimiter."""
    check_bytes = 5 if has_long_check(channels, parts) else 3  # of seven bits each
    return encoded_bytes(channels, to_device, parts) + check_bytes + 1


BITS_PER_BYTE = 10  # start, eight, stop
HOST_WORK_S = 5e-5
"""Time from a position's last byte to a force's first, on a host that is not held up, s."""

_ROUNDING = 1.0 + 1e-12  # an exchange that lasts as long as a sample ends too late


@dataclass(frozen=True)
class WireTime:
    """One exchange, and the share of the wire in it."""

    bytes_to_host: int
    bytes_to_device: int
    seconds: float
    """Duration of both frames on the wire."""
    period: float
    """s, the sample period."""
    baud: int | None
    """Bit/s; None where bytes take no time."""
    turnaround_s: float
    """The device's: from its sample to the position's first byte, and from the force's last byte until it counts."""
    host_work_s: float

    @property
    def exchange_s(self) -> float:
        """Time from a sample until the force that answers it counts for the device's next tick."""
        return self.turnaround_s + self.seconds + self.host_work_s

    @property
    def is_saturated(self) -> bool:
        """True if the frames of one direction take longer than a sample and so queue up without end."""
        longest = max(self.bytes_to_host, self.bytes_to_device) / (self.bytes_to_host + self.bytes_to_device)
        return longest * self.seconds > self.period * _ROUNDING

    @property
    def delay_samples(self) -> int | None:
        """Samples from a position to the tick at which its force begins to act, at least 1; None if saturated."""
        return None if self.is_saturated else 1 + math.floor(self.exchange_s / self.period * _ROUNDING)

    @property
    def fits(self) -> bool:
        """True if every force is in time for the tick after its position."""
        return self.delay_samples == 1

    @property
    def highest_rate_hz(self) -> float:
        """The rate below which an exchange takes less than a sample; infinity where it takes no time."""
        return 1.0 / self.exchange_s if self.exchange_s > 0.0 else math.inf

    @property
    def least_baud(self) -> float | None:
        """The speed above which an exchange takes less than a sample at this rate; None where no speed is enough."""
        left = self.period - self.turnaround_s - self.host_work_s
        return (self.bytes_to_host + self.bytes_to_device) * BITS_PER_BYTE / left if left > 0.0 else None


def wire_time(
    channels: int, parts: int, rate: float, baud: int | None, turnaround_s: float, host_work_s: float = HOST_WORK_S
) -> WireTime:
    """Returns the times of an armed device at `rate` Hz, with these `parts` (ARM's bits)."""
    to_host = frame_bytes(channels, to_device=False, parts=parts)
    to_device = frame_bytes(channels, to_device=True, parts=parts)
    seconds = 0.0 if baud is None else (to_host + to_device) * BITS_PER_BYTE / baud
    return WireTime(to_host, to_device, seconds, 1.0 / rate, baud, turnaround_s, host_work_s)
