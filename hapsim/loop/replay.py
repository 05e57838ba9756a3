"""The exchange without a device: recorded positions come in, at their recorded times.

What a record has of the forces that left, and when, decides as it did then whether a guard has them rise from zero.
"""

from __future__ import annotations

from firmware_protocol import schema
from hapsim.compiling import entry, inlined
from hapsim.loop.denormals import flush_denormals, restore
from hapsim.loop.exchange import HOST_CLOCK, compose_frame, flush_unsent, on_force_sent, take_frame
from hapsim.loop.ring import LATE_FORCE, UNSENT

_MASK = schema.SAMPLE_MODULUS - 1


# Words of a row that is replayed; C positions and C velocities in counts follow.
SAMPLE, TIME, FLAGS, FLAGS_BEFORE, TICK, ASKED, SENT, VALUES = range(8)


@entry
def replay_rows(loop, decoder, rows, flushes, ends):
    """Exchanges once for each row. `loop`: LOOP, whose inbox is not read; `decoder`: DECODER. `rows`: (n, 7 + 2 C)
    int64. `flushes`: whether denormal numbers are zero, as in the compiled loop; `ends`: whether the last row is the
    record's last."""
    mode = flush_denormals()
    if not flushes:
        restore(mode)
    for n in range(rows.shape[0]):
        row = rows[n]
        if loop.state.ticks > 0:
            _leave(loop, row)
        decoder.type = schema.POSITION_HELD if row[FLAGS] & LATE_FORCE else schema.POSITION
        decoder.number = row[SAMPLE] & _MASK
        for i in range(row.size - VALUES):
            decoder.counts[i] = row[VALUES + i]
        take_frame(loop, decoder, row[TIME])
        if ends and n == rows.shape[0] - 1:
            loop.state.unanswered = 1 if row[FLAGS] & UNSENT else 0
            flush_unsent(loop)
    restore(mode)


@inlined
def _leave(loop, row):
    """The force of the row before leaves, where it did, and when it did; and again where the host asked again."""
    state, wait = loop.state, loop.wait
    if loop.control.clock != HOST_CLOCK:
        if not row[FLAGS_BEFORE] & UNSENT:
            on_force_sent(loop, state.newest_ns)
        return
    tick, asked = row[TIME] - row[TICK], row[TIME] - row[ASKED]
    if not row[FLAGS_BEFORE] & UNSENT:
        wait.begun_ns = tick
        compose_frame(loop, False)
        on_force_sent(loop, asked)
        if asked != tick:
            wait.begun_ns = asked
            compose_frame(loop, False)
    state.tick_ns, state.sent_ns = tick, row[TIME] - row[SENT]
