"""The mock's firmware: what a microcontroller would do with the bytes of the protocol, compiled.

It is a state machine of three events: bytes arrived (`take_bytes`), a sample is due (`take_sample`), nothing was heard
for too long (`look_at_watchdog`). What it wants to send stands in its outbox. Each event is called by its address, so
that the mock in memory and the one on a pseudo-terminal are the same compiled code.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.decoder import DECODER, next_frame, use_framing
from firmware_protocol.frames import FRAMING, write_frame
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import address_in_memory, address_of, array_at, function_at, native, record_at
from hapsim.device.mock.motion import BODY, move, move_of
from hapsim.device.mock.sampler import (
    CONVERTER,
    MOST_AGES,
    advance_body,
    first_sample,
    first_velocity,
    sample,
    sample_velocity,
    to_counts,
    uniform,
)

OUTBOX_BYTES = 65536
INPUT_BYTES = 4096  # at most this many go into `take_bytes` at once: the answers to them fit the outbox
LONGEST_DELAY = 1000  # samples
MOST_LATE = schema.MAX_TIME_TO_LIVE_SAMPLES  # samples: later than that no force ever acts
_LONGEST_ANSWER = schema.frame_bytes(schema.MAX_CHANNELS, to_device=False, velocity=True)
_LOCKSTEP_PATIENCE_NS = 10_000_000_000  # twice what hapsim waits for a position: a host quiet for longer is gone
BOARD = np.dtype(
    [
        ("state", np.int64),  # IDLE, ARMED, LATCHED
        ("fault", np.int64),
        ("pacing", np.int64),
        ("velocity", np.int64),  # 1: armed to send velocities too
        ("watchdog", np.int64),  # samples
        ("n", np.int64),  # the sample that lasts now
        ("answered", np.int64),  # the sample that the newest accepted force answers
        ("expires", np.int64),  # the last sample in which that force may act
        ("heard", np.int64),  # the sample in which a force was last accepted
        ("heard_ns", np.int64),
        ("sampled_ns", np.int64),
        ("lives", np.float64),  # s, paced by the host: for how long of the sample that lasts a force may act
        ("out", np.int64),  # bytes in the outbox
        ("scale_out_of_range", np.int64),
    ]
)

_CALLED = ("take_bytes", "take_sample", "look_at_watchdog", "take_force", "act_on_force", "read", "say", "move")
CALLED = np.dtype([(name, np.uint64) for name in _CALLED], align=True)
"""Addresses: of the three events; of what a force goes to first, and when it is there; of the codec's two halves; and
of what moves the bodies."""

FORCE_UNDER_WAY = np.dtype(
    [("number", np.int64), ("argument", np.int64), ("counts", np.int64, (schema.MAX_CHANNELS,))], align=True
)

CHANCE = np.dtype([("share", np.float64), ("seed", np.uint64), ("state", np.uint64)], align=True)
"""By which forces come late: their share, and where the generator begins and stands."""

MOST_GRIPS = 1000
GRIP = np.dtype([("sample", np.int64), ("mass", np.float64)], align=True)

_EACH = (schema.MAX_CHANNELS,)

FORMATS = np.dtype([("setup", FRAMING), ("armed", FRAMING), ("armed_with_velocity", FRAMING)], align=True)

MOCK = np.dtype(
    [
        ("board", BOARD),
        ("channels", np.int64),
        ("bodies", BODY, _EACH),
        ("initial", BODY, _EACH),
        ("converters", CONVERTER, _EACH),
        ("depth", np.int64),  # rows of commands in use
        ("commands", np.float64, (LONGEST_DELAY + MOST_AGES, schema.MAX_CHANNELS)),  # N, sample by sample
        ("force_scale", np.float64, _EACH),
        ("force_limit", np.float64, _EACH),
        # What a frame carries: the positions of all channels, and then their velocities.
        ("counts", np.int64, (schema.MAX_WORDS,)),
        ("registers", np.int64, (schema.REGISTERS,)),
        ("heard", FORMATS),  # the formats of the host's frames,
        ("spoken", FORMATS),  # and of the mock's
        ("decoder", DECODER),
        ("outbox", np.uint8, (OUTBOX_BYTES,)),
        ("late_samples", np.int64),  # in virtual time: so many samples pass while a force is on the wire
        ("under_way", FORCE_UNDER_WAY, (MOST_LATE + 1,)),  # by the sample in which it was sent
        ("chance", CHANCE),
        (
            "grips",
            GRIP,
            (MOST_GRIPS + 1,),
        ),  # from which sample on the bodies have which mass (kg); the last never comes
        ("gripped", np.int64),  # how many of them are over
        ("byte_ns", np.float64),  # in real time: what a byte takes on the wire,
        ("turnaround_ns", np.float64),  # and what the device takes before its first
        ("address", np.uint64),  # of all this
        ("called", CALLED),
    ],
    align=True,
)
"""The whole mock: its bodies (one per channel), converters, history of commands, registers and bytes."""

mock_at, _framing_at, _bytes_at = record_at(MOCK), record_at(FRAMING), array_at(np.uint8)

call_take_bytes = function_at(types.void(types.uint64, types.uint64, types.int64, types.int64))
call_event = function_at(types.void(types.uint64, types.int64))
"""How compiled code calls the events: with the mock's address, and the time in ns."""

_call_read = function_at(types.int64(types.uint64, types.uint64, types.int64, types.int64))
_call_say = function_at(types.void(types.uint64, types.uint64, types.int64, types.int64))


@native(types.int64, types.uint64, types.uint64, types.int64, types.int64)
def _read(mock, data, start, stop):
    """Where the next frame in data[start:stop] ends, which is then in the decoder; -1 where there is none."""
    at, found = next_frame(mock_at(mock).decoder, _bytes_at(data, stop), start, stop)
    return at if found else -1


@native(types.void, types.uint64, types.uint64, types.int64, types.int64)
def _put_frame(mock, framing, kind, number):
    """Puts a frame with the counts into the outbox. What nobody fetches is lost once the outbox is full, as on a
    wire."""
    mock = mock_at(mock)
    if mock.board.out + _LONGEST_ANSWER <= mock.outbox.size:
        framing = _framing_at(framing)
        mock.board.out = write_frame(framing, mock.outbox, mock.board.out, kind, number, 0, mock.counts)


@native(types.void, types.uint64, types.uint64, types.int64, types.int64)
def _take_bytes(mock, data, stop, now):
    mock, at = mock_at(mock), 0
    while True:
        at = _call_read(mock.called.read, (mock.address, data, at, stop))
        if at < 0:
            return
        kind = mock.decoder.type
        if kind == schema.FORCE:
            if mock.board.state == schema.ARMED:
                call_event(mock.called.take_force, (mock.address, now))
        elif kind == schema.DESCRIBE:
            if mock.board.state != schema.ARMED:
                _describe(mock)
        elif kind == schema.ARM:
            if mock.board.state != schema.ARMED:
                _arm(mock, now)
        else:
            _release(mock)


@native(types.void, types.uint64, types.int64)
def _take_sample(mock, now):
    _end_sample(mock_at(mock), now)


@native(types.void, types.uint64, types.int64)
def _look_at_watchdog(mock, now):
    _fail_where_host_is_quiet(mock_at(mock), now)


@helper
def _end_sample(mock, now):
    """The sample that lasts ends: the bodies move through it, and the host hears where they are."""
    board = mock.board
    h = mock.converters[0].period
    acts = h
    if board.pacing == schema.PACED_BY_HOST:
        h = (now - board.sampled_ns if now > board.sampled_ns else 1) * 1e-9
        acts = min(h, board.lives)
    board.sampled_ns = now
    if board.n == mock.grips[mock.gripped].sample:
        for c in range(mock.channels):
            mock.bodies[c].mass = mock.grips[mock.gripped].mass
        mock.gripped += 1
    fresh = _decide_command(mock)
    if fresh and acts < h:
        fresh = False
        mock.registers[schema.REG_HELD] += 1
    for c in range(mock.channels):
        body, converter = mock.bodies[c], mock.converters[c]
        advance_body(mock.called.move, body, converter, mock.commands, mock.depth, c, board.n, acts)
        if acts < h:
            move(mock.called.move, body, 0.0, h - acts)
        position = sample(body, converter, h)
        _show(mock, c, position, sample_velocity(body, converter, h) if board.velocity else 0.0)
    if acts < h:
        _forget_forces_before(mock)
    board.n += 1
    _say_position(mock, schema.POSITION if fresh else schema.POSITION_HELD)


@helper
def _forget_forces_before(mock):
    """A time to live is over: what was commanded before the sample that ends, and is still on its way, went with it."""
    for row in range(mock.depth):
        for c in range(mock.channels):
            if row != mock.board.n % mock.depth:
                mock.commands[row, c] = 0.0


@helper
def _fail_where_host_is_quiet(mock, now):
    """The watchdog counts samples. Virtual time has none while the host is quiet: there only a real wait tells."""
    board = mock.board
    quiet, most = board.n - board.heard, board.watchdog
    if board.pacing == schema.LOCKSTEP:
        quiet, most = now - board.heard_ns, _LOCKSTEP_PATIENCE_NS
    elif board.pacing == schema.PACED_BY_HOST:
        quiet = np.int64((now - board.heard_ns) * 1e-9 / mock.converters[0].period)
    if board.state == schema.ARMED and quiet > most:
        _fail(mock, schema.HOST_QUIET)


@native(types.void, types.uint64, types.int64)
def _take_force(mock, now):
    """A force arrives: it is commanded for the sample that lasts, unless it is older than it may be."""
    mock = mock_at(mock)
    board = mock.board
    age = (board.n - mock.decoder.number) % schema.SAMPLE_MODULUS
    if age > mock.decoder.argument:
        mock.registers[schema.REG_EXPIRED] += 1
        return
    board.answered = board.n - age
    board.expires = board.answered + mock.decoder.argument
    board.heard = board.n
    board.heard_ns = now
    mock.registers[schema.REG_ACCEPTED] += 1
    for c in range(mock.channels):
        force = mock.decoder.counts[c] * mock.force_scale[c]
        if abs(force) > mock.force_limit[c]:
            mock.registers[schema.REG_LIMITED] += 1
            force = mock.force_limit[c] if force > 0.0 else -mock.force_limit[c]
        mock.commands[board.n % mock.depth, c] = force
    if board.pacing != schema.PACED_BY_DEVICE:
        call_event(mock.called.take_sample, (mock.address, now))
        board.lives = (mock.decoder.argument + 1) * mock.converters[0].period


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


@helper
def _decide_command(mock):
    """Settles the command of the sample that lasts; whether the force that answers it arrived in time.

    Without one, a force that is held goes on until its time to live is over. An impulse is given once and never again.
    """
    board = mock.board
    row = board.n % mock.depth
    before = (board.n - 1) % mock.depth
    if board.heard == board.n and board.answered == board.n:
        return True
    mock.registers[schema.REG_HELD] += 1
    if board.heard == board.n:
        return False
    lives = board.n <= board.expires and mock.converters[0].keeps_last_force
    for c in range(mock.channels):
        mock.commands[row, c] = mock.commands[before, c] if lives else 0.0
    return False


@helper
def _show(mock, channel, position, velocity):
    """What the frame is to carry. A velocity that does not fit stands at the end of its scale: no fault."""
    converter = mock.converters[channel]
    counts, fits = to_counts(position, converter.quantum)
    mock.counts[channel] = counts
    if not fits:
        mock.board.scale_out_of_range = 1
    if mock.board.velocity:
        counts, _ = to_counts(velocity, converter.velocity_quantum)
        mock.counts[mock.channels + channel] = counts


@inlined
def _armed(mock, formats):
    return formats.armed_with_velocity if mock.board.velocity else formats.armed


@inlined
def _say(mock, framing, kind, number):
    _call_say(mock.called.say, (mock.address, address_in_memory(framing), kind, number))


@helper
def _say_position(mock, kind):
    if mock.board.scale_out_of_range:
        _fail(mock, schema.POSITION_OUT_OF_RANGE)
    else:
        _say(mock, _armed(mock, mock.spoken), kind, mock.board.n % schema.SAMPLE_MODULUS)


@helper
def _say_status(mock, framing):
    mock.counts[:] = 0
    mock.counts[0] = mock.board.state | (mock.board.fault << 8)
    _say(mock, framing, schema.STATUS, mock.board.n % schema.SAMPLE_MODULUS)


@helper
def _describe(mock):
    """Answers with one register; one that does not exist reads 0."""
    number = mock.decoder.number
    mock.registers[schema.REG_FAULT] = mock.board.fault
    mock.registers[schema.REG_REJECTED] = (
        mock.decoder.crc_errors + mock.decoder.length_errors + mock.decoder.form_errors
    )
    word = mock.registers[number] if number < mock.registers.size else 0
    mock.counts[:] = 0
    mock.counts[0] = word & 0xFFFFFFFF
    _say(mock, mock.spoken.setup, schema.DESCRIPTION, number)


@helper
def _refusal(mock, pacing, velocity):
    """Why the device does not arm, or NO_FAULT."""
    if mock.decoder.counts[0] & 0xFFFFFFFF != schema.SCHEMA_HASH:
        return schema.WRONG_SCHEMA
    if pacing > schema.LOCKSTEP or not mock.registers[schema.REG_PACINGS] >> pacing & 1:
        return schema.WRONG_PACING
    if velocity and not mock.converters[0].velocity_quantum > 0.0:
        return schema.WRONG_SENSING
    if not 1 <= mock.decoder.number <= mock.registers[schema.REG_MAX_WATCHDOG]:
        return schema.WRONG_WATCHDOG
    return schema.NO_FAULT


@helper
def _arm(mock, now):
    """Begins at sample 0, from the initial state; says so, and speaks the armed format from then on."""
    board, decoder = mock.board, mock.decoder
    pacing, velocity = decoder.argument & (schema.WITH_VELOCITY - 1), decoder.argument & schema.WITH_VELOCITY
    board.fault = _refusal(mock, pacing, velocity)
    board.n = 0
    if board.fault != schema.NO_FAULT:
        _say_status(mock, mock.spoken.setup)
        return
    watchdog = decoder.number
    _disarm(mock, schema.ARMED)
    board.pacing = pacing
    board.velocity = 1 if velocity else 0
    board.watchdog = watchdog
    board.answered = board.heard = board.expires = -1
    board.heard_ns = board.sampled_ns = now
    board.lives = math.inf
    board.scale_out_of_range = 0
    mock.gripped = 0
    mock.chance.state = mock.chance.seed
    for register in range(schema.REG_ACCEPTED, schema.REG_LIMITED + 1):
        mock.registers[register] = 0
    decoder.crc_errors = decoder.length_errors = decoder.form_errors = 0
    _say_status(mock, mock.spoken.setup)
    use_framing(decoder, _armed(mock, mock.heard))
    for c in range(mock.channels):
        mock.bodies[c] = mock.initial[c]
        body, converter = mock.bodies[c], mock.converters[c]
        position = first_sample(body, converter)
        _show(mock, c, position, first_velocity(body, converter) if board.velocity else 0.0)
    _say_position(mock, schema.POSITION)


@helper
def _release(mock):
    """As the host says."""
    _disarm(mock, schema.IDLE)
    _say_status(mock, mock.spoken.setup)


@helper
def _disarm(mock, state):
    """Zero force, at once, and the setup format."""
    mock.board.state = state
    for row in range(mock.depth):
        for c in range(mock.channels):
            mock.commands[row, c] = 0.0
    use_framing(mock.decoder, mock.heard.setup)


@helper
def _fail(mock, fault):
    """Latches: the force is zero until the host arms again. The host hears of it in the format that it listens to."""
    mock.board.fault = fault
    mock.board.state = schema.LATCHED
    _say_status(mock, _armed(mock, mock.spoken))
    _disarm(mock, schema.LATCHED)


def take_bytes(mock: Any, data: NDArray[np.uint8], stop: int, now: int) -> None:
    """Bytes data[:stop] of the host arrive at time `now` (ns); at most INPUT_BYTES of them."""
    _take_bytes(address_of(mock), data.ctypes.data, stop, now)


def take_sample(mock: Any, now: int) -> None:
    """The sample that lasts ends at time `now`: moves the bodies through it, measures, tells the host."""
    _take_sample(address_of(mock), now)


def look_at_watchdog(mock: Any, now: int) -> None:
    """Latches the force at zero when the host was quiet for longer than it said it would be."""
    _look_at_watchdog(address_of(mock), now)


def prepare(mock: Any) -> None:
    """Once it is in its place in memory, and before the first event: where the mock is, and what it calls."""
    mock.address = address_of(mock)
    for name, function in FUNCTIONS.items():
        mock.called[name] = function.address()
    mock.called.move = move_of(mock.initial[: mock.channels])
    if not mock.called.take_force:
        mock.called.take_force = mock.called.act_on_force


FUNCTIONS = {
    "take_bytes": _take_bytes,
    "take_sample": _take_sample,
    "look_at_watchdog": _look_at_watchdog,
    "act_on_force": _take_force,
    "read": _read,
    "say": _put_frame,
}
"""By their names in CALLED."""
