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
from hapsim.errors import DeviceError
from hapsim.loop.codes import FAILED, HUNG_UP

_ANSWER_S = 0.25  # how long one answer is waited for
_TRIES = 12  # together three seconds: a board that the opening of its port resets needs them


def describe(connection: Connection) -> Description:
    """Asks the device what it is. DeviceError where nothing answers, or something that does not speak version 1."""
    registers = np.zeros(schema.REGISTERS, np.int64)
    registers[schema.REG_VERSION] = _first_answer(connection)
    registers[schema.REG_SCHEMA] = _ask(connection, schema.REG_SCHEMA)
    registers[schema.REG_CHANNELS] = _ask(connection, schema.REG_CHANNELS)
    _require_same_language(connection, registers)
    for number in registers_of_a_description(int(registers[schema.REG_CHANNELS])):
        registers[number] = _ask(connection, number)
    return from_registers(registers)


def read_register(connection: Connection, number: int) -> int:
    """One register of a device that is not armed, as an unsigned 32-bit value."""
    return _ask(connection, number)


def arm(
    connection: Connection, description: Description, pacing: int, watchdog_samples: int, velocity: bool = False
) -> Format:
    """Arms the device, which then sends positions, with their velocities where asked, in the format returned.

    DeviceError where it refuses.
    """
    wire = armed_format(description.channels, velocity)
    argument = pacing | (schema.WITH_VELOCITY if velocity else 0)
    schema_word = np.array([schema.SCHEMA_HASH], np.uint32).astype(np.int32).astype(np.int64)
    frame = frame_to_device(SETUP, schema.ARM, watchdog_samples, argument, schema_word)
    answer = _exchange(connection, frame, schema.STATUS, 0, fits=_answers_arming)
    state, fault = answer & 0xFF, answer >> 8 & 0xFF
    if state != schema.ARMED:
        raise DeviceError(f"{connection.name}: the device does not arm: {fault_text(fault)}")
    connection.use_format(wire)
    return wire


def _answers_arming(word: int) -> bool:
    """A status that says neither armed nor why not is a late answer to something else."""
    refusals = (schema.WRONG_SCHEMA, schema.WRONG_PACING, schema.WRONG_SENSING, schema.WRONG_WATCHDOG, schema.HARDWARE)
    return word & 0xFF == schema.ARMED or word >> 8 & 0xFF in refusals


def disarm(connection: Connection, wire: Format) -> bool:
    """Tells the device to release: zero force, at once. Whether it said that it did; a dead port is no error here."""
    connection.use_format(SETUP)
    frames = [
        frame_to_device(wire, schema.DISARM, 0, 0, np.zeros(wire.channels, np.int64)),
        frame_to_device(SETUP, schema.DISARM, 0, 0, np.zeros(1, np.int64)),
    ]
    # A device that already released (a fault, its watchdog) listens to the set-up format; one that did not, to its own.
    for _ in range(3):
        for frame in frames:
            try:
                _send(connection, frame)
                if _answer(connection, schema.STATUS, None, 0.1) is not None:
                    return True
            except DeviceError:
                return False
    return False


def disarm_in_every_format() -> bytes:
    """What releases a device that somebody else armed, however many channels it has, with velocities or without."""
    every = range(1, schema.MAX_CHANNELS + 1)
    formats = [armed_format(channels, velocity) for channels in every for velocity in (False, True)]
    frames = [frame_to_device(wire, schema.DISARM, 0, 0, np.zeros(wire.channels, np.int64)) for wire in formats]
    return b"".join(frames)


def fault_text(fault: int) -> str:
    """A device's fault in words."""
    return schema.FAULTS.get(fault, f"fault {fault}, which version {schema.VERSION} of the protocol does not name")


def _require_same_language(connection: Connection, registers: Any) -> None:
    version, schema_hash = int(registers[schema.REG_VERSION]), int(registers[schema.REG_SCHEMA])
    if version != schema.VERSION:
        side = "a newer hapsim" if version > schema.VERSION else "a newer firmware"
        raise DeviceError(
            f"{connection.name}: the device speaks version {version} of the protocol, this hapsim speaks version "
            f"{schema.VERSION}: it takes {side}"
        )
    if schema_hash != schema.SCHEMA_HASH:
        raise DeviceError(
            f"{connection.name}: the device's schema is {schema_hash:08x}, this hapsim's is {schema.SCHEMA_HASH:08x}: "
            "build the firmware from the protocol description of the hapsim that is to talk to it"
        )
    channels = int(registers[schema.REG_CHANNELS])
    if not 1 <= channels <= schema.MAX_CHANNELS:
        raise DeviceError(
            f"{connection.name}: the device says it has {channels} channels, where 1 to {schema.MAX_CHANNELS} can be"
        )


def _first_answer(connection: Connection) -> int:
    """The version. Where the device stays quiet it may still be armed, by a host that died: it is disarmed."""
    return _ask(connection, schema.REG_VERSION, _TRIES, disarm_in_every_format())


def _ask(connection: Connection, register: int, tries: int = 4, when_quiet: bytes = b"") -> int:
    frame = frame_to_device(SETUP, schema.DESCRIBE, register, 0, np.zeros(1, np.int64))
    return _exchange(connection, frame, schema.DESCRIPTION, register, tries, when_quiet)


def _exchange(
    connection: Connection,
    frame: bytes,
    kind: int,
    number: int,
    tries: int = 4,
    when_quiet: bytes = b"",
    fits: Callable[[int], bool] = lambda _word: True,
) -> int:
    """Sends a frame until something that `fits` answers, `when_quiet` before the third time; the answer's word."""
    for attempt in range(tries):
        if attempt == 2 and when_quiet:
            _send(connection, when_quiet)
        _send(connection, frame)
        answer = _answer(connection, kind, number, _ANSWER_S, fits)
        if answer is not None:
            return answer
    raise DeviceError(
        f"{connection.name}: no answer within {tries * _ANSWER_S:.2g} s. Is this the device's port, is the device "
        "powered, does its firmware speak hapsim's protocol, and is no other program using it?"
    )


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
    """The first word of the next frame of this kind and number (None: any) that `fits`; None where none comes."""
    deadline = time.monotonic() + timeout_s
    while (left := deadline - time.monotonic()) > 0:
        found, code = connection.next_frame(left)
        if code in (HUNG_UP, FAILED):
            raise DeviceError(f"{connection.name}: the device is gone (the port hung up)")
        if found and connection.decoder.type == kind and number in (None, connection.decoder.number):
            word = int(connection.decoder.counts[0]) & 0xFFFFFFFF
            if fits(word):
                return word
    return None
