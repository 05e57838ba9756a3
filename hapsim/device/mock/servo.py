"""The mock in `mode: admittance`: it follows position commands, and senses the force of the hand that holds it.

Command c[n], decided in sample n, acts from (n + delay) T on. Without a servo the device moves to it in a straight
line, in a sample period. A servo holds it: x'' + 2 z w x' + w² x = w² c, in closed form, as a mass 1/w² with the
friction 2 z/w on a spring of 1 that the command moves. In a sample without a command it goes on at the speed of the
last two; once their time to live is over, it brakes from that speed (PROTOCOL.md, section 6.2).

The hand is a push, a spring, a damper and a mass at the device's position. Its mass feels the second difference of
that, its damper the velocity just before the sample.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from numba import types

from firmware_protocol import schema
from firmware_protocol.description import Servo
from hapsim.compiling import helper
from hapsim.compiling.native import native
from hapsim.device.mock.motion import move_with_spring_or_friction
from hapsim.device.mock.record import mock_at
from hapsim.device.mock.sampler import advance_body, noise, to_counts
from hapsim.loop.buffers import clip
from hapsim.scene.admittance import ServoOfChannel

FAULTS = ("none", "dead", "inverted")
"""Faults of a force sensor, by their codes."""
DEAD, INVERTED = 1, 2


@native(types.void, types.uint64)
def _begin(mock):
    """Begins at rest where the first position was measured, with that as the command."""
    mock = mock_at(mock)
    for c in range(mock.channels):
        place = mock.counts[c] * mock.converters[c].quantum
        mock.commands[: mock.depth, c] = place
        servo, body, sensor = mock.servos[c], mock.bodies[c], mock.force_sensors[c]
        servo.position, servo.velocity = body.position, body.velocity
        sensor.position = sensor.before = body.position
        sensor.state = sensor.seed
        _sense(mock, c, 0)


@native(types.int64, types.uint64)
def _take(mock):
    """Takes the commands of a FORCE for the current sample. One that asks for more than the largest speed is shortened
    and counted."""
    mock = mock_at(mock)
    n = mock.board.n
    for c in range(mock.channels):
        before = mock.commands[(n - 1) % mock.depth, c]
        way = mock.decoder.counts[mock.channels + c] * mock.converters[c].quantum - before
        most = mock.longest_way[c]
        if abs(way) > most:
            mock.registers[schema.REG_LIMITED] += 1
            way = math.copysign(most, way)
        mock.commands[n % mock.depth, c] = before + way
    return 1


@native(types.void, types.uint64, types.float64, types.float64)
def _advance(mock, acts, h):  # noqa: ARG001  no host paces a device with commands, and they act through the sample
    """Moves the bodies through a sample of `h` seconds."""
    mock = mock_at(mock)
    for c in range(mock.channels):
        body, converter, servo = mock.bodies[c], mock.converters[c], mock.servos[c]
        if mock.board.accepted != mock.board.n:
            _go_on(mock, c, mock.board.n)
        if servo.mass > 0.0:
            advance_body(mock.called.move_servo, servo, converter, mock.commands, mock.depth, c, mock.board.n, h)
            body.position, body.velocity = servo.position, servo.velocity
        else:
            newest, share = mock.board.n - converter.whole_delay, mock.late_share
            old, new = mock.commands[(newest - 1) % mock.depth, c], mock.commands[newest % mock.depth, c]
            body.position, body.velocity = new + share * (old - new), (new - old) / h
        _sense(mock, c, mock.board.n + 1)


@helper
def _go_on(mock, c, n):
    """Sets the command of sample n, in which none came."""
    last = mock.commands[(n - 1) % mock.depth, c]
    way = last - mock.commands[(n - 2) % mock.depth, c]
    if n > mock.board.expires:
        way = math.copysign(max(abs(way) - mock.braking_way[c], 0.0), way)
    mock.commands[n % mock.depth, c] = last + way


@helper
def _sense(mock, c, n):
    """Puts the force of a channel's hand on the handle into the frame of sample n, behind the motion. The sensor shows
    no more than its range."""
    body, sensor = mock.bodies[c], mock.force_sensors[c]
    acceleration = (body.position - 2.0 * sensor.position + sensor.before) / mock.converters[c].period ** 2
    sensor.before, sensor.position = sensor.position, body.position
    force = body.push - body.stiffness * body.position - body.friction * body.velocity - body.mass * acceleration
    faulty = sensor.fault if n >= sensor.fault_sample else 0
    shown = (-force if faulty == INVERTED else force) + sensor.offset + sensor.drift * n + noise(sensor, sensor.noise)
    if faulty != DEAD:
        sensor.counts, _ = to_counts(clip(shown, sensor.range), sensor.quantum)
    parts = mock.board.parts
    motions = 1 + (parts & schema.WITH_VELOCITY != 0) + (parts & schema.WITH_ACCELERATION != 0)
    mock.counts[motions * mock.channels + c] = sensor.counts


FUNCTIONS = {
    "begin_following": _begin,
    "take_followed": _take,
    "advance_following": _advance,
    "move_servo": move_with_spring_or_friction,
}
"""Functions by their names in CALLED."""


def follow_commands(
    mock: Any, servos: Sequence[ServoOfChannel | None], servo: Servo, *, rate: float, delay: float
) -> None:
    """Lets a MOCK follow commands when it is armed so. `servos`: of each channel, as simulated. `servo`: as described.
    `delay`: in samples. Sampler and converters are set."""
    for name, function in FUNCTIONS.items():
        mock.called[name] = function.address()
    mock.late_share, mock.depth = delay % 1.0, max(int(mock.depth), math.floor(delay) + 3)
    for c, one in enumerate(servos):
        if one is not None:
            natural = 2.0 * math.pi * one.bandwidth
            mock.servos[c].mass, mock.servos[c].friction = 1.0 / natural**2, 2.0 * one.damping / natural
            mock.servos[c].stiffness = 1.0
        mock.longest_way[c] = servo.speed_limit[c] / rate + mock.converters[c].quantum
        mock.braking_way[c] = servo.braking[c] / rate**2
