"""A connection to a device, and the run's conversation with it: describe, arm, disarm, and why a device stopped.

The conversation before and after the loop and the loop itself share one inbox, so no byte is lost between them. Here
plain Python reads it, by the functions that the loop is compiled from.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import client, schema
from firmware_protocol.client import Client, Received, disarm_in_every_format
from firmware_protocol.compiled import new_record
from firmware_protocol.decoder import next_frame, use_format
from firmware_protocol.description import Description, from_registers, registers_of_a_description
from firmware_protocol.frames import SETUP, Format, framing_of
from hapsim.errors import DescriptionError, DeviceError
from hapsim.loop.buffers import AT_ONCE, INBOX, fetch_in_python
from hapsim.loop.endings import FAILED, HUNG_UP
from hapsim.loop.transport import PythonTransport
from hapsim.stopping import is_urgent

_KEPT_FRAMES = 128  # frames of the conversation, for a report


def _new_inbox() -> Any:
    inbox = new_record(INBOX)
    inbox.decoder.framing = framing_of(SETUP, to_device=False)
    return inbox


@dataclass
class Connection(Client):
    """An open connection, which reads one format at a time. `name`: the port, as the user gave it."""

    transport: PythonTransport
    name: str
    close: Callable[[], None]
    baud: int | None = None
    """Speed of the port, bit/s; None if it has none."""
    note: str = ""
    """Note for the user about a setting that failed when the port was opened."""
    round_trip_s: float = 0.0
    """Shortest time from request to answer during the description, s; 0 before."""
    behind_port: bool = False
    """True if the device may have a timer and a hand of its own. A mock in this process has no hand, and is only as
    punctual as this machine."""
    known_motors: tuple[int, ...] = ()
    """Channels whose motor a test has shown to push the right way."""
    mock: Any = None
    """MOCK of this process; None for any other device."""
    advice: str = ""
    """Question about a device that does not answer or is gone; "": those about a serial port."""
    inbox: Any = field(default_factory=_new_inbox)
    """INBOX of received bytes."""
    _format: Format = SETUP
    _written: deque[bytes] = field(default_factory=lambda: deque(maxlen=_KEPT_FRAMES))
    _buffer: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(AT_ONCE, np.uint8))

    @property
    def decoder(self) -> Any:
        """Decoder, with the fields of the last frame and the counts of rejected frames."""
        return self.inbox.decoder

    def use_format(self, wire: Format) -> None:
        """Expects frames of this format from the next byte on."""
        self._format = wire
        use_format(self.decoder, wire)

    def send(self, frame: bytes) -> None:
        """Sends a frame outside the loop. Raises DeviceError if the port does not take it."""
        self._written.append(frame)
        if self.transport.send(frame) != 0:
            raise DeviceError(f"{self.name}: the port does not accept data: is the device still connected?")

    def take_written(self) -> bytes:
        """Returns the bytes that `send` sent since the last call, at most 128 frames."""
        written = b"".join(self._written)
        self._written.clear()
        return written

    def receive(self, timeout_s: float) -> list[Received]:
        """Returns the next frame of the expected format within `timeout_s`, else an empty list. Bytes behind the frame
        are not decoded, since they may be the loop's. Raises DeviceError if the port is gone."""
        inbox, decoder = self.inbox, self.decoder
        give_up = self.clock.monotonic() + timeout_s
        while True:
            inbox.start, found = next_frame(decoder, inbox.bytes, int(inbox.start), int(inbox.stop))
            now = self.clock.monotonic()
            if found:
                counts = tuple(decoder.counts[: decoder.framing.words].tolist())
                return [Received(int(decoder.type), int(decoder.number), counts, self._format, now)]
            if self._checked_count(fetch_in_python(inbox, self.transport, round(max(give_up - now, 0.0) * 1e9))) == 0:
                return []

    def receive_bytes(self, timeout_s: float) -> bytes:
        """Returns the next raw bytes, without the inbox; b"" after the timeout. Raises DeviceError if it hung up."""
        count = self._checked_count(self.transport.receive(self._buffer, round(timeout_s * 1e9)))
        return self._buffer[:count].tobytes()

    def _checked_count(self, count: int) -> int:
        """Returns the count of received bytes; raises DeviceError for a code of hapsim.loop.endings."""
        if count == HUNG_UP:
            asked = f": {self.advice}" if self.advice else ""
            raise DeviceError(f"{self.name}: the device is gone (the port hung up){asked}")
        if count == FAILED:
            raise DeviceError(f"{self.name}: the port cannot be read any more: the system refuses it")
        return count


def describe(connection: Connection) -> Description:
    """Returns the device's description. Raises DeviceError if nothing answers, or DescriptionError for an unknown
    protocol version, schema or count of channels."""
    registers = np.zeros(schema.REGISTERS, np.int64)
    # A device that stays quiet may still be armed, by a host that died.
    registers[schema.REG_VERSION] = read_register(
        connection, schema.REG_VERSION, client.FIRST_TRIES, disarm_in_every_format()
    )
    for number in (schema.REG_SCHEMA, schema.REG_CHANNELS, schema.REG_SENSORS):
        registers[number] = read_register(connection, number)
    _require_same_protocol(connection, registers)
    round_trips = []
    for number in registers_of_a_description(*registers[[schema.REG_CHANNELS, schema.REG_SENSORS]].tolist()):
        asked = connection.clock.monotonic()
        registers[number] = read_register(connection, number)
        round_trips.append(connection.clock.monotonic() - asked)
    connection.round_trip_s = min(round_trips)
    return from_registers(registers)


def read_register(connection: Connection, number: int, tries: int = client.TRIES, after_quiet: bytes = b"") -> int:
    """Returns a register of an unarmed device, as an unsigned 32-bit value. `tries`, `after_quiet`: of `Client.ask`.
    Raises DeviceError if nothing answers."""
    word = connection.register(number, tries, after_quiet)
    if word is not None:
        return word
    waited = f"within {tries * client.ANSWER_S:.2g} s{_rejected_frames(connection)}"
    if number == schema.REG_VERSION:
        at_baud = f" at {connection.baud} baud" if connection.baud else ""
        asked = connection.advice or (
            f"is this the device's port, is the device powered, does its firmware speak hapsim's protocol{at_baud}, "
            "and is no other program using it?"
        )
        raise DeviceError(f"{connection.name}: no answer {waited}. {asked[0].upper()}{asked[1:]}")
    raise DeviceError(
        f"{connection.name}: the device reported its version (register {schema.REG_VERSION}), but not register "
        f"{number} {waited}: its firmware has to answer every DESCRIBE (PROTOCOL.md, section 5)"
    )


def _require_same_protocol(connection: Connection, registers: Any) -> None:
    version, schema_hash, channels = (
        int(registers[i]) for i in (schema.REG_VERSION, schema.REG_SCHEMA, schema.REG_CHANNELS)
    )
    error = ""
    if version != schema.VERSION:
        side = "a newer hapsim" if version > schema.VERSION else "a newer firmware"
        error = (
            f"the device uses version {version} of the protocol, this hapsim version {schema.VERSION}: install {side}"
        )
    elif schema_hash != schema.SCHEMA_HASH:
        error = (
            f"the device's schema is {schema_hash:08x}, this hapsim's is {schema.SCHEMA_HASH:08x}: "
            "build the firmware from the protocol description of this hapsim"
        )
    elif not 1 <= channels <= schema.MAX_CHANNELS:
        error = f"the device declares {channels} channels, expected 1 to {schema.MAX_CHANNELS}"
    if error:
        raise DescriptionError(f"{connection.name}: {error}")


def arm(connection: Connection, description: Description, pacing: int, watchdog_samples: int, parts: int = 0) -> Format:
    """Arms the device. Returns the format of its positions and of the `parts` (schema.PARTS) that it sends with them.

    Resets the counts of rejected frames. Raises DeviceError if the device refuses or does not answer.
    """
    answer, received = connection.arm(description, pacing, watchdog_samples, parts=parts, fits=_is_arming_answer)
    if answer is None:
        raise DeviceError(f"{connection.name}: {_arming_problem(received)}{_rejected_frames(connection)}")
    if answer.state != schema.ARMED:
        raise DeviceError(f"{connection.name}: the device does not arm: {fault_text(answer.fault)}")
    connection.use_format(connection.armed)
    for counter in ("crc_errors", "length_errors", "form_errors", "garbage_bytes"):
        connection.decoder[counter] = 0
    return connection.armed


def _is_arming_answer(status: Received) -> bool:
    """Returns whether a STATUS answers ARM: armed, or the reason against it. Others are late answers or old faults."""
    old = (schema.NO_FAULT, schema.HOST_QUIET, schema.POSITION_OUT_OF_RANGE)
    return status.number == 0 and (status.state == schema.ARMED or status.fault not in old)


def _arming_problem(received: list[Received]) -> str:
    answer = "it did not answer ARM"
    if received and received[-1].kind == schema.STATUS:
        answer = f"it answered ARM with state {received[-1].state} and fault {received[-1].fault}"
    return (
        f"the device described itself, but {answer} within {client.TRIES * client.ANSWER_S:.2g} s: its firmware has to "
        "answer with a STATUS that says armed (state 1) or why not (PROTOCOL.md, sections 4 and 7)"
    )


def _rejected_frames(connection: Connection) -> str:
    """Returns a phrase about rejected frames, to follow a sentence; "" if there were none."""
    decoder = connection.decoder
    frames = int(decoder.crc_errors + decoder.length_errors + decoder.form_errors)
    rejected = f"{frames} frames were rejected, and {int(decoder.garbage_bytes)} bytes belonged to none"
    return f" ({rejected}: another baud rate, or a disturbed cable?)" if frames or decoder.garbage_bytes else ""


def disarm(connection: Connection, wire: Format) -> bool:
    """Makes the device release: zero force, at once. Returns whether a STATUS idle or latched confirmed it.

    A dead port is no error here. It first waits for the answer to the loop's DISARM. A device that has released by a
    fault or its watchdog reads the set-up format, else its own. After a second stop signal it waits for nothing.
    """
    connection.use_format(SETUP)
    connection.armed = wire
    released = (schema.IDLE, schema.LATCHED)

    def patience_s() -> float:
        return 0.0 if is_urgent() else client.RELEASE_S

    try:
        status, _ = connection.wait_for(lambda one: one.kind == schema.STATUS and one.state in released, patience_s())
        return (status or connection.release(4, released, patience_s)) is not None
    except DeviceError:
        return False


def frames_rejected_by(connection: Connection) -> int | None:
    """Returns the count of host frames that an unarmed device rejected since arming; None without an answer."""
    try:
        return connection.register(schema.REG_REJECTED, tries=2)
    except DeviceError:
        return None


def has_restarted(connection: Connection) -> bool:
    """Returns whether an unarmed device that took forces has powered up since: its count of forces is 0."""
    return read_register(connection, schema.REG_ACCEPTED) == 0


def fault_text(fault: int) -> str:
    """Returns a phrase for a device's fault."""
    return schema.FAULTS.get(fault, f"fault {fault}, which version {schema.VERSION} of the protocol does not name")
