"""Moving the scene from sample to sample, in substeps; and two scenes for a while after a change of its structure.

When a position arrives, all steps since the last one are taken at once, the hand on a straight line between the two.
What the hand gets is the force of the last step, or the mean over the last sample's.

Another thread posts the program of the new scene, and the loop takes it between two samples. What both scenes have
continues from where it is (the program's list `take_over`); the same hands move both, and the force crossfades:

    F = F_old + w(s) (F_new - F_old),     w = 3 s² - 2 s³,     s = 1/N, 2/N, ... 1

over N steps: none adds more than 1.5/N of the difference. A step that adds more energy than the tank has is
shortened (cordis/stored_energy.py), and the crossfade takes longer. At its end the old scene is dropped.

A scene that never changes its structure never compiles the crossfade: its address is 0 until a scene is posted.
"""

from __future__ import annotations

import numpy as np
from numba import types

from firmware_protocol import schema
from firmware_protocol.compiled import compact
from hapsim.compiling import fence, helper, inlined
from hapsim.compiling.native import array_at, function_at, native, record_at
from hapsim.cordis.stored_energy import left_of, share_that_lasts, spend, stored_at, tank_at
from hapsim.cordis.tick import follow_parameters, program_at, set_hands, stored_energy, take_over, tick
from hapsim.loop.buffers import IO_BUFFER
from hapsim.loop.sound import call_hear

SCENE_SLOT = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("substeps", np.int64),  # steps of the program in a sample
        ("mean", np.int64),  # 1: the mean of their forces is what the hand gets; 0: the last one
        ("summed", np.float64, (schema.MAX_CHANNELS,)),  # N, those so far
        ("program", np.uint64),  # of the program that is moved
        ("next", np.uint64),  # of the one that it fades to; 0: none
        ("posted", np.uint64),  # of one to take; 0: none
        ("posted_steps", np.int64),  # N, for it
        ("steps", np.int64),  # N
        ("left", np.float64),  # steps until the old scene is dropped
        ("weight", np.float64),  # w
        ("incoming", np.float64, (schema.MAX_CHANNELS,)),  # N, the new scene's force
        ("hear", np.uint64),  # address of the function of that name; 0: the scene has no sound
        ("sound", np.uint64),  # address of its ring
        ("cross_fade", np.uint64),  # address of the function that moves two; 0: one scene, and none is posted
    ],
    align=True,
)

_CROSS_FADE = types.void(types.uint64, types.uint64, types.uint64, types.uint64)
_call = function_at(_CROSS_FADE)
_slot_at, _io_at, _doubles_at = record_at(SCENE_SLOT), record_at(IO_BUFFER), array_at(np.float64)


@inlined
def move_scene(slot, io, samples):
    """Moves the scene by `samples`, the hands along a line; the force that answers them is then in `io.asked`."""
    compact()
    steps = samples * slot.substeps
    for i in range(1, steps + 1):
        position, velocity = io.measured, io.velocity
        if i < steps:
            for c in range(np.uint64(io.channels)):
                rise, gain = io.measured[c] - io.before[c], io.velocity[c] - io.velocity_before[c]
                io.bridge[c] = io.before[c] + rise * i / steps
                io.velocity_bridge[c] = io.velocity_before[c] + gain * i / steps
            position, velocity = io.bridge, io.velocity_bridge
        if slot.cross_fade == 0:
            _move(slot.program, position, velocity, io.asked)
            if slot.hear != 0:
                call_hear(slot.hear, (slot.sound, program_at(slot.program).heard, np.uint64(0), 0.0))
        else:
            at = (np.uint64(position.ctypes.data), np.uint64(velocity.ctypes.data))
            _call(slot.cross_fade, (slot.address, io.address, at[0], at[1]))
        if slot.mean:
            _take_mean(slot, io, i - (steps - slot.substeps), i == steps)


@inlined
def _take_mean(slot, io, number, is_last):
    """Adds the forces of step `number`, from 1 on, of the last sample's; makes their mean the force that is sent."""
    for c in range(np.uint64(io.channels)):
        if number == 1:
            slot.summed[c] = 0.0
        slot.summed[c] += io.asked[c]
        if is_last:
            io.asked[c] = slot.summed[c] / slot.substeps


@native(_CROSS_FADE.return_type, *_CROSS_FADE.args)
def cross_fade(slot, io, position, velocity):
    """Moves both scenes by a step, once the posted one is taken."""
    slot, io = _slot_at(slot), _io_at(io)
    position, velocity = _doubles_at(position, io.channels), _doubles_at(velocity, io.channels)
    if slot.posted != 0 and slot.next == 0:
        slot.steps = slot.left = slot.posted_steps
        slot.next = slot.posted
        slot.posted = np.uint64(0)
        slot.incoming[:], slot.weight = 0.0, 0.0
        take_over(program_at(slot.program), program_at(slot.next), position)
    _advance(slot, position)
    for c in range(io.channels):
        io.asked[c] = 0.0  # for a channel that the old scene does not have
    _move(slot.program, position, velocity, io.asked)
    _move(slot.next, position, velocity, slot.incoming)
    weight = slot.weight
    if slot.hear != 0:
        older, newer = program_at(slot.program).heard, program_at(slot.next).heard
        call_hear(slot.hear, (slot.sound, older, newer, 1.0 if slot.left == 0 else weight))
    for c in range(io.channels):
        # At the end it is the new scene's alone, even where the old one's was not a number.
        io.asked[c] = io.asked[c] + weight * (slot.incoming[c] - io.asked[c]) if slot.left > 0 else slot.incoming[c]
    if slot.left == 0:
        slot.program = slot.next
        slot.next = np.uint64(0)
        fence()
        slot.cross_fade = np.uint64(0)


@helper
def _advance(slot, position):
    """Advances the weight by a step, or as far as the tank lasts."""
    before = slot.weight
    slot.left = max(slot.left - 1.0, 0.0)
    s = 1.0 - slot.left / slot.steps
    slot.weight = s * s * (3.0 - 2.0 * s)
    following = program_at(slot.next)
    if following.parameters.stored == 0:
        return
    added = stored_energy(following, position) - stored_energy(program_at(slot.program), position)
    tank = tank_at(stored_at(following.parameters.stored).tank)
    lasts = share_that_lasts(tank, (slot.weight - before) * added)
    if lasts < 1.0:
        slot.weight = before + lasts * (slot.weight - before)
        slot.left = slot.steps * left_of(slot.weight)
    spend(tank, (slot.weight - before) * added)


@inlined
def _move(program, position, velocity, force):
    program = program_at(program)
    if program.parameters.stored != 0:
        set_hands(program, position)
    follow_parameters(program)
    tick(program, position, velocity, force)
