"""Damaged and random bytes into an armed loop: nothing forged is answered, and the line is found again at once."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from loop_rig import assembled, frame, scene_of
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.decoder import frames_in, new_decoder
from firmware_protocol.frames import armed_format
from hapsim.loop import endings
from hapsim.loop.endings import HUNG_UP
from hapsim.loop.portable import PortableLoop
from hapsim.running.assemble_loop import LoopMemory
from tests import thorough

# Damaged bytes in each format; HAPSIM_POINTS=500 makes it ten millions in all.
DAMAGED_BYTES = 10_000 * thorough.points(4, 10)
FORMATS = (1, 4)  # channels: a check of 16 bits, and one of 32


class DamagedStream:
    """Positions that swing slowly, damage of every kind between them, in pieces of any length; keeps what was sent."""

    def __init__(self, channels: int, seed: int) -> None:
        self.sound: dict[int, tuple[int, ...]] = {}
        """The counts of every position that was sent whole, by its sample."""
        self.first_after_damage: set[int] = set()
        self.damaged_bytes = 0
        self.forces: list[bytes] = []
        self._channels, self._frame = channels, frame
        self._chance = random.Random(seed)
        self._sample = 0
        self._waiting = bytearray()
        self._pieces = self._write()

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:  # noqa: ARG002  bytes are always there
        while len(self._waiting) < 600:
            piece = next(self._pieces, None)
            if piece is None:
                break
            self._waiting += piece
        if not self._waiting:
            return HUNG_UP
        count = min(self._chance.choice((1, 3, 7, 20, 90, 500)), buffer.size, len(self._waiting))
        buffer[:count] = np.frombuffer(bytes(self._waiting[:count]), np.uint8)
        del self._waiting[:count]
        return count

    def send(self, data: bytes) -> int:
        self.forces.append(data)
        return 0

    def _write(self) -> Iterator[bytes]:
        yield self._position()
        while self.damaged_bytes < DAMAGED_BYTES:
            damage = self._damage()
            self.damaged_bytes += len(damage)
            yield damage
            self.first_after_damage.add(self._sample)
            for _ in range(self._chance.randint(2, 5)):
                yield self._position()

    def _position(self) -> bytes:
        counts = self._counts(self._sample)
        self.sound[self._sample] = counts
        self._sample += 1
        return self._frame(self._sample - 1, *counts)

    def _damage(self) -> bytes:
        """Noise, or a position that never arrives whole."""
        chance = self._chance
        if chance.random() < 0.5:
            return chance.randbytes(chance.randint(1, 300))
        data = bytearray(self._frame(self._sample, *self._counts(self._sample)))
        self._sample += 1
        kind = chance.randrange(4)
        if kind == 0:
            for _ in range(chance.randint(1, 8)):
                data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        elif kind == 1:
            at = chance.randrange(len(data))
            data[at:] = chance.randbytes(len(data) - at)
        elif kind == 2:
            del data[chance.randrange(len(data)) :]
        else:
            at = chance.randrange(len(data))
            data[at : at + 1] = data[at : at + 1] * 2
        if self._frame(self._sample - 1, *self._counts(self._sample - 1))[:-1] in data:
            data[-4] ^= 0x10  # it was whole after all
        return bytes(data)

    def _counts(self, sample: int) -> tuple[int, ...]:
        return tuple(round(500 * np.sin(0.01 * sample + c)) for c in range(self._channels))


def run_on(loop: LoopMemory, stream: DamagedStream) -> tuple[int, dict[int, tuple[int, ...]]]:
    """Returns the ending, and the counts of every accepted position by its sample."""
    portable, rows = PortableLoop(loop.record, loop.inbox, stream), []
    ending = endings.RING_FULL
    while ending == endings.RING_FULL:
        ending = portable.run()
        rows.append(loop.ring.drain())
    return ending, {
        int(sample): tuple(counts)
        for part in rows
        for sample, counts in zip(part["sample"], part["position_counts"].tolist(), strict=True)
    }


@pytest.mark.parametrize("channels", FORMATS)
def test_damaged_and_random_bytes_are_not_answered_and_the_next_positions_are(channels: int, figures: Any) -> None:
    stream = DamagedStream(channels, seed=channels)
    loop = assembled(scene_of(channels))
    ending, accepted = run_on(loop, stream)
    assert ending == endings.HUNG_UP  # by nothing that a byte said, but by the end
    assert not {sample for sample, counts in accepted.items() if stream.sound.get(sample) != counts}  # forged
    missed = set(stream.sound) - set(accepted)
    assert missed <= stream.first_after_damage
    decoder = new_decoder(armed_format(channels), to_device=True)
    forces = frames_in(decoder, b"".join(stream.forces))
    assert len(forces) == len(stream.forces)
    limit = round(loop.record.io.force_limit[0] / loop.record.io.force_scale[0])
    for force in forces[:-1]:
        assert force.type == schema.FORCE
        assert max(map(abs, force.counts)) <= limit
    assert forces[-1].type == schema.DISARM
    figures.note(
        f"{stream.damaged_bytes} damaged bytes into {channels} channels: {len(accepted)} positions of "
        f"{len(stream.sound)} whole ones answered, none forged; {len(missed)} missed, each the first after damage"
    )
