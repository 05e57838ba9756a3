"""Forces that come late, in virtual time: every one by as many whole samples as the wire takes, and some by chance.

A force that comes late by chance comes with the next one, which is newer, and so never acts. What a force goes to is
called by its address (`prepare` of the firmware), so that a mock whose forces are in time has none of this.
"""

from __future__ import annotations

from numba import types

from firmware_protocol import schema
from hapsim.compiling import inlined
from hapsim.compiling.native import native
from hapsim.device.mock.firmware import MOST_LATE, call_event, mock_at
from hapsim.device.mock.sampler import uniform


@native(types.void, types.uint64, types.int64)
def take_late_force(mock, now):
    """In virtual time, over a wire that takes longer than a sample: a force is sent, and the one that was sent so many
    samples before arrives. Where none does, the sample ends without."""
    address, mock = mock, mock_at(mock)
    board, decoder = mock.board, mock.decoder
    if board.pacing == schema.LOCKSTEP:
        n = board.n
        _copy_force(decoder, mock.under_way[n % (MOST_LATE + 1)])
        missed = mock.chance.share > 0.0 and uniform(mock.chance) <= mock.chance.share
        if n >= mock.late_samples and not missed:
            _copy_force(mock.under_way[(n - mock.late_samples) % (MOST_LATE + 1)], decoder)
            call_event(mock.called.act_on_force, (address, now))
        if board.n == n and board.state == schema.ARMED:
            call_event(mock.called.take_sample, (address, now))
    else:
        call_event(mock.called.act_on_force, (address, now))


@inlined
def _copy_force(source, target):
    target.number = source.number
    target.argument = source.argument
    for c in range(schema.MAX_CHANNELS):
        target.counts[c] = source.counts[c]
