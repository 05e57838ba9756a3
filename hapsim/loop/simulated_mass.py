"""The simulated mass of `mode: admittance` in an exchange: the hand's force moves it, and the device follows it.

    M (X[n+1] - 2 X[n] + X[n-1])/T² = f[n] + F[n] - B (X[n] - X[n-1])/T

X[n] is the device point's position. The scene finds its hand there, and not where the device reports it: the device
gets there later. f is the sensed force of the hand, F the scene's force after its guards, X[n+1] the command in the
answer to sample n.

**The mass moves as the device does** (PROTOCOL.md, section 6.2). In a sample without a new command the device goes on
at the speed of the last two, and brakes once the time to live is over. So does the mass over lost positions, and where
the host was held up: the next command goes on from the one that the device has. A device whose positions come too late
to be answered accepts no command and brakes: the mass begins anew, at rest, where it reports to be.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Servo
from hapsim.compiling.native import array_at, record_at
from hapsim.loop.buffers import clip
from hapsim.loop.hooks import Hook, Stage, hook, io_at, tick_at
from hapsim.scene import Scene

_EACH = (schema.MAX_CHANNELS,)
_MOST_COUNTS = 2.0**31 - 1.0

ADMITTANCE = np.dtype(
    [
        ("mobility", np.float64, _EACH),  # T²/M, m/N
        ("loss", np.float64, _EACH),  # B T/M: the share of a step that damping takes
        ("place", np.float64, _EACH),  # X[n], m
        ("before", np.float64, _EACH),  # X[n-1], m
        ("braking", np.float64, _EACH),  # m, by which a step shrinks in a sample of braking
        ("lives", np.int64),  # samples that the device goes on without a new command
        ("since", np.int64),  # samples since the position that the last command answered
    ],
    align=True,
)
"""The simulated mass of each channel."""

admittance_at, _words_at = record_at(ADMITTANCE), array_at(np.int64)


@hook
def place_masses(own, tick):
    """Puts the scene's hands where the simulated masses are. Those begin at rest where the device is."""
    own, tick = admittance_at(own), tick_at(tick)
    io = io_at(tick.io)
    own.since = tick.gap + (own.since if tick.unsent else 0)
    braked = min(max(own.since - own.lives, 0), tick.gap)
    for c in range(np.uint64(io.channels)):
        if tick.number == 0 or tick.withheld:
            own.place[c] = own.before[c] = io.measured[c]
        else:
            step = (own.place[c] - own.before[c]) if tick.unsent else (io.command[c] - own.place[c])
            own.place[c] += (tick.gap - braked) * step
            for _ in range(braked):
                step = math.copysign(max(abs(step) - own.braking[c], 0.0), step)
                own.place[c] += step
            own.before[c] = own.place[c] - step
        io.measured[c] = own.place[c]
    return 0


@hook
def advance_masses(own, tick):
    """Moves the masses by a step, into `io.command`. What keeps a command within its limits comes after this."""
    own, tick = admittance_at(own), tick_at(tick)
    io = io_at(tick.io)
    for c in range(np.uint64(io.channels)):
        step = own.place[c] - own.before[c]
        force = io.hand_force[c] + io.force_counts[c] * io.force_scale[c]
        io.command[c] = own.place[c] + (step - own.loss[c] * step + own.mobility[c] * force)
    return 0


@hook
def write_commands(own, tick):  # noqa: ARG001  a hook
    """Rounds the commands to counts, of the device's zero on the wire, and puts them into the answer."""
    io = io_at(tick_at(tick).io)
    payload = _words_at(io.payload, schema.MAX_WORDS)
    for c in range(np.uint64(io.channels)):
        counts = np.rint(io.command[c] / io.position_scale[c]) + io.origin_counts[c]
        word = np.int64(clip(counts, _MOST_COUNTS))
        payload[np.uint64(io.channels) + c] = word
        io.command_counts[c] = word - io.origin_counts[c]
    return 0


def admittance_hooks(loop: Any, scene: Scene, servo: Servo) -> tuple[list[Hook], list[Hook]]:
    """Fills the ADMITTANCE of a LOOP whose `control` is set. `servo`: the device's. Returns its hooks before and behind
    those of the guards: a guard of Stage.KEEP may change `io.command`."""
    own, channels = loop.admittance, scene.channels
    own.braking[:channels] = np.array(servo.braking[:channels]) * scene.period**2
    own.lives = loop.control.time_to_live + 1
    masses = np.array(scene.device.masses(channels))
    own.mobility[:channels] = scene.period**2 / masses
    own.loss[:channels] = np.array(scene.device.frictions(channels)) * scene.period / masses
    last = [Hook(Stage.SHAPE, advance_masses, own), Hook(Stage.KEEP, write_commands, own)]
    return [Hook(Stage.PREDICT, place_masses, own)], last
