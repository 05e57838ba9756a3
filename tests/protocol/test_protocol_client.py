"""A host outside of a loop: what it sends, how long it waits, and what it takes for an answer."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from firmware_protocol import schema
from firmware_protocol.client import ANSWER_S, RELEASE_S, Client, Received, disarm_in_every_format
from firmware_protocol.decoder import Frame, frames_in, new_decoder
from firmware_protocol.description import Description
from firmware_protocol.frames import SETUP, Format, armed_format

THREE = Description("three", 1000.0, 0b1, 200, (1e-6,) * 3, (1e-3,) * 3, (10.0,) * 3)


class VirtualTime:
    """A clock that a wait moves on."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def monotonic(self) -> float:
        return self.seconds


class Scripted(Client):
    """A host whose device answers by a function of the frame, in a time that passes where the host waits."""

    def __init__(self, answer: Callable[[bytes], list[Received]] = lambda _: []) -> None:
        self.clock = VirtualTime()
        self.sent: list[bytes] = []
        self.waiting: list[Received] = []
        self._answer = answer

    def send(self, frame: bytes) -> None:
        self.sent.append(frame)
        self.waiting += self._answer(frame)

    def receive(self, timeout_s: float) -> list[Received]:
        new, self.waiting = self.waiting, []
        if not new:
            self.clock.seconds += timeout_s
        return new


def received(kind: int, number: int = 0, word: int = 0, wire: Format = SETUP) -> Received:
    return Received(kind, number, (word,), wire, 0.0)


def read(frame: bytes, wire: Format = SETUP) -> list[Frame]:
    return frames_in(new_decoder(wire, to_device=True), frame)


def test_a_question_is_asked_again_until_its_own_answer_comes() -> None:
    def answer(_: bytes) -> list[Received]:
        other = received(schema.DESCRIPTION, 7, 1), received(schema.STATUS, 2)
        return [*other, received(schema.DESCRIPTION, 2, -1)] if len(host.sent) == 3 else [*other]

    host = Scripted(answer)
    found, every = host.ask(host.frame(schema.DESCRIBE, 2), schema.DESCRIPTION, 2)
    assert found is not None
    assert found.word == 0xFFFFFFFF
    assert (len(host.sent), len(every)) == (3, 7)
    assert host.clock.seconds == pytest.approx(2 * ANSWER_S)


def test_a_device_that_stays_quiet_is_released_before_the_third_question() -> None:
    host = Scripted()
    assert host.register(schema.REG_VERSION, tries=5, after_quiet=disarm_in_every_format()) is None
    question = host.frame(schema.DESCRIBE, schema.REG_VERSION)
    assert host.sent == [question, question, disarm_in_every_format(), question, question, question]
    assert host.clock.seconds == pytest.approx(5 * ANSWER_S)


def test_what_came_with_an_answer_is_returned_with_it() -> None:
    host = Scripted()
    host.waiting = [received(schema.STATUS), received(schema.POSITION, 0), received(schema.POSITION, 1)]
    status, every = host.wait_for(lambda one: one.kind == schema.STATUS, 1.0)
    assert (status, len(every)) == (every[0], 3)
    assert host.receive_for(0.5) == []
    assert host.clock.seconds == 0.5


def test_arming_asks_in_the_set_up_format_and_expects_that_of_the_channels() -> None:
    host = Scripted(lambda _: [received(schema.STATUS, 0, schema.ARMED)])
    status, _ = host.arm(THREE, schema.PACED_BY_HOST, 100, parts=schema.PART_BITS)
    assert status is not None
    assert (status.state, status.fault, host.armed) == (
        schema.ARMED,
        schema.NO_FAULT,
        armed_format(3, schema.PART_BITS),
    )
    (frame,) = read(host.sent[0])
    assert (frame.type, frame.number, frame.argument) == (schema.ARM, 100, schema.PACED_BY_HOST | schema.PART_BITS)
    assert frame.counts[0] & 0xFFFFFFFF == schema.SCHEMA_HASH


def test_a_release_is_sent_in_both_formats_until_the_device_reports_that_it_is_idle() -> None:
    def answer(_: bytes) -> list[Received]:
        return [received(schema.STATUS, 0, schema.IDLE if len(host.sent) == 4 else schema.LATCHED)]

    host = Scripted(answer)
    host.armed = armed_format(3)
    status = host.release()
    assert status is not None
    assert status.state == schema.IDLE
    formats = [SETUP if read(frame) else armed_format(3) for frame in host.sent]
    assert formats == [armed_format(3), SETUP] * 2
    assert all(read(frame, wire)[0].type == schema.DISARM for frame, wire in zip(host.sent, formats, strict=True))
    quiet = Scripted()
    assert quiet.release() is None
    assert quiet.clock.seconds == pytest.approx(6 * RELEASE_S)


def test_only_the_number_of_a_sample_begins_anew() -> None:
    host = Scripted()
    assert host.frame(schema.FORCE, schema.SAMPLE_MODULUS + 5) == host.frame(schema.FORCE, 5)
    with pytest.raises(ValueError, match="number 4096: a frame carries 12 bits of it"):
        host.arm_frame(schema.PACED_BY_DEVICE, schema.SAMPLE_MODULUS)
