"""The second step: what the device says of itself, register by register."""

from __future__ import annotations

import math

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description, from_registers, registers_of_a_description
from hapsim.bringup.probe.probing import Probing

_LEAST_HZ, _MOST_HZ = 1e-3, 1e9
"""Beyond these a rate is no haptic device's: the two words of the double are more likely swapped."""


def probe_registers(probing: Probing) -> bool:
    """Whether the device may be armed: it speaks this schema, and says of itself what can be."""
    findings = probing.findings
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
    findings.judge("max_watchdog", 1 <= declared <= schema.MAX_WATCHDOG_SAMPLES, limits, "register 6")
    rate = description.rate_hz
    swapped = "registers 4 and 5: the double's low word first"
    findings.judge("rate", _LEAST_HZ <= rate <= _MOST_HZ, f"{rate:g} Hz", swapped)
    _scales(probing, description)
    needed = ("pacings", "max_watchdog", "rate", "position_scale", "force_scale", "force_limit", "velocity_scale")
    return not any(findings.has_failed(name) for name in needed)


def _read(probing: Probing, registers: np.ndarray, numbers: list[int]) -> bool:
    for number in numbers:
        value = probing.wire.register(number)
        if value is None:
            look_at = f"register {number}: DESCRIBE was answered before, and of this one it is not"
            probing.findings.failed(_check_of(number), f"no answer for register {number} within 1 s", look_at)
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
    same = probing.findings.judge(
        "version", version == schema.VERSION, f"{version}", "which PROTOCOL.md the firmware was written from"
    )
    look_at = f"build the firmware with the header of this hapsim, whose schema hash is 0x{schema.SCHEMA_HASH:08x}"
    return probing.findings.judge("schema", word == schema.SCHEMA_HASH, f"0x{word:08x}", look_at) and same


def _channels(probing: Probing, channels: int) -> bool:
    kept = 1 <= channels <= schema.MAX_CHANNELS
    if probing.findings.judge("channels", kept, f"{channels}", "register 2"):
        probing.wire.know_channels(channels)
    return kept


def _pacings(probing: Probing, pacings: int) -> None:
    names = [name for bit, name in enumerate(("device", "host", "lockstep")) if pacings >> bit & 1]
    found = f"0x{pacings:x}: {', '.join(names) or 'none'}"
    probing.findings.judge("pacings", bool(names) and pacings < 8, found, "register 3, which holds bits, not a number")
    if pacings >> schema.LOCKSTEP & 1:
        why = "declared; whether there is a motor cannot be seen on the wire"
        look_at = "bit 2 of register 3: for simulated devices only. Where there is a motor, clear it"
        probing.findings.not_seen("lockstep", why, look_at)
    else:
        probing.findings.passed("lockstep", "not declared")


def _name(probing: Probing, registers: np.ndarray) -> None:
    words = registers[schema.REG_NAME : schema.REG_NAME + schema.NAME_WORDS].astype("<u4").tobytes()
    name = words.rstrip(b"\0")
    kept = all(0x20 <= byte <= 0x7E for byte in name)
    look_at = "registers 16 to 19: the first character in bits 7 to 0 of register 16, zeros behind the last"
    probing.findings.judge("name", kept, repr(name.decode("latin-1")), look_at)


def _is_scale(value: float) -> bool:
    return math.isfinite(value) and value > 0


def _scales(probing: Probing, description: Description) -> None:
    findings = probing.findings
    for name, unit, first in (
        ("position_scale", "m per count", schema.REG_POSITION_SCALE),
        ("force_scale", "N per count", schema.REG_FORCE_SCALE),
    ):
        values = getattr(description, name)
        look_at = f"registers {schema.REG_CHANNEL + first} + 8c and the next one: a double, low word first, {unit}"
        findings.judge(name, all(map(_is_scale, values)), f"{_told(values)} {unit}", look_at)
    limits = description.force_limit
    finite = all(map(_is_scale, limits))
    findings.judge("force_limit", finite, f"{_told(limits)} N", "registers 36 + 8c and 37 + 8c: a double, in N")
    if finite and not findings.has_failed("force_scale"):
        for c, (limit, scale) in enumerate(zip(limits, description.force_scale, strict=True)):
            reach = scale * 2.0**31
            found = f"channel {c}: limit {limit:g} N, of which 32 bits of counts reach {reach:g} N"
            # A limit that no count reaches is kept by the format itself, but mostly it tells of a wrong scale.
            findings.judge(
                "force_limit", limit <= reach * (1 + 1e-9) and limit > scale, found, "force_scale and force_limit"
            )
    velocities = description.velocity_scale
    kept = not velocities or all(map(_is_scale, velocities))
    found = f"{_told(velocities)} (m/s) per count" if velocities else "0: no velocity is sensed"
    findings.judge("velocity_scale", kept, found, "registers 38 + 8c and 39 + 8c: on all channels, or 0 on all")


def _told(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:g}" for value in (values[:1] if len(set(values)) == 1 else values))
