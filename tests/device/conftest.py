"""A mock of any kind, and a host that talks to it in bytes, in virtual time, by hand."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.decoder import frames_in, new_decoder
from firmware_protocol.frames import SETUP, Format, armed_format, frame_bytes, frame_to_device
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.firmware import check_watchdog, prepare, take_bytes, take_sample
from hapsim.scene import Scene


class DeviceFrame(NamedTuple):
    """A frame of the device."""

    type: int
    number: int
    counts: tuple[int, ...]

    @property
    def state(self) -> int:
        return self.counts[0] & 0xFF

    @property
    def fault(self) -> int:
        return self.counts[0] >> 8 & 0xFF

    @property
    def word(self) -> int:
        return self.counts[0] & 0xFFFFFFFF


def in_counts(word: int) -> int:
    """An unsigned 32-bit value as the signed one that a frame carries."""
    return (word & 0xFFFFFFFF) - ((word & 0x80000000) << 1)


@cache
def decoder_of(wire: Format) -> Any:
    return new_decoder(wire, to_device=False)


class Host:
    """The host's end of a wire to a mock. `wire`: the armed format it speaks. `armed`: the device last said so.
    `misread`: chunks that are no frame, or one in several formats."""

    def __init__(self, mock: Any) -> None:
        """`mock`: a MOCK."""
        prepare(mock)
        self.mock = mock
        self.channels = int(mock.channels)
        self.armed_formats = {
            parts: armed_format(self.channels, parts)
            for parts in schema.COMBINATIONS
            if schema.fits(self.channels, parts)
        }
        self.wire = self.armed_formats[0]
        self.by_length = defaultdict(list)
        for wire in (SETUP, *self.armed_formats.values()):
            self.by_length[frame_bytes(wire, to_device=False)].append(decoder_of(wire))
        self.armed = False
        self.misread = 0

    # What is to be said.

    def frame(self, kind: int, number: int, argument: int, counts: Sequence[int], armed: bool | None = None) -> bytes:
        wire = self.wire if (self.armed if armed is None else armed) else SETUP
        padded = [*counts, *[0] * schema.MAX_WORDS][: wire.words(to_device=True)]
        return frame_to_device(wire, kind, number, argument, np.array(padded, np.int64))

    def arm_frame(self, pacing: int = schema.LOCKSTEP, watchdog: int = 100, word: int = schema.SCHEMA_HASH) -> bytes:
        return self.frame(schema.ARM, watchdog, pacing, [in_counts(word)], armed=False)

    def force_frame(self, sample: int, counts: Sequence[int] = (0,), time_to_live: int = 20) -> bytes:
        return self.frame(schema.FORCE, sample % schema.SAMPLE_MODULUS, time_to_live, counts, armed=True)

    def disarm_frame(self, armed: bool = True) -> bytes:
        return self.frame(schema.DISARM, 0, 0, [0], armed=armed)

    # Saying it.

    def send(self, data: bytes, now: int = 0) -> list[DeviceFrame]:
        array = np.frombuffer(data, np.uint8).copy()
        take_bytes(self.mock, array, array.size, now)
        return self.listen()

    def arm(
        self, pacing: int = schema.LOCKSTEP, watchdog: int = 100, now: int = 0, parts: int = 0
    ) -> list[DeviceFrame]:
        self.wire = self.armed_formats[parts]
        return self.send(self.arm_frame(pacing | parts, watchdog), now)

    def force(
        self, sample: int, counts: Sequence[int] = (0,), time_to_live: int = 20, now: int = 0
    ) -> list[DeviceFrame]:
        return self.send(self.force_frame(sample, counts, time_to_live), now)

    def disarm(self, now: int = 0) -> list[DeviceFrame]:
        return self.send(self.disarm_frame(self.armed), now)

    def register(self, number: int) -> int:
        (answer,) = self.send(self.frame(schema.DESCRIBE, number, 0, [0], armed=False))
        assert (answer.type, answer.number) == (schema.DESCRIPTION, number)
        return answer.word

    def sample_passes(self, now: int = 0) -> list[DeviceFrame]:
        take_sample(self.mock, now)
        return self.listen()

    def check_watchdog(self, now: int = 0) -> list[DeviceFrame]:
        check_watchdog(self.mock, now)
        return self.listen()

    # Hearing the answer.

    def listen(self) -> list[DeviceFrame]:
        data = self.mock.outbox[: int(self.mock.board.out)].copy()
        self.mock.board.out = 0
        return self.read(data)

    def read(self, data: np.ndarray) -> list[DeviceFrame]:
        """Every frame is tried in all formats of its length: which one the device chose is checked where it matters."""
        heard = []
        for chunk in filter(None, data.tobytes().split(b"\0")):
            frames = []
            for decoder in self.by_length[len(chunk) + 1]:
                frames += [DeviceFrame(one.type, one.number, one.counts) for one in frames_in(decoder, chunk + b"\0")]
            self.misread += len(frames) != 1
            heard += frames
            for frame in frames:
                if frame.type == schema.STATUS:
                    self.armed = frame.state == schema.ARMED
        return heard

    # What no frame tells.

    @property
    def state(self) -> int:
        return int(self.mock.board.state)

    @property
    def commanded(self) -> np.ndarray:
        """Every force that acts or may yet act, N: a row for each sample, a column for each channel."""
        commands: np.ndarray = self.mock.commands[: self.mock.depth, : self.channels]
        return commands

    @property
    def bodies(self) -> np.ndarray:
        """Bodies that the forces move, one for each channel."""
        bodies: np.ndarray = self.mock.bodies[: self.channels]
        return bodies


def scene_of(
    channels: int = 1, rate: float = 1000.0, device: dict[str, Any] | None = None, mock: dict[str, Any] | None = None
) -> Scene:
    """A scene with a hand alone; in the plane, on its first and its last channel, if a mass is a matrix."""
    mass = [part["mass"] for part in (device, mock) if part and "mass" in part]
    in_plane = any(isinstance(row, list) for each in mass if isinstance(each, list) for row in each)
    hand = {"channels": [0, channels - 1]} if in_plane else {"channel": channels - 1}
    return Scene.model_validate(
        {
            "version": 1,
            "space": 1 + in_plane,
            "rate": rate,
            "device": {"clock": "lockstep", "mass": 0.2} | (device or {}),
            "mock": mock or {},
            "modules": {"hand": {"type": "device"} | hand},
        }
    )


@pytest.fixture(scope="session")
def new_scene() -> Callable[..., Scene]:
    """Makes a scene of (channels, rate, device, mock)."""
    return scene_of


@pytest.fixture(scope="session")
def new_host() -> Callable[..., Host]:
    """Makes a host on a wire to a new mock of (channels, rate, device, mock)."""

    def new(*args: Any, **fields: Any) -> Host:
        return Host(assemble_mock(scene_of(*args, **fields)))

    return new


@pytest.fixture(scope="session")
def exchange() -> Callable[..., list[DeviceFrame]]:
    """Arms in lockstep and answers each position with the next of the forces; every frame of the device."""

    def run(host: Host, forces: Iterable[Sequence[int]], parts: int = 0) -> list[DeviceFrame]:
        heard = host.arm(parts=parts)
        for n, counts in enumerate(forces):
            heard += host.force(n, counts)
        return heard

    return run
