"""The hand that holds a running mock, moved by another thread: its push, stiffness and damping ramp from sample to
sample along a straight line.

It is straight because a dragged hand comes as a stream of changes, each of which retargets the ramp: one that began and
ended without speed would stop the hand at each.

What moves it stands before `take_sample`, whose address it takes in CALLED when a hand is first posted. A mock whose
hand does not change neither compiles nor calls it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of, array_at, native, record_at
from hapsim.cordis.parameters import PARAMETERS, LiveValues, call_move
from hapsim.device.mock.assemble import hand_values
from hapsim.device.mock.firmware import call_event, mock_at
from hapsim.device.mock.motion import move_with_spring_or_friction
from hapsim.scene import Scene

_LEAST_S = 0.004  # of a ramp: a person's hand does not jump

LIVE_HAND = np.dtype([("values", PARAMETERS), ("take_sample", np.uint64)], align=True)
_hand_at, _doubles_at = record_at(LIVE_HAND), array_at(np.float64)


class LiveHand:
    """The hand of a mock that may be moved while it runs. It has to live as long as the mock."""

    def __init__(self, mock: Any, scene: Scene) -> None:
        """`mock`: MOCK, as assembled for `scene`."""
        self._mock, self._record = mock, new_record(LIVE_HAND)
        self._values = LiveValues(hand_values(scene).ravel(), self._record.values)
        self._record.values.straight = 1

    def follow(self, scene: Scene, samples: int) -> None:
        """Moves the hand to where `scene` has it, within this number of samples, or 4 ms if that is longer. One thread
        at a time."""
        mock, values = self._mock, hand_values(scene)
        if values[1].any():
            mock.called.move = move_with_spring_or_friction.address()
        self._values.post(values.ravel(), max(samples, math.ceil(_LEAST_S * scene.rate)))
        if not mock.hand:
            self._record.take_sample = mock.called.take_sample
            mock.hand = address_of(self._record)
            mock.called.take_sample = lead_hand.address()


@native(types.void, types.uint64, types.int64)
def lead_hand(mock, now):
    """Stands before `take_sample`: moves the hand by a sample."""
    address, mock = mock, mock_at(mock)
    hand, channels = _hand_at(mock.hand), mock.channels
    call_move(hand.values.move, (hand.values.address, np.uint64(0), np.uint64(0)))
    values = _doubles_at(hand.values.now, 3 * channels)
    for c in range(channels):
        body = mock.bodies[c]
        body.friction, body.stiffness = values[c], values[channels + c]
        body.push = values[2 * channels + c]
    call_event(hand.take_sample, (address, now))
