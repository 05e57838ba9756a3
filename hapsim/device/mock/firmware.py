"""The mock's firmware: what a microcontroller would do with the bytes of the protocol, compiled.

It is a state machine of three events: bytes arrived (`take_bytes`), a sample is due (`take_sample`), nothing was heard
for too long (`look_at_watchdog`). What it wants to send stands in its outbox.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.decoder import next_frame, use_format
from firmware_protocol.frames import SETUP, Format, write_to_host
from hapsim.compiled import jit, part
from hapsim.device.mock.sampler import (
    advance_body,
    first_sample,
    first_velocity,
    sample,
    sample_velocity,
    to_counts,
)

OUTBOX_BYTES = 65536
INPUT_BYTES = 4096  # at most this many go into `take_bytes` at once: the answers to them fit the outbox
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
        ("out", np.int64),  # bytes in the outbox
        ("scale_out_of_range", np.int64),
    ]
)


class Mock(NamedTuple):
    """The whole mock: its bodies (one per channel), converters, history of commands, registers and bytes.

    `counts`: what a frame carries, the positions of all channels and then their velocities.
    """

    bodies: NDArray[np.void]
    initial: NDArray[np.void]
    converters: NDArray[np.void]
    commands: NDArray[np.float64]
    force_scale: NDArray[np.float64]
    force_limit: NDArray[np.float64]
    counts: NDArray[np.int64]
    registers: NDArray[np.int64]
    decoder: np.void
    board: np.void
    armed: Format
    armed_with_velocity: Format
    outbox: NDArray[np.uint8]


@jit
def take_bytes(mock, data, stop, now):
    """Bytes data[:stop] of the host arrive at time `now` (ns); at most INPUT_BYTES of them."""
    at = 0
    while True:
        at, found = next_frame(mock.decoder, data, at, stop)
        if not found:
            return
        kind = mock.decoder.type
        if kind == schema.FORCE:
            if mock.board.state == schema.ARMED:
                _take_force(mock, now)
        elif kind == schema.DESCRIBE:
            if mock.board.state != schema.ARMED:
                _describe(mock)
        elif kind == schema.ARM:
            if mock.board.state != schema.ARMED:
                _arm(mock, now)
        else:
            _disarm(mock, schema.IDLE)
            _say_status(mock, SETUP)


@jit
def take_sample(mock, now):
    """The sample that lasts ends at time `now`: move the bodies through it, measure, tell the host."""
    board = mock.board
    h = mock.converters[0].period
    if board.pacing == schema.PACED_BY_HOST:
        h = max((now - board.sampled_ns) * 1e-9, 1e-9)
    board.sampled_ns = now
    fresh = _decide_command(mock)
    for c in range(mock.bodies.size):
        advance_body(mock.bodies[c], mock.converters[c], mock.commands, c, board.n, h)
        _show_position(mock, c, sample(mock.bodies[c], mock.converters[c], h))
        if board.velocity:
            _show_velocity(mock, c, sample_velocity(mock.bodies[c], mock.converters[c], h))
    board.n += 1
    _say_position(mock, schema.POSITION if fresh else schema.POSITION_HELD)


@jit
def look_at_watchdog(mock, now):
    """Latches the force at zero when the host was quiet for longer than it said it would be."""
    if mock.board.state == schema.ARMED and _host_is_quiet(mock, now):
        _fail(mock, schema.HOST_QUIET)


@part
def _host_is_quiet(mock, now):
    """The watchdog counts samples. Virtual time has none while the host is quiet: there only a real wait tells."""
    board = mock.board
    if board.pacing == schema.LOCKSTEP:
        return now - board.heard_ns > _LOCKSTEP_PATIENCE_NS
    quiet = board.n - board.heard
    if board.pacing == schema.PACED_BY_HOST:
        quiet = np.int64((now - board.heard_ns) * 1e-9 / mock.converters[0].period)
    return quiet > board.watchdog


@part
def _take_force(mock, now):
    """A force arrives: it is commanded for the sample that lasts, unless it is older than it may be."""
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
    for c in range(mock.bodies.size):
        force = mock.decoder.counts[c] * mock.force_scale[c]
        if abs(force) > mock.force_limit[c]:
            mock.registers[schema.REG_LIMITED] += 1
            force = min(max(force, -mock.force_limit[c]), mock.force_limit[c])
        mock.commands[board.n % mock.commands.shape[0], c] = force
    if board.pacing != schema.PACED_BY_DEVICE:
        take_sample(mock, now)


@part
def _decide_command(mock):
    """Settles the command of the sample that lasts; whether the force that answers it arrived in time.

    Without one, a held force goes on until its time to live is over. An impulse is given once and never again.
    """
    board = mock.board
    row = board.n % mock.commands.shape[0]
    before = (board.n - 1) % mock.commands.shape[0]
    if board.heard == board.n and board.answered == board.n:
        return True
    mock.registers[schema.REG_HELD] += 1
    if board.heard == board.n:
        return False
    lives = board.n <= board.expires and not mock.converters[0].impulse
    for c in range(mock.bodies.size):
        mock.commands[row, c] = mock.commands[before, c] if lives else 0.0
    return False


@part
def _show_position(mock, channel, position):
    counts, fits = to_counts(position, mock.converters[channel].quantum)
    mock.counts[channel] = counts
    if not fits:
        mock.board.scale_out_of_range = 1


@part
def _show_velocity(mock, channel, velocity):
    """One that does not fit stands at the end of its scale: no fault."""
    counts, _ = to_counts(velocity, mock.converters[channel].velocity_quantum)
    mock.counts[mock.bodies.size + channel] = counts


@part
def _armed_format(mock):
    return mock.armed_with_velocity if mock.board.velocity else mock.armed


@part
def _say(mock, wire, kind, number, counts):
    """Puts a frame into the outbox. What nobody fetches is lost once the outbox is full, as on a line."""
    if mock.board.out + _LONGEST_ANSWER <= mock.outbox.size:
        mock.board.out = write_to_host(wire, mock.outbox, mock.board.out, kind, number, counts)


@part
def _say_position(mock, kind):
    if mock.board.scale_out_of_range:
        _fail(mock, schema.POSITION_OUT_OF_RANGE)
    else:
        _say(mock, _armed_format(mock), kind, mock.board.n % schema.SAMPLE_MODULUS, mock.counts)


@part
def _say_status(mock, wire):
    counts = mock.counts
    counts[:] = 0
    counts[0] = mock.board.state | (mock.board.fault << 8)
    _say(mock, wire, schema.STATUS, mock.board.n % schema.SAMPLE_MODULUS, counts)


@part
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
    _say(mock, SETUP, schema.DESCRIPTION, number, mock.counts)


@part
def _refusal(mock):
    """Why the device does not arm, or NO_FAULT."""
    if mock.decoder.counts[0] & 0xFFFFFFFF != schema.SCHEMA_HASH:
        return schema.WRONG_SCHEMA
    pacing = _pacing_asked(mock)
    if pacing > schema.LOCKSTEP or not mock.registers[schema.REG_PACINGS] >> pacing & 1:
        return schema.WRONG_PACING
    if _velocity_asked(mock) and not mock.converters[0].velocity_quantum > 0.0:
        return schema.WRONG_SENSING
    if not 1 <= mock.decoder.number <= mock.registers[schema.REG_MAX_WATCHDOG]:
        return schema.WRONG_WATCHDOG
    return schema.NO_FAULT


@part
def _pacing_asked(mock):
    return mock.decoder.argument & (schema.WITH_VELOCITY - 1)


@part
def _velocity_asked(mock):
    return mock.decoder.argument & schema.WITH_VELOCITY != 0


@part
def _arm(mock, now):
    """Begins at sample 0, from the initial state; says so, and speaks the armed format from then on."""
    board = mock.board
    board.fault = _refusal(mock)
    board.n = 0
    if board.fault != schema.NO_FAULT:
        _say_status(mock, SETUP)
        return
    board.state = schema.ARMED
    board.pacing = _pacing_asked(mock)
    board.velocity = 1 if _velocity_asked(mock) else 0
    board.watchdog = mock.decoder.number
    board.answered = board.heard = board.expires = -1
    board.heard_ns = board.sampled_ns = now
    board.scale_out_of_range = 0
    mock.commands[:] = 0.0
    mock.registers[schema.REG_ACCEPTED : schema.REG_LIMITED + 1] = 0
    mock.decoder.crc_errors = mock.decoder.length_errors = mock.decoder.form_errors = 0
    _say_status(mock, SETUP)
    use_format(mock.decoder, _armed_format(mock))
    for c in range(mock.bodies.size):
        mock.bodies[c] = mock.initial[c]
        _show_position(mock, c, first_sample(mock.bodies[c], mock.converters[c]))
        if board.velocity:
            _show_velocity(mock, c, first_velocity(mock.bodies[c], mock.converters[c]))
    _say_position(mock, schema.POSITION)


@part
def _disarm(mock, state):
    """Zero force, at once, and the setup format."""
    mock.board.state = state
    mock.commands[:] = 0.0
    use_format(mock.decoder, SETUP)


@part
def _fail(mock, fault):
    """Latches: the force is zero until the host arms again. The host is told in the format that it listens to."""
    mock.board.fault = fault
    mock.board.state = schema.LATCHED
    _say_status(mock, _armed_format(mock))
    _disarm(mock, schema.LATCHED)
