"""One sample of the scene: positions in, forces out, masses moved."""

from __future__ import annotations

from hapsim.compiled import jit
from hapsim.cordis.device_point import felt, follow, place
from hapsim.cordis.mass import advance
from hapsim.cordis.viscoelastic import pull


@jit
def start(program, measured):
    """Puts the device points where the hand is, at rest, so that the first tick feels no jump."""
    place(program.devices, measured, program.position, program.previous)


@jit
def tick(program, measured, force):
    """Moves the scene by one sample.

    `measured`: the device's positions in m, one per channel. `force`: receives the force on each channel in N.
    """
    follow(program.devices, measured, program.position, program.previous)
    for p in range(program.force.size):
        program.force[p] = 0.0
    pull(program.links, program.position, program.previous, program.force)
    felt(program.devices, program.force, force)
    advance(program.masses, program.position, program.previous, program.force)
