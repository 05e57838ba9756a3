"""What host and device say to each other outside the loop: describe, arm, disarm, and why a device stopped."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description, from_registers, registers_of_a_description
from firmware_protocol.frames import SETUP, Format, armed_format, frame_to_device
from hapsim.device.connection import Connection
from hapsim.errors import DescriptionError, DeviceError
from hapsim.loop.endings import FAILED, HUNG_UP
from hapsim.stopping import is_urgent

_ANSWER_S = 0.25  # how long one answer is waited for
_TRIES = 12  # together three seconds: a board that the opening of its port resets needs them
_TRIES_TO_ASK = 4  # of one that has answered before
_FAREWELL_S, _FAREWELLS = 0.1, 4  # how long, and how often, a device is waited for that is to release


def describe(connection: Connection) -> Description:
    """Returns the device's description of itself. DeviceError where nothing answers, or not in version 1."""
    registers = np.zeros(schema.REGISTERS, np.int64)
    # A device that stays quiet may still be armed, by a host that died.
    registers[schema.REG_VERSION] = _ask(connection, schema.REG_VERSION, _TRIES, disarm_in_every_format())
    registers[schema.REG_SCHEMA] = read_register(connection, schema.REG_SCHEMA)
    registers[schema.REG_CHANNELS] = read_register(connection, schema.REG_CHANNELS)
    _require_same_language(connection, registers)
    for number in registers_of_a_description(int(registers[schema.REG_CHANNELS])):
        registers[number] = read_register(connection, number)
    return from_registers(registers)


def read_register(connection: Connection, number: int) -> int:
    """One register of a device that is not armed, as an unsigned 32-bit value."""
    return _ask(connection, number)


def arm(
    connection: Connection, description: Description, pacing: int, watchdog_samples: int, velocity: bool = False
) -> Format:
    """Arms the device, which then sends positions, with their velocities where asked, in the format returned.

    DeviceError where it refuses, and where it answers everything but this. From then on, what is refused on the wire is
    counted anew.
    """
    wire = armed_format(description.channels, velocity)
    argument = pacing | (schema.WITH_VELOCITY if velocity else 0)
    schema_word = np.array([schema.SCHEMA_HASH], np.uint32).astype(np.int32).astype(np.int64)
    frame = frame_to_device(SETUP, schema.ARM, watchdog_samples, argument, schema_word)
    connection.decoder.type = 0
    answer = _exchange(connection, frame, schema.STATUS, 0, fits=_answers_arming)
    if answer is None:
        raise DeviceError(f"{connection.name}: {_never_armed(connection.decoder)}{_refused(connection)}")
    state, fault = answer & 0xFF, answer >> 8 & 0xFF
    if state != schema.ARMED:
        raise DeviceError(f"{connection.name}: the device does not arm: {fault_text(fault)}")
    connection.use_format(wire)
    for counter in ("crc_errors", "length_errors", "form_errors", "garbage_bytes"):
        connection.decoder[counter] = 0
    return wire


def _answers_arming(word: int) -> bool:
    """A status that says neither armed nor why not is a late answer to something else: a fault of before among them."""
    of_before = (schema.NO_FAULT, schema.HOST_QUIET, schema.POSITION_OUT_OF_RANGE)
    return word & 0xFF == schema.ARMED or word >> 8 & 0xFF not in of_before


def _never_armed(decoder: Any) -> str:
    """The error where no STATUS answered ARM, or none that `_answers_arming`."""
    said = "it did not answer ARM"
    if decoder.type == schema.STATUS:
        word = int(decoder.counts[0])
        said = f"it answered ARM with state {word & 0xFF} and fault {word >> 8 & 0xFF}"
    return (
        f"the device described itself, but {said} within {_TRIES_TO_ASK * _ANSWER_S:.2g} s: its firmware has to answer "
        "with a STATUS that says armed (state 1) or why not (PROTOCOL.md, sections 4 and 7)"
    )


def _refused(connection: Connection) -> str:
    """What came and was no frame, in words that follow a sentence; "" where nothing did."""
    decoder = connection.decoder
    frames = int(decoder.crc_errors + decoder.length_errors + decoder.form_errors)
    spoilt = f"{frames} frames were refused, and {int(decoder.garbage_bytes)} bytes belonged to none"
    return f" ({spoilt}: another baud rate, or a disturbed cable?)" if frames or decoder.garbage_bytes else ""


def disarm(connection: Connection, wire: Format) -> bool:
    """Has the device release: zero force, at once. Returns whether it confirmed that with a STATUS idle or latched.

    A dead port is no error here. It listens first: the loop has sent DISARM already. A device that has released (a
    fault, its watchdog) listens to the set-up format, one that has not to its own.
    """
    connection.use_format(SETUP)
    both = [_disarm_frame(wire), _disarm_frame(SETUP)]
    try:
        return any(_is_released(connection, frame) for frame in [b"", *both * _FAREWELLS])
    except DeviceError:
        return False


def _is_released(connection: Connection, frame: bytes) -> bool:
    """Sends a frame, if there is one, and waits for the STATUS of a device that is not armed; not after a second
    stop signal."""
    if frame:
        _send(connection, frame)
    released = (schema.IDLE, schema.LATCHED)
    patience_s = 0.0 if is_urgent() else _FAREWELL_S
    status = _answer(connection, schema.STATUS, None, patience_s, lambda word: word & 0xFF in released)
    return status is not None


def _disarm_frame(wire: Format) -> bytes:
    return frame_to_device(wire, schema.DISARM, 0, 0, np.zeros(wire.channels, np.int64))


def frames_rejected_by(connection: Connection) -> int | None:
    """How many of the host's frames an unarmed device says that it refused since it was armed; None where it does not
    answer."""
    frame = frame_to_device(SETUP, schema.DESCRIBE, schema.REG_REJECTED, 0, np.zeros(1, np.int64))
    try:
        return _exchange(connection, frame, schema.DESCRIPTION, schema.REG_REJECTED, tries=2)
    except DeviceError:
        return None


def has_restarted(connection: Connection) -> bool:
    """Whether an unarmed device that took forces before has powered up since: then it counts none."""
    return read_register(connection, schema.REG_ACCEPTED) == 0


def disarm_in_every_format() -> bytes:
    """What releases a device that another host armed, however many channels it has, with velocities or without."""
    every = range(1, schema.MAX_CHANNELS + 1)
    return b"".join(_disarm_frame(armed_format(n, velocity)) for n in every for velocity in (False, True))


def fault_text(fault: int) -> str:
    """A device's fault in words."""
    return schema.FAULTS.get(fault, f"fault {fault}, which version {schema.VERSION} of the protocol does not name")


def _require_same_language(connection: Connection, registers: Any) -> None:
    version, schema_hash = int(registers[schema.REG_VERSION]), int(registers[schema.REG_SCHEMA])
    if version != schema.VERSION:
        side = "a newer hapsim" if version > schema.VERSION else "a newer firmware"
        raise DescriptionError(
            f"{connection.name}: the device speaks version {version} of the protocol, this hapsim speaks version "
            f"{schema.VERSION}: it takes {side}"
        )
    if schema_hash != schema.SCHEMA_HASH:
        raise DescriptionError(
            f"{connection.name}: the device's schema is {schema_hash:08x}, this hapsim's is {schema.SCHEMA_HASH:08x}: "
            "build the firmware from the protocol description of the hapsim that is to talk to it"
        )
    channels = int(registers[schema.REG_CHANNELS])
    if not 1 <= channels <= schema.MAX_CHANNELS:
        raise DescriptionError(
            f"{connection.name}: the device says it has {channels} channels, where 1 to {schema.MAX_CHANNELS} can be"
        )


def _ask(connection: Connection, register: int, tries: int = _TRIES_TO_ASK, when_quiet: bytes = b"") -> int:
    frame = frame_to_device(SETUP, schema.DESCRIBE, register, 0, np.zeros(1, np.int64))
    word = _exchange(connection, frame, schema.DESCRIPTION, register, tries, when_quiet)
    if word is not None:
        return word
    waited = f"within {tries * _ANSWER_S:.2g} s{_refused(connection)}"
    if register == schema.REG_VERSION:
        at_baud = f" at {connection.baud} baud" if connection.baud else ""
        raise DeviceError(
            f"{connection.name}: no answer {waited}. Is this the device's port, is the device "
            f"powered, does its firmware speak hapsim's protocol{at_baud}, and is no other program using it?"
        )
    raise DeviceError(
        f"{connection.name}: the device told its version (register {schema.REG_VERSION}), but not what register "
        f"{register} holds {waited}: its firmware has to answer every DESCRIBE (PROTOCOL.md, section 5)"
    )


def _exchange(
    connection: Connection,
    frame: bytes,
    kind: int,
    number: int,
    tries: int = _TRIES_TO_ASK,
    when_quiet: bytes = b"",
    fits: Callable[[int], bool] = lambda _word: True,
) -> int | None:
    """Sends a frame until an answer `fits`, and `when_quiet` before the third time. Returns the answer's word, or
    None."""
    for attempt in range(tries):
        if attempt == 2 and when_quiet:
            _send(connection, when_quiet)
        _send(connection, frame)
        answer = _answer(connection, kind, number, _ANSWER_S, fits)
        if answer is not None:
            return answer
    return None


def _send(connection: Connection, frame: bytes) -> None:
    if not connection.write(frame):
        raise DeviceError(
            f"{connection.name}: the port does not take what is written to it: is the device still there?"
        )


def _answer(
    connection: Connection,
    kind: int,
    number: int | None,
    timeout_s: float,
    fits: Callable[[int], bool] = lambda _word: True,
) -> int | None:
    """Returns the first word that `fits` of a frame of this kind and number (None: any); None where none comes."""
    deadline = time.monotonic() + timeout_s
    while (left := deadline - time.monotonic()) > 0:
        found, code = connection.next_frame(left)
        if code == HUNG_UP:
            raise DeviceError(f"{connection.name}: the device is gone (the port hung up)")
        if code == FAILED:
            raise DeviceError(f"{connection.name}: the port cannot be read any more: the system refuses it")
        if found and connection.decoder.type == kind and number in (None, connection.decoder.number):
            word = int(connection.decoder.counts[0]) & 0xFFFFFFFF
            if fits(word):
                return word
    return None
