"""The mock's firmware, compiled: it handles the protocol's bytes as a microcontroller does.

It is a state machine of three events: bytes arrived (`take_bytes`), a sample is due (`take_sample`), the watchdog is
checked (`check_watchdog`). Its answers go to its outbox. Each event is called by its address, so that the mock in
memory and the one on a pseudo-terminal share compiled code.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.decoder import next_frame, use_framing
from firmware_protocol.frames import write_frame
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import address_in_memory, address_of, native
from hapsim.device.mock.motion import move_of
from hapsim.device.mock.record import (
    KEPT_REPORTS,
    LONGEST_ANSWER,
    MOST_LATE,
    bytes_at,
    call_advance,
    call_event,
    call_for_all,
    call_put_frame,
    call_read,
    call_take,
    framing_at,
    mock_at,
)
from hapsim.device.mock.sampler import (
    advance_body,
    advance_together,
    first_acceleration,
    first_sample,
    first_velocity,
    release_body,
    sample,
    sample_acceleration,
    sample_velocity,
    to_counts,
    uniform,
)
from hapsim.device.mock.transmission import advance_drive, begin_drive, saturated

_FOLLOWED = schema.WITH_LINE | schema.WITH_COMMANDS  # in place of forces
_LOCKSTEP_PATIENCE_NS = 10_000_000_000  # twice what hapsim waits for a position: the host is gone


@native(types.int64, types.uint64, types.uint64, types.int64, types.int64)
def _read(mock, data, start, stop):
    """Decodes the next frame in data[start:stop]. Returns its end; -1 if there is none."""
    at, found = next_frame(mock_at(mock).decoder, bytes_at(data, stop), start, stop)
    return at if found else -1


@native(types.void, types.uint64, types.uint64, types.int64, types.int64)
def _put_frame(mock, framing, kind, number):
    """Puts a frame with the counts into the outbox. A full outbox drops it, as a wire does."""
    mock = mock_at(mock)
    if mock.board.out + LONGEST_ANSWER <= mock.outbox.size:
        framing = framing_at(framing)
        mock.board.out = write_frame(framing, mock.outbox, mock.board.out, kind, number, 0, mock.counts)


@native(types.void, types.uint64, types.uint64, types.int64, types.int64)
def _take_bytes(mock, data, stop, now):
    mock, at = mock_at(mock), 0
    while True:
        at = call_read(mock.called.read, (mock.address, data, at, stop))
        if at < 0:
            return
        kind, armed = mock.decoder.type, mock.board.state == schema.ARMED
        if kind == schema.DISARM:
            disarm(mock, schema.IDLE)
            _put_status(mock, mock.mock_formats.setup)
        elif kind == schema.FORCE and armed:
            call_event(mock.called.take_force, (mock.address, now))
        elif kind == schema.DESCRIBE and not armed:
            _describe(mock)
        elif kind == schema.ARM and not armed:
            _arm(mock, now)


@native(types.void, types.uint64, types.float64, types.float64)
def _advance_each(mock, acts, h):
    """Moves each body by itself through a sample of `h` seconds, in the first `acts` of which commanded forces act."""
    mock = mock_at(mock)
    for c in range(mock.channels):
        body, converter = mock.bodies[c], mock.converters[c]
        advance_body(mock.called.move, body, converter, mock.commands, mock.depth, c, mock.board.n, acts)
        if acts < h:
            release_body(mock.called.move, body, converter, h - acts)


@native(types.void, types.uint64, types.float64, types.float64)
def advance_coupled(mock, acts, h):
    """Moves the bodies together, as `_advance_each` does each of them: their mass is a matrix."""
    mock = mock_at(mock)
    coupling, converters, n = mock.coupling, mock.converters, mock.board.n
    advance_together(mock.bodies, mock.channels, coupling, converters, mock.commands, mock.depth, n, acts, h)


@native(types.void, types.uint64, types.float64, types.float64)
def advance_driven(mock, acts, h):
    """Moves each body by itself, as `_advance_each` does, behind its motor and transmission."""
    mock = mock_at(mock)
    commands, depth, n = mock.commands, mock.depth, mock.board.n
    for c in range(mock.channels):
        drive, body = mock.drives[c], mock.bodies[c]
        if n == 0:
            begin_drive(drive, body)
        if mock.board.accepted == n:  # else the command before goes on, saturated already
            commands[n % depth, c] = saturated(drive, commands[n % depth, c])
        advance_drive(drive, body, mock.converters[c], commands, depth, c, n, acts, h)


@native(types.void, types.uint64, types.int64)
def _take_sample(mock, now):
    """Ends the current sample: moves the bodies through it and sends their positions."""
    mock = mock_at(mock)
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
    advance = mock.called.advance_following if board.parts & _FOLLOWED else mock.called.advance
    call_advance(advance, (mock.address, acts, h))
    for c in range(mock.channels):
        body, converter = mock.bodies[c], mock.converters[c]
        _put_position_of(mock, c, sample(body, converter, h))
        if board.parts & schema.WITH_VELOCITY:
            _put_velocity_of(mock, c, sample_velocity(body, converter, h))
    if acts < h:  # the time to live also ends the commands that have not acted yet
        for row in range(mock.depth):
            if row != board.n % mock.depth:
                mock.commands[row, :] = 0.0
    board.n += 1
    if board.parts & schema.WITH_ACCELERATION:
        for c in range(mock.channels):
            body, converter = mock.bodies[c], mock.converters[c]
            _put_acceleration_of(mock, c, sample_acceleration(body, converter, mock.commands, mock.depth, c, board.n))
    if board.parts & schema.WITH_WORDS:
        mock.outputs = board.outputs
        _put_inputs(mock)
    _put_position(mock, schema.POSITION if fresh else schema.POSITION_HELD)


@native(types.void, types.uint64, types.int64)
def _check_watchdog(mock, now):
    """Latches if the host is quiet for too many samples; in lockstep, where it makes them, for too long a time."""
    mock = mock_at(mock)
    board = mock.board
    quiet, most = board.n - board.accepted, board.watchdog
    if board.pacing == schema.LOCKSTEP:
        quiet, most = now - board.accepted_ns, _LOCKSTEP_PATIENCE_NS
    elif board.pacing == schema.PACED_BY_HOST:
        quiet = np.int64((now - board.accepted_ns) * 1e-9 / mock.converters[0].period)
    if board.state == schema.ARMED and quiet > most:
        _fail(mock, schema.HOST_QUIET)


@native(types.void, types.uint64, types.int64)
def _take_force(mock, now):
    """Commands a force for the current sample, unless it is older than its time to live."""
    mock = mock_at(mock)
    board = mock.board
    age = (board.n - mock.decoder.number) % schema.SAMPLE_MODULUS
    follows = board.parts & _FOLLOWED
    if age > mock.decoder.argument or (board.parts & schema.WITH_LINE and age >= KEPT_REPORTS):
        mock.registers[schema.REG_EXPIRED] += 1
        return
    if follows and not call_take(mock.called.take_followed, (mock.address,)):
        return
    board.answered = board.n - age
    board.expires = board.answered + mock.decoder.argument
    board.accepted = board.n
    board.accepted_ns = now
    mock.registers[schema.REG_ACCEPTED] += 1
    for c in range(0 if follows else mock.channels):
        force = mock.decoder.counts[c] * mock.force_scale[c]
        if abs(force) > mock.force_limit[c]:
            mock.registers[schema.REG_LIMITED] += 1
            force = mock.force_limit[c] if force > 0.0 else -mock.force_limit[c]
        mock.commands[board.n % mock.depth, c] = force
    if board.parts & schema.WITH_WORDS:
        board.outputs = mock.decoder.counts[np.uint64(mock.decoder.framing.words - 1)] & 0xFFFFFFFF
    if board.pacing != schema.PACED_BY_DEVICE:
        call_event(mock.called.take_sample, (mock.address, now))
        board.lives = (mock.decoder.argument + 1) * mock.converters[0].period


@native(types.void, types.uint64, types.int64)
def take_late_force(mock, now):
    """Puts a force on a wire longer than a sample, in virtual time, and acts on the one sent `late_samples` before. If
    none arrives, the sample ends without a force."""
    address, mock = mock, mock_at(mock)
    board, decoder, n = mock.board, mock.decoder, mock.board.n
    if board.pacing != schema.LOCKSTEP:
        call_event(mock.called.act_on_force, (address, now))
        return
    _copy_force(decoder, mock.under_way[n % (MOST_LATE + 1)])
    missed = mock.chance.share > 0.0 and uniform(mock.chance) <= mock.chance.share
    if n >= mock.late_samples and not missed:
        _copy_force(mock.under_way[(n - mock.late_samples) % (MOST_LATE + 1)], decoder)
        call_event(mock.called.act_on_force, (address, now))
    if board.n == n and board.state == schema.ARMED:
        call_event(mock.called.take_sample, (address, now))


@inlined
def _copy_force(source, target):
    target.number = source.number
    target.argument = source.argument
    for i in range(schema.MAX_WORDS):
        target.counts[i] = source.counts[i]


@helper
def _decide_command(mock):
    """Sets the command of the current sample. Returns whether the force that answers it arrived in time.

    Without one, a held force continues until its time to live ends; an impulse is given once.
    """
    board = mock.board
    row, before = board.n % mock.depth, (board.n - 1) % mock.depth
    if board.accepted == board.n and board.answered == board.n:
        return True
    mock.registers[schema.REG_HELD] += 1
    if board.accepted == board.n:
        return False
    lives = board.n <= board.expires and mock.converters[0].keeps_last_force
    for c in range(mock.channels):
        mock.commands[row, c] = mock.commands[before, c] if lives else 0.0
    return False


@helper
def _put_position_of(mock, channel, position):
    """Puts a channel's position, in m, into the next frame. One beyond the scale is a fault."""
    mock.counts[channel], fits = to_counts(position, mock.converters[channel].quantum)
    if not fits:
        mock.board.scale_out_of_range = 1


@helper
def _put_velocity_of(mock, channel, velocity):
    """Puts a channel's velocity, in m/s, into the next frame. One beyond the scale saturates."""
    mock.counts[mock.channels + channel], _ = to_counts(velocity, mock.converters[channel].velocity_quantum)


@helper
def _put_acceleration_of(mock, channel, acceleration):
    """Puts a channel's acceleration, in m/s², into the next frame. One beyond the scale saturates."""
    first = 2 * mock.channels if mock.board.parts & schema.WITH_VELOCITY else mock.channels
    mock.counts[first + channel], _ = to_counts(acceleration, mock.converters[channel].acceleration_quantum)


@helper
def _put_inputs(mock):
    """Puts the input word of the current sample into the next frame, behind everything else."""
    while mock.board.n == mock.flips[mock.flipped].sample:
        mock.inputs ^= mock.flips[mock.flipped].inputs
        mock.flipped += 1
    mock.counts[np.uint64(_armed(mock, mock.mock_formats).words - 1)] = mock.inputs ^ mock.switched


@inlined
def _armed(mock, formats):
    return formats.armed[mock.board.parts]


@inlined
def _put(mock, framing, kind, number):
    call_put_frame(mock.called.put_frame, (mock.address, address_in_memory(framing), kind, number))


@helper
def _put_position(mock, kind):
    if mock.board.scale_out_of_range:
        _fail(mock, schema.POSITION_OUT_OF_RANGE)
    else:
        _put(mock, _armed(mock, mock.mock_formats), kind, mock.board.n % schema.SAMPLE_MODULUS)


@helper
def _put_status(mock, framing):
    mock.counts[:] = 0
    mock.counts[0] = mock.board.state | (mock.board.fault << 8)
    _put(mock, framing, schema.STATUS, mock.board.n % schema.SAMPLE_MODULUS)


@helper
def _describe(mock):
    """Answers with one register; an unknown register reads 0."""
    number, decoder = mock.decoder.number, mock.decoder
    mock.registers[schema.REG_FAULT] = mock.board.fault
    mock.registers[schema.REG_REJECTED] = decoder.crc_errors + decoder.length_errors + decoder.form_errors
    mock.counts[:] = 0
    mock.counts[0] = mock.registers[number] & 0xFFFFFFFF if number < mock.registers.size else 0
    _put(mock, mock.mock_formats.setup, schema.DESCRIPTION, number)


@helper
def _refusal(mock, pacing, parts):
    """Returns the fault that prevents arming, or NO_FAULT."""
    if mock.decoder.counts[0] & 0xFFFFFFFF != schema.SCHEMA_HASH:
        return schema.WRONG_SCHEMA
    if pacing > schema.LOCKSTEP or not mock.registers[schema.REG_PACINGS] >> pacing & 1:
        return schema.WRONG_PACING
    if parts & _FOLLOWED and pacing == schema.PACED_BY_HOST:
        return schema.WRONG_PACING
    if parts & ~mock.offered or mock.mock_formats.armed[parts].words == 0:
        return schema.WRONG_SENSING
    if not 1 <= mock.decoder.number <= mock.registers[schema.REG_MAX_WATCHDOG]:
        return schema.WRONG_WATCHDOG
    return schema.NO_FAULT


@helper
def _arm(mock, now):
    """Arms: begins at sample 0 from the initial state, sends STATUS, and then uses the armed format."""
    board, decoder = mock.board, mock.decoder
    pacing, parts = decoder.argument & ~schema.PART_BITS, decoder.argument & schema.PART_BITS
    board.fault = _refusal(mock, pacing, parts)
    board.n = 0
    if board.fault != schema.NO_FAULT:
        _put_status(mock, mock.mock_formats.setup)
        return
    disarm(mock, schema.ARMED)
    board.pacing = pacing
    board.parts = parts
    board.watchdog = decoder.number
    board.answered = board.accepted = board.expires = -1
    board.accepted_ns = board.sampled_ns = now
    board.lives = math.inf
    board.scale_out_of_range = 0
    mock.gripped = mock.flipped = 0
    mock.inputs = mock.first_inputs
    mock.chance.state = mock.chance.seed
    for register in range(schema.REG_ACCEPTED, schema.REG_LIMITED + 1):
        mock.registers[register] = 0
    decoder.crc_errors = decoder.length_errors = decoder.form_errors = 0
    _put_status(mock, mock.mock_formats.setup)
    use_framing(decoder, _armed(mock, mock.host_formats))
    for c in range(mock.channels):
        mock.bodies[c] = mock.initial[c]
        body, converter = mock.bodies[c], mock.converters[c]
        _put_position_of(mock, c, first_sample(body, converter))
        if parts & schema.WITH_VELOCITY:
            _put_velocity_of(mock, c, first_velocity(body, converter))
        if parts & schema.WITH_ACCELERATION:
            _put_acceleration_of(mock, c, first_acceleration(body, converter))
    if parts & _FOLLOWED:
        call_for_all(mock.called.begin_following, (mock.address,))
    if parts & schema.WITH_WORDS:
        _put_inputs(mock)
    _put_position(mock, schema.POSITION)


@helper
def disarm(mock, state):
    """Sets every force and output to zero at once, and expects the setup format."""
    mock.board.state = state
    mock.board.outputs = mock.outputs = 0
    mock.commands[: mock.depth] = 0.0
    mock.follower.under_way[: mock.follower.delay + 1] = 0
    use_framing(mock.decoder, mock.host_formats.setup)


@helper
def _fail(mock, fault):
    """Latches: the force is zero until the host arms again. Sends the STATUS in the armed format."""
    mock.board.fault = fault
    mock.board.state = schema.LATCHED
    _put_status(mock, _armed(mock, mock.mock_formats))
    disarm(mock, schema.LATCHED)


def take_bytes(mock: Any, data: NDArray[np.uint8], stop: int, now: int) -> None:
    """Handles the host's bytes data[:stop], at most INPUT_BYTES, at time `now` (ns)."""
    _take_bytes(address_of(mock), data.ctypes.data, stop, now)


def take_sample(mock: Any, now: int) -> None:
    """Ends the current sample at time `now` (ns): moves the bodies through it and sends their positions."""
    _take_sample(address_of(mock), now)


def check_watchdog(mock: Any, now: int) -> None:
    """Latches the force at zero if the host has been quiet for longer than its watchdog allows. `now`: ns."""
    _check_watchdog(address_of(mock), now)


FUNCTIONS = {
    "advance": _advance_each,
    "take_bytes": _take_bytes,
    "take_sample": _take_sample,
    "check_watchdog": _check_watchdog,
    "act_on_force": _take_force,
    "read": _read,
    "put_frame": _put_frame,
}
"""Functions by their names in CALLED."""


def prepare(mock: Any) -> None:
    """Sets the addresses in a mock before its first event. The mock must then stay at its place in memory."""
    mock.address = address_of(mock)
    for name, function in (FUNCTIONS | {"take_force": FUNCTIONS["act_on_force"]}).items():
        if not mock.called[name]:  # else another function wraps it
            mock.called[name] = function.address()
    mock.called.move = move_of(mock.initial[: mock.channels])
