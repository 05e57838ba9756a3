"""The memory of an exchange: received and sent bytes, and the position and force of each channel.

The last bytes of each direction stay as they were on the wire, for the report of a run that a guard or the device
ended. Nothing is copied for that: bytes go to the next place of a buffer, and to its beginning after KEPT bytes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.decoder import DECODER
from firmware_protocol.frames import ROOM
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import record_at
from hapsim.loop.system import SCRATCH
from hapsim.loop.transport import TRANSPORT, PythonTransport

KEPT = 1 << 14  # bytes: more than a hundred of the longest frames
AT_ONCE = 8192  # most bytes of one receive call

_EACH = (schema.MAX_CHANNELS,)

LAST_BYTES = np.dtype(
    [
        ("at", np.int64),  # where the next bytes go
        ("end", np.int64),  # end of the bytes of the round before
    ],
    align=True,
)
"""Place in a buffer of KEPT bytes, with room for the most bytes of one call."""

INBOX = np.dtype(
    [
        ("transport", TRANSPORT),
        ("decoder", DECODER),
        ("start", np.int64),  # of the bytes that are not yet decoded
        ("stop", np.int64),
        ("last", LAST_BYTES),
        ("bytes", np.uint8, KEPT + AT_ONCE),
    ],
    align=True,
)
"""A transport, its received bytes, and their decoder. Conversation and loop share it."""

inbox_at = record_at(INBOX)

IO_BUFFER = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("channels", np.int64),  # of the device: how many of the following are in use
        ("velocities", np.int64),  # 1: they are on the wire
        ("accelerations", np.int64),  # likewise
        ("measured", np.float64, _EACH),  # m, the newest position, or the predicted one
        ("before", np.float64, _EACH),  # m, the one before
        ("bridge", np.float64, _EACH),  # m, between the two: in substeps, and where positions were lost
        ("velocity", np.float64, _EACH),  # m/s, sensed or predicted with it; else 0
        ("velocity_before", np.float64, _EACH),  # m/s, with the one before
        ("velocity_bridge", np.float64, _EACH),  # m/s, likewise
        ("acceleration", np.float64, _EACH),  # m/s², sensed; else 0
        ("hand_forces", np.int64),  # 1: `mode: admittance`, sensed forces and commanded positions are on the wire:
        ("hand_force", np.float64, _EACH),  # N, of the hand on the handle;
        ("command", np.float64, _EACH),  # m, the simulated mass at the next sample, as it answers this one
        ("asked", np.float64, _EACH),  # N, the scene's force
        ("as_hand", np.float64, _EACH),  # N, the part of the excitation that counts as the hand's push
        ("excitation", np.float64, _EACH),  # N, added to the scene's force
        ("position_counts", np.int64, _EACH),  # from the scene's origin on
        ("velocity_counts", np.int64, _EACH),  # as on the wire
        ("acceleration_counts", np.int64, _EACH),  # likewise
        ("hand_force_counts", np.int64, _EACH),  # likewise
        ("command_counts", np.int64, _EACH),  # from the scene's origin on
        ("origin_counts", np.int64, _EACH),  # the device's position there,
        ("origin_at_arming", np.int64, _EACH),  # 1: its first one
        # The force after excitation and guards; behind the device's channels, if it follows lines, two words for each,
        # and the digital word.
        ("force_counts", np.int64, (3 * schema.MAX_CHANNELS + 1,)),
        ("command_payload", np.int64, (2 * schema.MAX_CHANNELS + 1,)),  # zeros for forces, commands, the digital word
        ("payload", np.uint64),  # address of what a frame carries: `force_counts`, or `command_payload`
        ("away_first", np.int64),  # channel of the first point at another port (away.py),
        ("away_end", np.int64),  # and the one behind the last, equal where there is none
        ("away", np.float64, _EACH),  # m, where they are at the time of the newest position,
        ("away_rate", np.float64),  # and the samples per second, for their velocities
        ("words", np.int64),  # 1: a digital word each way is on the wire:
        ("inputs", np.int64),  # 32 bits, of the newest position,
        ("outputs", np.int64),  # and of its answer
        ("lines", np.int64),  # 1: `law: board`, the device follows lines:
        ("line_force", np.float64, _EACH),  # N, at the reported position, with the excitation;
        ("stiffness", np.float64, _EACH),  # N/m,
        ("damping", np.float64, _EACH),  # N·s/m,
        ("low", np.float64, _EACH),  # N,
        ("high", np.float64, _EACH),  # N
        ("acted", np.float64, _EACH),  # N, the force of the sample that ended with the reported position
        ("position_scale", np.float64, _EACH),  # m per count
        ("velocity_scale", np.float64, _EACH),  # (m/s) per count
        ("acceleration_scale", np.float64, _EACH),  # (m/s²) per count
        ("hand_force_scale", np.float64, _EACH),  # N per count
        ("force_scale", np.float64, _EACH),  # N per count
        ("force_limit", np.float64, _EACH),  # N
        ("to_next", np.uint64, _EACH),  # channels to the next one of its hand, round and round; 0: there is no other
        SCRATCH,
        ("sent", LAST_BYTES),
        ("outbox", np.uint8, (KEPT + ROOM,)),  # the frame that is being written, and those before
    ],
    align=True,
)
"""Values that one exchange reads and writes, by channel."""


@inlined
def clip(force, limit):
    """Returns a force in N, clipped to -limit ... limit. NaN stays NaN; infinity becomes the limit."""
    return -limit if force < -limit else limit if force > limit else force


@inlined
def scale_line(io, c, share):
    """Multiplies the line of a channel, if the device follows lines, as its force."""
    if io.lines:
        io.line_force[c] *= share
        io.stiffness[c] *= share
        io.damping[c] *= share
        io.low[c] *= share
        io.high[c] *= share


@inlined
def scale_force(io, c, share):
    """Multiplies the whole force of a channel: in counts, its line, the excitation, and what counts as the hand's."""
    io.force_counts[c] = np.int64(np.rint(io.force_counts[c] * share))
    scale_line(io, c, share)
    io.excitation[c] *= share
    io.as_hand[c] *= share


@helper
def share_within_limit(io, c, excited):
    """Returns the factor that brings the force of a hand with several channels within its limit, a circle (an ellipse
    where channels differ): the scene's force, with the excitation if `excited`. `c`: one of its channels. A single
    channel is clipped: 1. Clipped one by one, x and y would turn the force; a limit that is a square is no passive
    one, since a spring pulled along an axis and released between two gives back more than it took."""
    total, other = 0.0, np.uint64(c)
    while io.to_next[other] != 0:
        force = io.asked[other] + io.excitation[other] if excited else io.asked[other]
        total += (force / io.force_limit[other]) ** 2
        other += io.to_next[other]
        if other == np.uint64(c):
            break
    return 1.0 / math.sqrt(total) if total > 1.0 else 1.0


@inlined
def next_place(last):
    """Returns the place of the next bytes. The caller then moves `last.at` behind them."""
    if last.at >= KEPT:
        last.end = last.at
        last.at = 0
    return last.at


def force_now(io: Any, channels: int) -> NDArray[np.float64]:
    """Returns the newest force of each channel, N: as sent, or where the device follows lines, as it acted last."""
    sent = io.force_counts[:channels] * io.force_scale[:channels]
    return np.array(io.acted[:channels]) if io.lines else sent


def last_bytes(last: Any, buffer: NDArray[np.uint8]) -> bytes:
    """Returns the bytes in a buffer, oldest first."""
    at, end = int(last.at), int(last.end)
    return buffer[at:end].tobytes() + buffer[:at].tobytes()


def put_bytes(last: Any, buffer: NDArray[np.uint8], data: bytes) -> None:
    """Writes bytes into a buffer, outside the compiled loop."""
    at = int(next_place(last))
    buffer[at : at + len(data)] = np.frombuffer(data, np.uint8)
    last.at = at + len(data)


def fetch_in_python(inbox: Any, transport: PythonTransport, timeout_ns: int) -> int:
    """Receives into an inbox whose bytes are all decoded. Returns the count, or a code of endings.py."""
    at = int(next_place(inbox.last))
    inbox.start = inbox.stop = at
    count = transport.receive(inbox.bytes[at : at + AT_ONCE], timeout_ns)
    inbox.stop = inbox.last.at = at + max(count, 0)
    return count
