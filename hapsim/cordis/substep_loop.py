"""The substep loop: moves the scene from sample to sample.

When a position arrives, all steps since the last one are made at once, with the hand on a straight line between the
two. The device gets the force of the last step, or the mean over the steps of the last sample.

During a crossfade `cross_fade` (loop/crossfade.py) moves both scenes. With sound, `add_frame` (loop/sound.py) adds a
frame for each step. Both are called by their addresses, and only compiled for scenes that use them.
"""

from __future__ import annotations

import numpy as np
from numba import types

from firmware_protocol import schema
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import function_at
from hapsim.cordis.dispatch import call_add_frame
from hapsim.cordis.tick import program_at, set_hands, stored_energy, tick, update_parameters

SCENE_SLOT = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("substeps", np.int64),  # steps of the program in a sample
        ("mean", np.int64),  # 1: the device gets the mean of their forces; 0: the last one
        ("summed", np.float64, (schema.MAX_CHANNELS,)),  # N, those so far
        ("program", np.uint64),  # of the program that is moved
        ("next", np.uint64),  # of the one that it fades to; 0: none
        ("posted", np.uint64),  # of one to take; 0: none
        ("posted_steps", np.int64),  # N, for it
        ("steps", np.int64),  # N
        ("left", np.float64),  # steps until the old scene is dropped
        ("weight", np.float64),  # w
        ("moved", np.int64),  # steps that the last crossfade has taken so far
        ("incoming", np.float64, (schema.MAX_CHANNELS,)),  # N, the new scene's force
        ("add_frame", np.uint64),  # address of that function; 0: the scene has no sound
        ("sound", np.uint64),  # address of its ring
        ("cross_fade", np.uint64),  # address of that function; 0: one scene, and none is posted
    ],
    align=True,
)

CROSS_FADE = types.void(types.uint64, types.uint64, types.uint64, types.uint64)
_call_cross_fade = function_at(CROSS_FADE)


@inlined
def move_scene(slot, io, samples):
    """Moves the scene by `samples`, with the hands on straight lines. Writes the scene's force to `io.asked`."""
    steps = samples * slot.substeps
    for i in range(1, steps + 1):
        position, velocity = io.measured, io.velocity
        if i < steps:
            for c in range(np.uint64(io.channels)):
                _bridge(io, c, i, steps)
            for c in range(np.uint64(io.away_first), np.uint64(io.away_end)):
                _bridge(io, c, i, steps)
            position, velocity = io.bridge, io.velocity_bridge
        if slot.cross_fade == 0:
            move_by_step(slot.program, position, velocity, io.asked)
            if slot.add_frame != 0:
                call_add_frame(slot.add_frame, (slot.sound, program_at(slot.program).pick_up_values, np.uint64(0), 0.0))
        else:
            at = (np.uint64(position.ctypes.data), np.uint64(velocity.ctypes.data))
            _call_cross_fade(slot.cross_fade, (slot.address, io.address, at[0], at[1]))
        if slot.mean:
            _take_mean(slot, io, i - (steps - slot.substeps), i == steps)


@inlined
def _bridge(io, c, i, steps):
    """Puts the hand of a channel on the straight line between its last two positions, at step `i` of `steps`."""
    rise, gain = io.measured[c] - io.before[c], io.velocity[c] - io.velocity_before[c]
    io.bridge[c] = io.before[c] + rise * i / steps
    io.velocity_bridge[c] = io.velocity_before[c] + gain * i / steps


@inlined
def _take_mean(slot, io, number, is_last):
    """Adds the forces of step `number` (from 1 on) of the last sample. The last step sets the force to the mean."""
    for c in range(np.uint64(io.channels)):
        if number == 1:
            slot.summed[c] = 0.0
        slot.summed[c] += io.asked[c]
        if is_last:
            io.asked[c] = slot.summed[c] / slot.substeps


@helper
def stored_in(slot, position):
    """Returns the energy of the scene, J, at a sample of these positions of the hands; during a crossfade of both, as
    their forces count."""
    stored = stored_energy(program_at(slot.program), position)
    if slot.next == 0:
        return stored
    return stored + slot.weight * (stored_energy(program_at(slot.next), position) - stored)


@inlined
def move_by_step(program, position, velocity, force):
    """Moves live parameters and then the program at this address by a step."""
    program = program_at(program)
    if program.parameters.stored != 0:
        set_hands(program, position)
    update_parameters(program)
    tick(program, position, velocity, force)
