"""The simulated mass of `mode: admittance` in an exchange: the hand's force moves it, and the device follows it.

    M (X[n+1] - 2 X[n] + X[n-1])/T² = f[n] + F[n] - B (X[n] - X[n-1])/T

X[n] is the device point's position. The scene finds its hand there, and not where the device reports it: the device
gets there later. f is the sensed force of the hand, F the scene's force after its guards, X[n+1] the command in the
answer to sample n.

**The mass moves as the device does** (PROTOCOL.md, section 6.2). In a sample without a new command the device goes on
at the speed of the last two. So does the mass over lost positions, and where an answer was overtaken. Once the time to
live of the last command is over, the device has braked to rest: the mass begins anew where the device reports to be.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol import schema
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
    for c in range(np.uint64(io.channels)):
        if tick.number == 0 or tick.expired or tick.withheld:
            own.place[c] = own.before[c] = io.measured[c]
        else:
            last = own.place[c]
            step = (last - own.before[c]) if tick.unsent else (io.command[c] - last)
            own.place[c], own.before[c] = last + tick.gap * step, last + (tick.gap - 1) * step
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


def admittance_hooks(loop: Any, scene: Scene) -> tuple[list[Hook], list[Hook]]:
    """Fills the ADMITTANCE of a LOOP. Returns its hooks before and behind those of the guards: a guard of Stage.KEEP
    may change `io.command`."""
    own, channels = loop.admittance, scene.channels
    masses = np.array(scene.device.masses(channels))
    own.mobility[:channels] = scene.period**2 / masses
    own.loss[:channels] = np.array(scene.device.frictions(channels)) * scene.period / masses
    last = [Hook(Stage.SHAPE, advance_masses, own), Hook(Stage.KEEP, write_commands, own)]
    return [Hook(Stage.PREDICT, place_masses, own)], last
