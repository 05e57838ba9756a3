"""The first three steps, before a device is armed: does it answer, what does it say of itself, what does it refuse."""

from __future__ import annotations

import math

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description, from_registers, registers_of_a_description
from firmware_protocol.frames import SETUP, frame_to_device
from hapsim.bringup.probe.checks import Probing
from hapsim.bringup.probe.wire import ANSWER_S, SET_UP, Heard, Wire, arm_frame, told
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
    wire = probing.wire
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
            probing.passed(
                "answers", f"{told(answer)}, {1e3 * (answer.at_s - begun):.3g} ms after the port opened{beside}"
            )
            return True
    probing.failed("answers", *_why_nothing(wire, echoed))
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
            probing.failed("describe", found, "the number of a DESCRIPTION: it is that of the DESCRIBE")
            return
    probing.passed("describe", "registers 0, 1 and 2, each by its number")


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
    probing.judge("silence", count == 0, found, look_at)


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
            probing.failed("damaged_frames", found, look_at)
            return
        if not answered:
            found = f"after a bit flipped in {what} the next whole frame is not answered"
            probing.failed("damaged_frames", found, "what the receiver forgets, and keeps, at a zero byte")
            return
    probing.passed("damaged_frames", f"{len(_FLIPS)} frames with a flipped bit, none answered")


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
            probing.failed("finding_back", f"{what}: the whole frame is not answered", look_at)
            return
    probing.passed("finding_back", "; ".join(tried))


def _ignores_unknown_types(probing: Probing) -> None:
    for kind in (*_UNKNOWN_TYPES, schema.FORCE):
        answered, other = _only_the_second(probing.wire, frame_to_device(SETUP, kind, schema.REG_SCHEMA, 0, [0]))
        if other is not None or not answered:
            came = told(other) if other is not None else "the next frame is not answered"
            name = "FORCE while not armed" if kind == schema.FORCE else f"type 0x{kind:x}"
            look_at = "what the device does with types other than DESCRIBE, ARM and DISARM while not armed: nothing"
            probing.failed("unknown_types", f"{name}: {came}", look_at)
            return
    probing.passed("unknown_types", f"{len(_UNKNOWN_TYPES)} unknown types and FORCE, none answered")


def _reads_zero(probing: Probing) -> None:
    for number in _NO_REGISTERS:
        value = probing.wire.register(number)
        if value != 0:
            found = f"register {number}: {'no answer' if value is None else f'reads 0x{value:x}'}"
            look_at = "the bounds of the register table: every number from 0 to 4095 is answered"
            probing.failed("unknown_registers", found, look_at)
            return
    probing.passed("unknown_registers", ", ".join(map(str, _NO_REGISTERS)))


_LEAST_HZ, _MOST_HZ = 1e-3, 1e9
"""Beyond these a rate is no haptic device's: the two words of the double are more likely swapped."""


def probe_registers(probing: Probing) -> bool:
    """Whether the device may be armed: it speaks this schema, and says of itself what can be."""
    registers = np.zeros(schema.REGISTERS, np.int64)
    if not (_read(probing, registers, [schema.REG_VERSION, schema.REG_SCHEMA, schema.REG_CHANNELS])):
        return False
    if not (_same_language(probing, registers) and _channels(probing, int(registers[schema.REG_CHANNELS]))):
        return False
    if not _read(probing, registers, registers_of_a_description(int(registers[schema.REG_CHANNELS]))):
        return False
    description = from_registers(registers)
    probing.description = description
    _pacings(probing, description.pacings)
    _name(probing, registers)
    declared = int(registers[schema.REG_MAX_WATCHDOG])
    limits = f"{declared} samples"
    probing.judge("max_watchdog", 1 <= declared <= schema.MAX_WATCHDOG_SAMPLES, limits, "register 6")
    rate = description.rate_hz
    swapped = "registers 4 and 5: the double's low word first"
    probing.judge("rate", _LEAST_HZ <= rate <= _MOST_HZ, f"{rate:g} Hz", swapped)
    _scales(probing, description)
    needed = ("pacings", "max_watchdog", "rate", "position_scale", "force_scale", "force_limit", "velocity_scale")
    return not any(probing.has_failed(name) for name in needed)


def _read(probing: Probing, registers: np.ndarray, numbers: list[int]) -> bool:
    for number in numbers:
        value = probing.wire.register(number)
        if value is None:
            look_at = f"register {number}: DESCRIBE was answered before, and of this one it is not"
            probing.failed(_check_of(number), f"no answer for register {number} within 1 s", look_at)
            return False
        registers[number] = value
    return True


def _check_of(number: int) -> str:
    """The check that a register belongs to."""
    named = {0: "version", 1: "schema", 2: "channels", 3: "pacings", 4: "rate", 5: "rate", 6: "max_watchdog"}
    if number >= schema.REG_CHANNEL:
        per_channel = ("position_scale", "force_scale", "force_limit", "velocity_scale")
        return per_channel[(number - schema.REG_CHANNEL) % schema.CHANNEL_WORDS // 2]
    return named.get(number, "name")


def _same_language(probing: Probing, registers: np.ndarray) -> bool:
    version, word = int(registers[schema.REG_VERSION]), int(registers[schema.REG_SCHEMA])
    same = probing.judge(
        "version", version == schema.VERSION, f"{version}", "which PROTOCOL.md the firmware was written from"
    )
    look_at = f"build the firmware with the header of this hapsim, whose schema hash is 0x{schema.SCHEMA_HASH:08x}"
    return probing.judge("schema", word == schema.SCHEMA_HASH, f"0x{word:08x}", look_at) and same


def _channels(probing: Probing, channels: int) -> bool:
    kept = 1 <= channels <= schema.MAX_CHANNELS
    if probing.judge("channels", kept, f"{channels}", "register 2"):
        probing.wire.know_channels(channels)
    return kept


def _pacings(probing: Probing, pacings: int) -> None:
    names = [name for bit, name in enumerate(("device", "host", "lockstep")) if pacings >> bit & 1]
    found = f"0x{pacings:x}: {', '.join(names) or 'none'}"
    probing.judge("pacings", bool(names) and pacings < 8, found, "register 3, which holds bits, not a number")
    if pacings >> schema.LOCKSTEP & 1:
        why = "declared; whether there is a motor cannot be seen on the wire"
        look_at = "bit 2 of register 3: for simulated devices only. Where there is a motor, clear it"
        probing.not_seen("lockstep", why, look_at)
    else:
        probing.passed("lockstep", "not declared")


def _name(probing: Probing, registers: np.ndarray) -> None:
    words = registers[schema.REG_NAME : schema.REG_NAME + schema.NAME_WORDS].astype("<u4").tobytes()
    name = words.rstrip(b"\0")
    kept = all(0x20 <= byte <= 0x7E for byte in name)
    look_at = "registers 16 to 19: the first character in bits 7 to 0 of register 16, zeros behind the last"
    probing.judge("name", kept, repr(name.decode("latin-1")), look_at)


def _is_scale(value: float) -> bool:
    return math.isfinite(value) and value > 0


def _scales(probing: Probing, description: Description) -> None:
    for name, unit, first in (
        ("position_scale", "m per count", schema.REG_POSITION_SCALE),
        ("force_scale", "N per count", schema.REG_FORCE_SCALE),
    ):
        values = getattr(description, name)
        look_at = f"registers {schema.REG_CHANNEL + first} + 8c and the next one: a double, low word first, {unit}"
        probing.judge(name, all(map(_is_scale, values)), f"{_told(values)} {unit}", look_at)
    limits = description.force_limit
    finite = all(map(_is_scale, limits))
    probing.judge("force_limit", finite, f"{_told(limits)} N", "registers 36 + 8c and 37 + 8c: a double, in N")
    if finite and not probing.has_failed("force_scale"):
        for c, (limit, scale) in enumerate(zip(limits, description.force_scale, strict=True)):
            reach = scale * 2.0**31
            found = f"channel {c}: limit {limit:g} N, of which 32 bits of counts reach {reach:g} N"
            # A limit that no count reaches is kept by the format itself, but mostly it tells of a wrong scale.
            probing.judge(
                "force_limit", limit <= reach * (1 + 1e-9) and limit > scale, found, "force_scale and force_limit"
            )
    velocities = description.velocity_scale
    kept = not velocities or all(map(_is_scale, velocities))
    found = f"{_told(velocities)} (m/s) per count" if velocities else "0: no velocity is sensed"
    probing.judge("velocity_scale", kept, found, "registers 38 + 8c and 39 + 8c: on all channels, or 0 on all")


def _told(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:g}" for value in (values[:1] if len(set(values)) == 1 else values))


_CLOCKS = {schema.PACED_BY_DEVICE: "by the device", schema.PACED_BY_HOST: "by the host", schema.LOCKSTEP: "in lockstep"}


def probe_refusals(probing: Probing) -> bool:
    """Always goes on: whatever armed by mistake was released."""
    device, wire = probing.device, probing.wire
    good = schema.PACED_BY_DEVICE if device.paces(schema.PACED_BY_DEVICE) else schema.PACED_BY_HOST
    other_schema = arm_frame(wire, good, 1, word=schema.SCHEMA_HASH ^ 1)
    _refused(probing, "wrong_schema", "a schema hash with one bit flipped", other_schema, schema.WRONG_SCHEMA)
    for pacing in (*_CLOCKS, 3, 0x7F):
        if pacing > schema.LOCKSTEP or not device.paces(pacing):
            what = f"pacing {pacing} ({_CLOCKS.get(pacing, 'unknown')})"
            _refused(probing, "wrong_pacing", what, arm_frame(wire, pacing, 1), schema.WRONG_PACING)
    for watchdog in dict.fromkeys((0, device.max_watchdog_samples + 1, 4095)):
        frame = arm_frame(wire, good, watchdog)
        _refused(probing, "wrong_watchdog", f"watchdog {watchdog}", frame, schema.WRONG_WATCHDOG)
    if device.senses_velocity:
        probing.not_seen("wrong_sensing", "the device senses velocity on every channel: nothing to refuse")
    else:
        frame = arm_frame(wire, good, 1, velocity=True)
        _refused(probing, "wrong_sensing", "velocities asked for", frame, schema.WRONG_SENSING)
    _disarms(probing)
    return True


def _refused(probing: Probing, name: str, what: str, frame: bytes, fault: int) -> None:
    wire = probing.wire
    answer, _ = wire.ask(frame, lambda one: one.kind == schema.STATUS)
    kept = answer is not None and (answer.wire, answer.number) == (SET_UP, 0)
    kept = kept and answer is not None and (answer.state, answer.fault) == (schema.IDLE, fault)
    look_at = f"the test of ARM for fault {fault} ({schema.FAULTS[fault]}), and what STATUS says beside it"
    others = f"{before}, " if kept and (before := probing.found(name)) else ""
    probing.judge(name, kept, f"{others}{what}" if kept else f"{what}: {told(answer)}", look_at)
    if answer is not None and answer.state == schema.ARMED:
        probing.failed("stays_idle", f"{what}: armed all the same", "ARM is to be refused before anything is changed")
        wire.release()
        return
    _stays(probing, what, fault)


def _stays(probing: Probing, what: str, fault: int) -> None:
    """A device that sent a position has armed, whatever it said."""
    value, heard = probing.wire.ask(
        probing.wire.frame(schema.DESCRIBE, schema.REG_FAULT),
        lambda one: one.kind == schema.DESCRIPTION and one.number == schema.REG_FAULT,
    )
    more = [one for one in heard if one.kind in (schema.POSITION, schema.POSITION_HELD)]
    kept = value is not None and value.word == fault and not more
    if more:
        found = f"{told(more[0])} after {what} was refused"
    elif value is None:
        found = f"no answer to DESCRIBE after {what} was refused"
    else:
        found = f"register 7 reads {value.word} after {what} was refused"
    if not kept:
        look_at = "a refusal sets the fault, and neither state, format nor force"
        probing.failed("stays_idle", found, look_at)
        probing.wire.release()
    else:
        probing.passed("stays_idle", "answers DESCRIBE after each refusal, sends no position; register 7 has the fault")


def _disarms(probing: Probing) -> None:
    wire = probing.wire
    before = wire.register(schema.REG_FAULT)
    answer, _ = wire.ask(wire.frame(schema.DISARM, 0), lambda one: one.kind == schema.STATUS)
    kept = answer is not None and (answer.wire, answer.state, answer.fault) == (SET_UP, schema.IDLE, before)
    look_at = "DISARM is obeyed and answered in every state; only ARM clears the fault"
    probing.judge("disarm_idle", kept, f"{told(answer)}; register 7 read {before}", look_at)
