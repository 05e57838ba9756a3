"""The conversation of host and device outside the loop: describe, arm, disarm, and the reason why a device stopped."""

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

_ANSWER_S = 0.25  # the wait for one answer
_TRIES = 12  # three seconds: a board that the opening of its port resets needs them
_TRIES_TO_ASK = 4  # of a device that has answered before
_FAREWELL_S, _FAREWELLS = 0.1, 4  # the wait for a device's release, and the repetitions of DISARM


def describe(connection: Connection) -> Description:
    """Returns the device's description of itself. DeviceError where nothing answers, or not in version 1."""
    registers = np.zeros(schema.REGISTERS, np.int64)
    # A device that stays quiet may still be armed, by a host that died.
    registers[schema.REG_VERSION] = _ask(connection, schema.REG_VERSION, _TRIES, disarm_in_every_format)
    registers[schema.REG_SCHEMA] = read_register(connection, schema.REG_SCHEMA)
    registers[schema.REG_CHANNELS] = read_register(connection, schema.REG_CHANNELS)
    _require_same_language(connection, registers)
    round_trips = []
    for number in registers_of_a_description(int(registers[schema.REG_CHANNELS])):
        asked = time.monotonic()
        registers[number] = read_register(connection, number)
        round_trips.append(time.monotonic() - asked)
    connection.round_trip_s = min(round_trips)
    return from_registers(registers)


def read_register(connection: Connection, number: int) -> int:
    """Returns a register of a device that is not armed, as an unsigned 32-bit value."""
    return _ask(connection, number)


def arm(
    connection: Connection, description: Description, pacing: int, watchdog_samples: int, velocity: bool = False
) -> Format:
    """Arms the device. Returns the format in which it then sends positions, with `velocity` also velocities.

    DeviceError where it refuses, or answers everything but this. The counts of rejected frames begin anew.
    """
    wire = armed_format(description.channels, velocity)
    argument = pacing | (schema.WITH_VELOCITY if velocity else 0)
    schema_word = np.array([schema.SCHEMA_HASH], np.uint32).view(np.int32)
    frame = frame_to_device(SETUP, schema.ARM, watchdog_samples, argument, schema_word.astype(np.int64))
    connection.decoder.type = 0
    answer = _exchange(connection, frame, schema.STATUS, 0, fits=_answers_arming)
    if answer is None:
        raise DeviceError(f"{connection.name}: {_never_armed(connection.decoder)}{_refused(connection)}")
    if answer & 0xFF != schema.ARMED:
        raise DeviceError(f"{connection.name}: the device does not arm: {fault_text(answer >> 8 & 0xFF)}")
    connection.use_format(wire)
    for counter in ("crc_errors", "length_errors", "form_errors", "garbage_bytes"):
        connection.decoder[counter] = 0
    return wire


def _answers_arming(word: int) -> bool:
    """Whether a STATUS says armed or why not; else it is a late answer to something before, perhaps an old fault."""
    old = (schema.NO_FAULT, schema.HOST_QUIET, schema.POSITION_OUT_OF_RANGE)
    return word & 0xFF == schema.ARMED or word >> 8 & 0xFF not in old


def _never_armed(decoder: Any) -> str:
    said = "it did not answer ARM"
    if decoder.type == schema.STATUS:
        word = int(decoder.counts[0])
        said = f"it answered ARM with state {word & 0xFF} and fault {word >> 8 & 0xFF}"
    return (
        f"the device described itself, but {said} within {_TRIES_TO_ASK * _ANSWER_S:.2g} s: its firmware has to answer "
        "with a STATUS that says armed (state 1) or why not (PROTOCOL.md, sections 4 and 7)"
    )


def _refused(connection: Connection) -> str:
    """The rejected frames, in words that follow a sentence; "" where there were none."""
    decoder = connection.decoder
    frames = int(decoder.crc_errors + decoder.length_errors + decoder.form_errors)
    rejected = f"{frames} frames were rejected, and {int(decoder.garbage_bytes)} bytes belonged to none"
    return f" ({rejected}: another baud rate, or a disturbed cable?)" if frames or decoder.garbage_bytes else ""


def disarm(connection: Connection, wire: Format) -> bool:
    """Makes the device release: zero force, at once. Returns whether a STATUS idle or latched confirmed it.

    A dead port is no error here. It listens first: the loop has already sent DISARM. A device that has released (a
    fault, its watchdog) listens to the set-up format, else to its own. After a second stop signal nothing is awaited.
    """
    connection.use_format(SETUP)
    released = (schema.IDLE, schema.LATCHED)
    try:
        for frame in [b"", *[_disarm_frame(wire), _disarm_frame(SETUP)] * _FAREWELLS]:
            if frame:
                _send(connection, frame)
            patience_s = 0.0 if is_urgent() else _FAREWELL_S
            if _answer(connection, schema.STATUS, None, patience_s, lambda word: word & 0xFF in released) is not None:
                return True
    except DeviceError:
        pass
    return False


def _disarm_frame(wire: Format) -> bytes:
    return frame_to_device(wire, schema.DISARM, 0, 0, [0] * wire.channels)


def frames_rejected_by(connection: Connection) -> int | None:
    """Returns the number of the host's frames that an unarmed device rejected since it was armed; None without an
    answer."""
    try:
        frame = _describe_frame(schema.REG_REJECTED)
        return _exchange(connection, frame, schema.DESCRIPTION, schema.REG_REJECTED, tries=2)
    except DeviceError:
        return None


def has_restarted(connection: Connection) -> bool:
    """Returns whether an unarmed device that took forces before has powered up since: then it counts none."""
    return read_register(connection, schema.REG_ACCEPTED) == 0


def disarm_in_every_format() -> bytes:
    """Returns the frames that release a device armed by another host, with any number of channels."""
    every = range(1, schema.MAX_CHANNELS + 1)
    return b"".join(_disarm_frame(armed_format(n, velocity)) for n in every for velocity in (False, True))


def fault_text(fault: int) -> str:
    """Returns a device's fault in words."""
    return schema.FAULTS.get(fault, f"fault {fault}, which version {schema.VERSION} of the protocol does not name")


def _require_same_language(connection: Connection, registers: Any) -> None:
    version, schema_hash, channels = (
        int(registers[i]) for i in (schema.REG_VERSION, schema.REG_SCHEMA, schema.REG_CHANNELS)
    )
    error = ""
    if version != schema.VERSION:
        side = "a newer hapsim" if version > schema.VERSION else "a newer firmware"
        error = (
            f"the device speaks version {version} of the protocol, this hapsim speaks version {schema.VERSION}: "
            f"it takes {side}"
        )
    elif schema_hash != schema.SCHEMA_HASH:
        error = (
            f"the device's schema is {schema_hash:08x}, this hapsim's is {schema.SCHEMA_HASH:08x}: "
            "build the firmware from the protocol description of this hapsim"
        )
    elif not 1 <= channels <= schema.MAX_CHANNELS:
        error = f"the device says it has {channels} channels, where 1 to {schema.MAX_CHANNELS} can be"
    if error:
        raise DescriptionError(f"{connection.name}: {error}")


def _describe_frame(register: int) -> bytes:
    return frame_to_device(SETUP, schema.DESCRIBE, register, 0, [0])


def _ask(
    connection: Connection, register: int, tries: int = _TRIES_TO_ASK, when_quiet: Callable[[], bytes] = bytes
) -> int:
    word = _exchange(connection, _describe_frame(register), schema.DESCRIPTION, register, tries, when_quiet)
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
        f"{connection.name}: the device reported its version (register {schema.REG_VERSION}), but not register "
        f"{register} {waited}: its firmware has to answer every DESCRIBE (PROTOCOL.md, section 5)"
    )


def _exchange(
    connection: Connection,
    frame: bytes,
    kind: int,
    number: int,
    tries: int = _TRIES_TO_ASK,
    when_quiet: Callable[[], bytes] = bytes,
    fits: Callable[[int], bool] = lambda _word: True,
) -> int | None:
    """Sends a frame until an answer `fits`, and what `when_quiet` returns before the third time. Returns the answer's
    word, or None."""
    for attempt in range(tries):
        if attempt == 2 and (release := when_quiet()):
            _send(connection, release)
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
    connection: Connection, kind: int, number: int | None, timeout_s: float, fits: Callable[[int], bool]
) -> int | None:
    """Waits for a frame of this kind and number (None: any) whose first word `fits`. Returns the word, or None."""
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
