"""The first step: does anything answer, to what it ought to, and to nothing else."""

from __future__ import annotations

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, frame_to_device
from hapsim.bringup.probe.probing import Probing
from hapsim.bringup.probe.wire import ANSWER_S, SET_UP, Heard, Wire, told
from hapsim.device.conversation import disarm_in_every_format

_TRIES = 12  # together three seconds: a board that the opening of its port resets needs them
_QUIET_S = 0.2
_NOISE = bytes(1 + (7 * i) % 255 for i in range(300))
_UNKNOWN_TYPES = (0x0, *range(0x5, 0x10))
_NO_REGISTERS = (13, 14, 15, 20, 31, schema.REGISTERS, 1000, 4095)
_FLIPS = (
    (0, 0x01, "the COBS code"),
    (1, 0x40, "the type"),
    (2, 0x02, "the number"),
    (6, 0x20, "the payload"),
    (8, 0x01, "the check"),
    (9, 0x80, "a bit of the check's bytes that is always set"),
    (10, 0x40, "a bit of the check's last byte that is always clear"),
)


def probe_conversation(probing: Probing) -> bool:
    """Whether there is somebody to talk to."""
    if not _answers(probing):
        return False
    _describes(probing)
    _is_silent(probing)
    _ignores_damage(probing)
    _finds_back(probing)
    _ignores_unknown_types(probing)
    _reads_zero(probing)
    return True


def _answers(probing: Probing) -> bool:
    wire, findings = probing.wire, probing.findings
    begun, echoed = wire.clock.now(), False
    for attempt in range(_TRIES):
        if attempt == 2:
            wire.send(disarm_in_every_format())  # it may still be armed, by a host that died
        frame = wire.frame(schema.DESCRIBE, schema.REG_VERSION)
        seen = len(wire.damaged)
        wire.send(frame)
        answer, _ = wire.wait_for(lambda one: one.kind == schema.DESCRIPTION, ANSWER_S)
        echoed = echoed or frame[:-1] in wire.damaged[seen:]
        if answer is not None:
            beside = f"; before it {len(wire.damaged)} pieces that are no frame" if wire.damaged else ""
            findings.passed(
                "answers", f"{told(answer)}, {1e3 * (answer.at_s - begun):.3g} ms after the port opened{beside}"
            )
            return True
    findings.failed("answers", *_why_nothing(wire, echoed))
    return False


def _why_nothing(wire: Wire, echoed: bool) -> tuple[str, str]:
    if echoed:
        return "what is written comes back, and nothing else", "an echo: a port that is not raw, or TX wired to RX"
    if wire.received:
        return (
            f"{wire.received} bytes, {len(wire.damaged)} pieces between zero bytes, none of them a frame",
            "baud rate, 8 bits, no parity; the start value 0x4853 of the set-up format; the order of the check's bytes",
        )
    return (
        "not one byte",
        "is this the device's port, is it powered, does its main loop hand every received byte to the decoder, and is "
        "DESCRIBE answered before anything is armed?",
    )


def _describes(probing: Probing) -> None:
    for number in (schema.REG_VERSION, schema.REG_SCHEMA, schema.REG_CHANNELS):
        answer, _ = probing.wire.ask(
            probing.wire.frame(schema.DESCRIBE, number), lambda one: one.kind == schema.DESCRIPTION
        )
        kept = answer is not None and answer.number == number and answer.wire == SET_UP
        if not kept:
            found = f"register {number} was asked for, the answer: {told(answer)}"
            probing.findings.failed("describe", found, "the number of a DESCRIPTION: it is that of the DESCRIBE")
            return
    probing.findings.passed("describe", "registers 0, 1 and 2, each by its number")


def _is_silent(probing: Probing) -> None:
    wire = probing.wire
    before, pieces = wire.received, len(wire.damaged)
    heard = wire.hear_for(_QUIET_S)
    count = wire.received - before
    found = f"{count} bytes in {_QUIET_S:g} s"
    if heard:
        found += f", the first: {told(heard[0])}"
    elif count:
        found += f", such as {b' '.join(wire.damaged[pieces:])[:24]!r}" if wire.damaged[pieces:] else ", no frame"
    look_at = "whatever prints on this port: debug text, a boot loader; an idle device that goes on sending"
    probing.findings.judge("silence", count == 0, found, look_at)


def _only_the_second(wire: Wire, first: bytes) -> tuple[bool, Heard | None]:
    """Sends something that is not to be answered and a question behind it: whether that one was answered, and what came
    beside its answer, if anything did. Answers come in the order of the questions."""
    question = wire.frame(schema.DESCRIBE, schema.REG_VERSION)
    for again in range(3):
        wire.send(question if again else first + question)
        answer, heard = wire.wait_for(_is_version, ANSWER_S)
        others = [one for one in heard if not _is_version(one)]
        if answer is not None or others:
            return answer is not None, others[0] if others else None
    return False, None


def _is_version(one: Heard) -> bool:
    return one.kind == schema.DESCRIPTION and one.number == schema.REG_VERSION


def _ignores_damage(probing: Probing) -> None:
    sound = probing.wire.frame(schema.DESCRIBE, schema.REG_SCHEMA)
    for at, bit, what in _FLIPS:
        damaged = bytearray(sound)
        damaged[at] ^= bit
        answered, other = _only_the_second(probing.wire, bytes(damaged))
        if other is not None:
            found = f"a bit flipped in {what}, and the device answers: {told(other)}"
            look_at = "compare every byte of the check, its constant bits too, over the encoded bytes"
            probing.findings.failed("damaged_frames", found, look_at)
            return
        if not answered:
            found = f"after a bit flipped in {what} the next whole frame is not answered"
            probing.findings.failed("damaged_frames", found, "what the receiver forgets, and keeps, at a zero byte")
            return
    probing.findings.passed("damaged_frames", f"{len(_FLIPS)} frames with a flipped bit, none answered")


def _finds_back(probing: Probing) -> None:
    wire = probing.wire
    question = wire.frame(schema.DESCRIBE, schema.REG_VERSION)
    tried = {
        "300 bytes of noise directly in front of a frame": [_NOISE + question],
        "three zero bytes in front of a frame": [b"\0\0\0" + question],
        "half a frame and a zero byte in front of a whole one": [question[:6] + b"\0" + question],
        "a frame a byte at a time": [question[i : i + 1] for i in range(len(question))],
    }
    for what, pieces in tried.items():
        for piece in pieces:
            wire.send(piece)
        answer, _ = wire.wait_for(_is_version, 2 * ANSWER_S)
        if answer is None:
            look_at = (
                "the reading rule: the last L bytes before a zero byte are the candidate, and no time-out takes part"
            )
            probing.findings.failed("finding_back", f"{what}: the whole frame is not answered", look_at)
            return
    probing.findings.passed("finding_back", "; ".join(tried))


def _ignores_unknown_types(probing: Probing) -> None:
    for kind in (*_UNKNOWN_TYPES, schema.FORCE):
        answered, other = _only_the_second(probing.wire, frame_to_device(SETUP, kind, schema.REG_SCHEMA, 0, [0]))
        if other is not None or not answered:
            came = told(other) if other is not None else "the next frame is not answered"
            name = "FORCE while not armed" if kind == schema.FORCE else f"type 0x{kind:x}"
            look_at = "what the device does with types other than DESCRIBE, ARM and DISARM while not armed: nothing"
            probing.findings.failed("unknown_types", f"{name}: {came}", look_at)
            return
    probing.findings.passed("unknown_types", f"{len(_UNKNOWN_TYPES)} unknown types and FORCE, none answered")


def _reads_zero(probing: Probing) -> None:
    for number in _NO_REGISTERS:
        value = probing.wire.register(number)
        if value != 0:
            found = f"register {number}: {'no answer' if value is None else f'reads 0x{value:x}'}"
            look_at = "the bounds of the register table: every number from 0 to 4095 is answered"
            probing.findings.failed("unknown_registers", found, look_at)
            return
    probing.findings.passed("unknown_registers", ", ".join(map(str, _NO_REGISTERS)))
