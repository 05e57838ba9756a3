"""Stand-ins that wrap a function of the mock's firmware, in its place in CALLED: a hand that moves while the mock runs,
or recorded positions in place of those of the bodies. A mock without them neither compiles nor calls them.

**The hand** is moved by another thread. Its push, stiffness and damping ramp from sample to sample along a straight
line: a dragged hand comes as a stream of changes, each of which retargets the ramp, and a ramp that began and ended
without speed would stop the hand at each. It replaces `take_sample` when a hand is first posted.

**A record**: forces are accepted and counted, and move nothing. A lost position is not sent. After the last one the
device releases and reports idle; when it is armed again, it begins anew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from firmware_protocol.description import Description
from hapsim.compiling.native import address_of, array_at, native, record_at
from hapsim.cordis.parameters import PARAMETERS, LiveValues, call_move
from hapsim.device.mock.assemble_mock import described_mock, hand_values
from hapsim.device.mock.firmware import FUNCTIONS, disarm
from hapsim.device.mock.motion import move_with_spring_or_friction
from hapsim.device.mock.record import call_event, call_put_frame, mock_at
from hapsim.device.mock.sampler import set_timing
from hapsim.device.mock.servo import follow_commands
from hapsim.scene import Scene

_LEAST_S = 0.004  # of a ramp: a person's hand does not jump

LIVE_HAND = np.dtype([("values", PARAMETERS), ("take_sample", np.uint64)], align=True)
_hand_at, _doubles_at = record_at(LIVE_HAND), array_at(np.float64)


class LiveHand:
    """The hand of a mock, which can be moved while the mock runs. It must live as long as the mock."""

    def __init__(self, mock: Any, scene: Scene) -> None:
        """`mock`: MOCK, as assembled for `scene`."""
        self._mock, self._record = mock, new_record(LIVE_HAND)
        self._values = LiveValues(hand_values(scene).ravel(), self._record.values)
        self._record.values.straight = 1

    def retarget(self, scene: Scene, samples: int) -> None:
        """Moves the hand to its place in `scene` within `samples`, but at least 4 ms. For one thread at a time."""
        mock, values = self._mock, hand_values(scene)
        if values[1].any():
            mock.called.move = move_with_spring_or_friction.address()
        self._values.post(values.ravel(), max(samples, math.ceil(_LEAST_S * scene.rate)))
        if not mock.hand:
            self._record.take_sample = mock.called.take_sample
            mock.hand = address_of(self._record)
            mock.called.take_sample = move_hand.address()


class LiveInputs:
    """The inputs of a mock, which another thread may switch while it runs. Their times go on to turn them over."""

    def __init__(self, mock: Any, scene: Scene) -> None:
        """`mock`: MOCK, as assembled for `scene`."""
        self._mock, self._inputs = mock, scene.inputs

    @property
    def values(self) -> dict[str, int]:
        """Value of each input now, by name; 1: it is on."""
        word = self._word
        return {name: int(one.is_on(word)) for name, one in self._inputs.items()}

    def set(self, values: Mapping[str, int]) -> None:
        """Switches inputs to these values, by name. For one thread at a time."""
        word = self._word
        changed = sum(
            self._inputs[name].mask for name, value in values.items() if self._inputs[name].is_on(word) != value
        )
        self._mock.switched ^= changed

    @property
    def _word(self) -> int:
        return int(self._mock.inputs ^ self._mock.switched)


@native(types.void, types.uint64, types.int64)
def move_hand(mock, now):
    """Moves the hand by a sample, then calls `take_sample`."""
    address, mock = mock, mock_at(mock)
    hand, channels = _hand_at(mock.hand), mock.channels
    call_move(hand.values.move, (hand.values.address, np.uint64(0), np.uint64(0)))
    values = _doubles_at(hand.values.now, 3 * channels)
    for c in range(channels):
        body = mock.bodies[c]
        body.friction, body.stiffness = values[c], values[channels + c]
        body.push = values[2 * channels + c]
    call_event(hand.take_sample, (address, now))


_BITS = (0, *(part.bit for part in schema.SENSED))
_STILL_KG = 1e12  # mass of the bodies behind the record, which no force moves

RECORDED = np.dtype(
    [
        ("samples", np.uint64),  # address of the rows' sample numbers
        ("words", np.uint64),  # and of their counts, `width` a row: positions, then those of `parts`, then inputs
        ("rows", np.int64),
        ("width", np.int64),
        ("parts", np.int64),  # bits of schema.SENSED
        ("next", np.int64),  # the row that is sent next
        ("put_frame", np.uint64),
    ],
    align=True,
)
_recorded_at, _samples_at, _words_at = record_at(RECORDED), array_at(np.int64), array_at(np.int32)


class RecordedDevice:
    """A device that sends recorded positions. It must live as long as its mock."""

    def __init__(
        self, description: Description, samples: NDArray[np.int64], counts: NDArray[np.int32], period_s: float
    ) -> None:
        """`description`: of the device. `samples`: (N,) numbers, counted from arming. `counts`: (N, C) positions as on
        the wire, and of each value in `description.sensed`; then, if it has words, the input word. `period_s`: sample
        period, if the device paces."""
        self.description, self.period_s = description, period_s
        self._samples, self._counts = samples, counts
        self._record = new_record(RECORDED)
        self.mock: Any = None
        """MOCK, once assembled."""

    @property
    def forces(self) -> int:
        """Number of forces accepted since the last arming."""
        return 0 if self.mock is None else int(self.mock.registers[schema.REG_ACCEPTED])

    def assemble(self) -> Any:
        """Returns its MOCK, newly assembled."""
        record, channels = self._record, self.description.channels
        record.samples, record.words = self._samples.ctypes.data, self._counts.ctypes.data
        record.rows, record.width = self._counts.shape
        record.parts = schema.parts_of(self.description.sensed)
        record.put_frame = FUNCTIONS["put_frame"].address()
        self.mock = mock = described_mock(self.description)
        mock.bodies["mass"][:channels] = mock.initial["mass"][:channels] = _STILL_KG
        for converter in mock.converters[:channels]:
            mock.depth = set_timing(converter, "zoh", "ideal", 1.0)
        mock.converters["period"] = self.period_s
        mock.converters["quantum"][:channels] = self.description.position_scale
        for name in ("velocity", "acceleration"):
            mock.converters[f"{name}_quantum"][:channels] = self.description.scale(name) or 0.0
        if self.description.servo:
            rate = 1.0 / self.period_s
            follow_commands(mock, (None,) * channels, self.description.servo, rate=rate, delay=1.0)
        mock.recorded = address_of(record)
        mock.called.put_frame = put_recorded_frame.address()
        return mock


@native(types.void, types.uint64, types.uint64, types.int64, types.int64)
def put_recorded_frame(mock, framing, kind, number):
    """Puts the recorded position into a frame, then calls the function that puts it into the outbox."""
    address, mock = mock, mock_at(mock)
    recorded, n = _recorded_at(mock.recorded), mock.board.n
    if kind in (schema.POSITION, schema.POSITION_HELD):
        samples = _samples_at(recorded.samples, recorded.rows)
        if n == 0:
            recorded.next = 0
        while recorded.next < recorded.rows and samples[recorded.next] < n:
            recorded.next += 1
        if recorded.next == recorded.rows:
            kind = schema.STATUS
            mock.counts[:] = 0
            mock.counts[0] = schema.IDLE | (schema.NO_FAULT << 8)
            disarm(mock, schema.IDLE)
        elif samples[recorded.next] > n:
            return
        else:
            words = _words_at(recorded.words, recorded.rows * recorded.width)
            at, sent = recorded.next * recorded.width, 0
            for bit in _BITS:  # 0: of the positions
                if bit & mock.board.parts == bit:
                    for c in range(mock.channels):
                        mock.counts[sent + c] = words[at + c]
                    sent += mock.channels
                if bit & recorded.parts == bit:
                    at += mock.channels
            if mock.board.parts & schema.WITH_WORDS:
                mock.counts[sent] = words[at]
    call_put_frame(recorded.put_frame, (address, framing, kind, number))
