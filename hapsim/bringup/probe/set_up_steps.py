"""The first three steps, before a device is armed: does it answer, what does it say of itself, what does it refuse."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.client import ANSWER_S, FIRST_TRIES, Received, disarm_in_every_format
from firmware_protocol.description import from_registers, registers_of_a_description
from firmware_protocol.frames import SETUP, frame_to_device
from hapsim.bringup.probe.probing import Probing, Wire, in_words

_QUIET_S = 0.2
_NOISE = bytes(1 + (7 * i) % 255 for i in range(300))
_UNKNOWN_TYPES = (0x0, *range(0x5, 0x10))
_NO_REGISTERS = (24, 31, schema.REGISTERS, 1000, 4095)
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
    """Returns whether the device answers."""
    if not _answers(probing):
        return False
    wire = probing.wire
    _describes(probing, (schema.REG_VERSION, schema.REG_SCHEMA, schema.REG_CHANNELS))
    before, pieces = wire.received, len(wire.damaged)
    frames = wire.receive_for(_QUIET_S)
    count, noise = wire.received - before, b" ".join(wire.damaged[pieces:])
    sample = f", the first: {in_words(frames[0])}" if frames else f", such as {noise[:24]!r}" if noise else ""
    probing.judge("silence", count == 0, f"{count} bytes in {_QUIET_S:g} s{sample}")
    _ignores_damage(probing)
    _finds_back(probing)
    _ignores_unknown_types(probing)
    for number in _NO_REGISTERS:
        word = wire.register(number)
        if word != 0:
            found = f"register {number}: {'no answer' if word is None else f'reads 0x{word:x}'}"
            probing.judge("unknown_registers", False, found)
            break
    else:
        probing.judge("unknown_registers", True, ", ".join(map(str, _NO_REGISTERS)))
    return True


def _answers(probing: Probing) -> bool:
    wire = probing.wire
    begun, frame = wire.clock.monotonic(), wire.frame(schema.DESCRIBE, schema.REG_VERSION)
    release = disarm_in_every_format()  # a host that died may have left it armed
    answer, _ = wire.ask(frame, schema.DESCRIPTION, tries=FIRST_TRIES, after_quiet=release)
    if answer is not None:
        after = f"{in_words(answer)}, {1e3 * (answer.at_s - begun):.3g} ms after the port opened"
        remainder = f"; before it {len(wire.damaged)} pieces that are no frame" if wire.damaged else ""
        return probing.judge("answers", True, after + remainder)
    found, look_at = "not one byte", ""
    if frame[:-1] in wire.damaged:
        found = "what is written comes back, and nothing else"
        look_at = "an echo: a port that is not raw, or TX wired to RX"
    elif wire.received:
        found = f"{wire.received} bytes, {len(wire.damaged)} pieces between zero bytes, none of them a frame"
        look_at = "baud rate, 8 bits, no parity; the set-up format's start value 0x4853; the order of the check's bytes"
    return probing.judge("answers", False, found, look_at)


def _describes(probing: Probing, numbers: tuple[int, ...]) -> bool:
    wire = probing.wire
    for number in numbers:
        answer, _ = wire.ask(wire.frame(schema.DESCRIBE, number), schema.DESCRIPTION)
        if answer is None or (answer.number, answer.wire) != (number, SETUP):
            found = f"register {number} was asked for, the answer: {in_words(answer)}"
            return probing.judge("describe", False, found)
    return probing.judge("describe", True, "registers 0, 1 and 2, each by its number")


def _is_version(one: Received) -> bool:
    return (one.kind, one.number) == (schema.DESCRIPTION, schema.REG_VERSION)


def _only_the_second(wire: Wire, first: bytes) -> tuple[bool, Received | None]:
    """Sends a frame that must not be answered and a question behind it. Returns (whether the question was answered, the
    first other answer, if any). Answers come in the order of the questions."""
    question = wire.frame(schema.DESCRIBE, schema.REG_VERSION)
    for again in range(3):
        wire.send(question if again else first + question)
        answer, frames = wire.wait_for(_is_version, ANSWER_S)
        other = next((one for one in frames if not _is_version(one)), None)
        if answer is not None or other is not None:
            return answer is not None, other
    return False, None


def _ignores_damage(probing: Probing) -> bool:
    for at, bit, what in _FLIPS:
        damaged = bytearray(probing.wire.frame(schema.DESCRIBE, schema.REG_SCHEMA))
        damaged[at] ^= bit
        answered, other = _only_the_second(probing.wire, bytes(damaged))
        if other is not None:
            found = f"a bit flipped in {what}, and the device answers: {in_words(other)}"
            return probing.judge("damaged_frames", False, found)
        if not answered:
            found = f"after a bit flipped in {what} the next whole frame is not answered"
            return probing.judge("damaged_frames", False, found, "what the receiver forgets, and keeps, at a zero byte")
    return probing.judge("damaged_frames", True, f"{len(_FLIPS)} frames with a flipped bit, none answered")


def _finds_back(probing: Probing) -> bool:
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
        if wire.wait_for(_is_version, 2 * ANSWER_S)[0] is None:
            return probing.judge("finding_back", False, f"{what}: the whole frame is not answered")
    return probing.judge("finding_back", True, "; ".join(tried))


def _ignores_unknown_types(probing: Probing) -> bool:
    for kind in (*_UNKNOWN_TYPES, schema.FORCE):
        answered, other = _only_the_second(probing.wire, frame_to_device(SETUP, kind, schema.REG_SCHEMA, 0, [0]))
        if other is not None or not answered:
            name = "FORCE while not armed" if kind == schema.FORCE else f"type 0x{kind:x}"
            came = in_words(other) if other else "the next frame is not answered"
            return probing.judge("unknown_types", False, f"{name}: {came}")
    return probing.judge("unknown_types", True, f"{len(_UNKNOWN_TYPES)} unknown types and FORCE, none answered")


_PART_UNITS = {"velocity": "m/s", "acceleration": "m/s²", "hand_force": "N"}

_LEAST_HZ, _MOST_HZ = 1e-3, 1e9
"""Beyond these a rate is no haptic device's: the two words of the double are more likely swapped."""


def probe_registers(probing: Probing) -> bool:
    """Returns whether the device may be armed: it speaks this schema, and its registers make sense."""
    registers, judge = np.zeros(schema.REGISTERS, np.int64), probing.judge
    if not _read(probing, registers, [schema.REG_VERSION, schema.REG_SCHEMA, schema.REG_CHANNELS, schema.REG_SENSORS]):
        return False
    version, word, channels = (int(registers[n]) for n in (schema.REG_VERSION, schema.REG_SCHEMA, schema.REG_CHANNELS))
    other = "" if word == schema.SCHEMA_HASH else f", this hapsim's is 0x{schema.SCHEMA_HASH:08x}"
    is_ours = judge("version", version == schema.VERSION, f"{version}")
    is_ours &= judge("schema", word == schema.SCHEMA_HASH, f"0x{word:08x}{other}")
    if not is_ours or not judge("channels", 1 <= channels <= schema.MAX_CHANNELS, f"{channels}"):
        return False
    if not _read(probing, registers, registers_of_a_description(channels, int(registers[schema.REG_SENSORS]))):
        return False
    name = registers[schema.REG_NAME :][: schema.NAME_WORDS].astype("<u4").tobytes().rstrip(b"\0")
    judge("name", all(0x20 <= byte <= 0x7E for byte in name), repr(name.decode("latin-1")))
    _judge_pacings(probing, int(registers[schema.REG_PACINGS]))
    probing.description = device = from_registers(registers)
    watchdog, bridge = int(registers[schema.REG_MAX_WATCHDOG]), int(registers[schema.REG_BRIDGE])
    judge("max_watchdog", 1 <= watchdog <= schema.MAX_WATCHDOG_SAMPLES, f"{watchdog} samples")
    judge("rate", _LEAST_HZ <= device.rate_hz <= _MOST_HZ, f"{device.rate_hz:g} Hz")
    named = ", ".join(f"channel {c} {motion}" for c, motion in enumerate(device.motions))
    rotary = f"0x{device.rotary:x}: {named}" if device.rotary else "0: not declared"
    judge("rotary", device.rotary < 1 << channels, rotary)
    if bridge == 1:
        found = "1: a bridge; what the device does when the bridge ends or its cable is pulled cannot be seen here"
        probing.not_seen("bridge", found, "the bridge's page; keep a hand near the device's power")
    else:
        judge("bridge", bridge == 0, f"{bridge}: {'neither 0 nor 1' if bridge else 'not declared'}")
    known = {schema.SENSES_ACCELERATION: "acceleration", schema.HAS_DIGITAL_WORD: "digital words"}
    known |= {schema.FOLLOWS_LINES: "lines", schema.SENSES_FORCE: "hand force"}
    known |= {schema.FOLLOWS_COMMANDS: "position commands"}
    names = ", ".join(name for bit, name in known.items() if device.sensors & bit)
    described = device.lines is not None or not device.sensors & schema.FOLLOWS_LINES
    found = f"0x{device.sensors:x}: {names or 'none that is known'}"
    found += "" if described else f", but no lines in registers {schema.REG_BOARD_STEPS} to {schema.REG_KEPT_REPORTS}"
    judge("sensors", device.sensors < 32 and described, found)
    _judge_scales(probing)
    needed = (
        "pacings",
        "max_watchdog",
        "rate",
        "position_scale",
        "force_scale",
        "force_limit",
        "velocity_scale",
        "acceleration_scale",
        "hand_force_scale",
        "servo_registers",
    )
    return not any(map(probing.has_failed, needed))


def _read(probing: Probing, registers: NDArray[np.int64], numbers: list[int]) -> bool:
    for number in numbers:
        value = probing.wire.register(number)
        if value is None:
            return _describes(probing, (number,))
        registers[number] = value
    return True


def _judge_pacings(probing: Probing, pacings: int) -> None:
    names = [name for bit, name in schema.PACINGS.items() if pacings >> bit & 1]
    probing.judge("pacings", bool(names) and pacings < 8, f"0x{pacings:x}: {', '.join(names) or 'none'}")
    if "lockstep" in names:
        look_at = "bit 2 of register 3: for simulated devices only. If there is a motor, clear it"
        probing.not_seen("lockstep", "declared; whether there is a motor cannot be seen on the wire", look_at)
    else:
        probing.judge("lockstep", True, "not declared")


def _judge_scales(probing: Probing) -> None:
    device, name_of = probing.device, probing.units.name
    scales = {"position_scale": "m per count", "force_scale": "N per count", "force_limit": "N"}
    named = {name: name_of(unit) for name, unit in scales.items()}
    for part, unit in _PART_UNITS.items():
        if device.scale(part):
            named[f"{part}_scale"] = f"({name_of(unit)}) per count"
        else:
            (declared,) = (one.declared_by for one in schema.SENSED if one.name == part)
            probing.judge(f"{part}_scale", not device.sensors & declared, f"0: no {part.replace('_', ' ')} is sensed")
    for name, unit in named.items():
        values: tuple[float, ...] = getattr(device, name)
        shown = values[:1] if len(set(values)) == 1 else values
        probing.judge(name, all(map(_is_scale, values)), f"{', '.join(f'{value:g}' for value in shown)} {unit}")
    for name, values in (device.servo._asdict() if device.servo else {}).items():
        kept = all(_is_scale(value) or (value == 0.0 and name == "bandwidth_hz") for value in values)
        probing.judge("servo_registers", kept, f"{name}: {', '.join(f'{value:g}' for value in values)}")
    if device.servo is None:
        probing.not_seen("servo_registers", "no position commands are followed")
    for c, (limit, scale) in enumerate(zip(device.force_limit, device.force_scale, strict=True)):
        reach = scale * 2.0**31
        # A limit that no count reaches does no harm, but mostly it comes from a wrong scale.
        if _is_scale(limit) and _is_scale(scale) and not scale < limit <= reach * (1 + 1e-9):
            units = probing.units_of(c)
            most = units(reach, "N", "g")
            found = f"channel {c}: limit {units(limit, 'N', 'g')}, of which 32 bits of counts reach {most}"
            probing.judge("force_limit", False, found, "force_scale and force_limit")


def _is_scale(value: float) -> bool:
    return math.isfinite(value) and value > 0


_PACINGS = {schema.PACED_BY_DEVICE: "by the device", schema.PACED_BY_HOST: "by the host", schema.LOCKSTEP: "lockstep"}


def probe_refusals(probing: Probing) -> None:
    """Always goes on: what armed by mistake was released."""
    device, wire = probing.device, probing.wire
    good = schema.PACED_BY_DEVICE if device.paces(schema.PACED_BY_DEVICE) else schema.PACED_BY_HOST
    other_schema = {"a schema hash with one bit flipped": wire.arm_frame(good, 1, word=schema.SCHEMA_HASH ^ 1)}
    _judge_refused(probing, "wrong_schema", other_schema, schema.WRONG_SCHEMA)
    pacings = [one for one in (*_PACINGS, 3, 0x7F) if one > schema.LOCKSTEP or not device.paces(one)]
    frames = {f"pacing {one} ({_PACINGS.get(one, 'unknown')})": wire.arm_frame(one, 1) for one in pacings}
    _judge_refused(probing, "wrong_pacing", frames, schema.WRONG_PACING)
    watchdogs = (0, device.max_watchdog_samples + 1, 4095)
    frames = {f"watchdog {one}": wire.arm_frame(good, one) for one in watchdogs}
    _judge_refused(probing, "wrong_watchdog", frames, schema.WRONG_WATCHDOG)
    missing = [part for part in schema.PARTS if part.mark and part.name not in device.parts]
    for part in missing:
        frames = {f"{part.name} asked for": wire.arm_frame(good, 1, parts=part.bit)}
        # A firmware that is older than register 15 takes the bit of its sensors for a pacing.
        older = [schema.WRONG_PACING] if part.declared_by else []
        if not _judge_refused(probing, "wrong_sensing", frames, schema.WRONG_SENSING, *older):
            break
    before = wire.register(schema.REG_FAULT)
    answer, _ = wire.ask(wire.frame(schema.DISARM, 0), schema.STATUS)
    kept = answer is not None and (answer.wire, answer.state, answer.fault) == (SETUP, schema.IDLE, before)
    probing.judge("disarm_idle", kept, f"{in_words(answer)}; register 7 read {before}")


def _judge_refused(probing: Probing, name: str, frames: dict[str, bytes], *faults: int) -> bool:
    """Sends each ARM, by its words, and judges whether it is refused with one of these faults."""
    for what, frame in frames.items():
        answer, _ = probing.wire.ask(frame, schema.STATUS)
        fault = answer.fault if answer and answer.fault in faults else faults[0]
        _stays(probing, what, fault, answer)
        state = answer and (answer.wire, answer.number, answer.state, answer.fault)
        if state != (SETUP, 0, schema.IDLE, fault):
            return probing.judge(name, False, f"{what}: {in_words(answer)}")
    return probing.judge(name, True, ", ".join(frames))


def _stays(probing: Probing, what: str, fault: int, answer: Received | None) -> bool:
    wire = probing.wire
    if answer is not None and answer.state == schema.ARMED:
        wire.release()
        look_at = "ARM is to be refused before anything is changed"
        return probing.judge("stays_idle", False, f"{what}: armed all the same", look_at)
    read, frames = wire.ask(wire.frame(schema.DESCRIBE, schema.REG_FAULT), schema.DESCRIPTION, schema.REG_FAULT)
    position = next((one for one in frames if one.kind in schema.POSITIONS), None)  # it armed, whatever it said
    if position is None and read is not None and read.word == fault:
        found = "answers DESCRIBE after each refusal, sends no position; register 7 has the fault"
        return probing.judge("stays_idle", True, found)
    wire.release()
    found = in_words(position) if position else f"register 7 reads {read.word}" if read else "no answer to DESCRIBE"
    return probing.judge("stays_idle", False, f"{found}, after {what} was refused")
