"""One sample of the scene: positions in, forces out, masses moved."""

from __future__ import annotations

from hapsim.compiled import inlined, jit_inlined
from hapsim.cordis.acting import move_all, pull_all, settle_all
from hapsim.cordis.device_point import felt, follow
from hapsim.cordis.ground import settle
from hapsim.cordis.moment import at_hand, moment_of, pass_on, registers_for


@jit_inlined
def start(program, measured):
    """Puts the device points where the hand is, at rest, so that the first tick feels no jump."""
    moment = moment_of(program, measured)
    follow(program.devices, measured, moment.position)
    follow(program.devices, measured, moment.previous)
    settle_all(program.parts, moment)


@inlined
def settle_grounds(program):
    """After parameters moved, before the tick: grounds go where they are told."""
    settle(program.grounds, moment_of(program, None))


@jit_inlined
def tick(program, measured, velocity, force):
    """Moves the scene by one sample.

    `measured`: the device's positions in m, one per channel. `velocity`: those that it senses in m/s, 0 where it does
    not. `force`: receives the force in N on each channel that the scene uses.
    """
    moment = at_hand(program, velocity, registers_for(program))
    follow(program.devices, measured, moment.position)
    pull_all(program.parts, moment)
    felt(program.devices, moment.force, force)
    move_all(program.parts, moment)
    pass_on(program, moment)
