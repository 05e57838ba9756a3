"""One sample of the scene: positions in, forces out, masses moved."""

from __future__ import annotations

from hapsim.compiled import jit_inlined
from hapsim.cordis.damper_backward import pull_backward
from hapsim.cordis.damper_centred import pull_centred, settle_centred
from hapsim.cordis.damper_filtered import pull_filtered, settle_filtered
from hapsim.cordis.damper_sensed import pull_sensed
from hapsim.cordis.device_point import felt, follow, place
from hapsim.cordis.mass import advance


@jit_inlined
def start(program, measured):
    """Puts the device points where the hand is, at rest, so that the first tick feels no jump."""
    place(program.devices, measured, program.position, program.previous)
    settle_centred(program.centred, program.position, program.previous)
    settle_filtered(program.filtered, program.position, program.previous)


@jit_inlined
def tick(program, measured, velocity, force):
    """Moves the scene by one sample.

    `measured`: the device's positions in m, one per channel. `velocity`: those that it senses in m/s, 0 where it does
    not. `force`: receives the force in N on each channel that the scene uses.
    """
    position, previous = program.position, program.previous
    follow(program.devices, measured, position, previous)
    for p in range(program.force.size):
        program.force[p] = 0.0
    pull_backward(program.backward, position, previous, program.force)
    pull_centred(program.centred, position, previous, program.force)
    pull_filtered(program.filtered, position, previous, program.force)
    pull_sensed(program.sensed, program.devices, velocity, position, previous, program.force)
    felt(program.devices, program.force, force)
    advance(program.masses, position, previous, program.force)
