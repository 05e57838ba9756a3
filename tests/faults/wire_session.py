"""Frames of a session of one channel, and a script's faults between them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from firmware_protocol import schema
from firmware_protocol.decoder import Frame, frames_in, new_decoder
from firmware_protocol.description import Description, to_registers
from firmware_protocol.frames import SETUP, Format, armed_format, frame_to_device, frame_to_host
from hapsim.bringup.faults import Injector, Passed, parse_script
from hapsim.scene import Scene

ARMED = armed_format(1)
PERIOD_S = 0.001
DESCRIPTION = Description("test", 1000.0, 0b111, 200, (1e-6,), (1e-3,), (10.0,))


def touched_scene(**keys: float) -> Scene:
    """A hand that runs into a wall, in lockstep; `keys`: of the device."""
    device = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"} | keys
    touch = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 2000, "damping": 5}
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "touch": touch}
    mock = {"initial": {"velocity": 0.1}}
    return Scene.model_validate({"version": 1, "rate": 1000, "device": device, "mock": mock, "modules": modules})


def position(number: int, counts: int | None = None) -> bytes:
    """Returns a position frame of a device that moves by a thousand counts per sample."""
    return frame_to_host(
        ARMED, schema.POSITION, number % schema.SAMPLE_MODULUS, [1000 * number if counts is None else counts]
    )


def force(number: int, counts: int = 0, lives: int = 20) -> bytes:
    return frame_to_device(ARMED, schema.FORCE, number % schema.SAMPLE_MODULUS, lives, [counts])


@cache
def described() -> bytes:
    """Every register, as a device answers."""
    words = to_registers(DESCRIPTION)
    signed = [int(word) - ((int(word) & 0x80000000) << 1) for word in words]
    return b"".join(frame_to_host(SETUP, schema.DESCRIPTION, at, [word]) for at, word in enumerate(signed))


def injector_of(*faults: str, seed: int = 0) -> Injector:
    """Returns the injector of a script with these faults, each in a file's notation."""
    lines = [f"  - {{{fault}}}" for fault in faults]
    return Injector(parse_script("\n".join(["version: 1", f"seed: {seed}", "faults:", *lines])))


def positions_through(injector: Injector, count: int, first: int = 0) -> list[Passed]:
    """Returns the frames that the injector passes on from `count` positions, one per period."""
    passed: list[Passed] = []
    for number in range(first, first + count):
        passed += injector.take(position(number), False, number * PERIOD_S)
    return passed


def bytes_of(passed: Iterable[Passed], to_device: bool = False) -> bytes:
    return b"".join(one.data for one in passed if one.to_device == to_device)


def frames_of(data: bytes, to_device: bool = False, wire: Format = ARMED) -> list[Frame]:
    """Returns the frames that a receiver accepts."""
    return frames_in(new_decoder(wire, to_device), data)


def numbers_of(passed: Iterable[Passed]) -> list[int]:
    """The numbers of the samples that reach a host, in the order of arrival."""
    return [frame.number for frame in frames_of(bytes_of(passed))]
