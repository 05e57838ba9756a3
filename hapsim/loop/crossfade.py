"""Moving the scene: one, or two for a while after a change of its structure.

Another thread posts the program of the new scene, and the loop takes it between two samples. What both scenes have
continues from where it is (the program's list `take_over`); the same hands move both, and the force crossfades:

    F = F_old + w(s) (F_new - F_old),     w = 3 s² - 2 s³,     s = 1/N, 2/N, ... 1

over N samples: no sample adds more than 1.5/N of the difference. A step that adds more energy than the tank has is
shortened (cordis/stored_energy.py), and the crossfade takes longer. At its end the old scene is dropped.

A scene that never changes its structure never compiles the crossfade: its address is 0 until a scene is posted.
"""

from __future__ import annotations

import numpy as np
from numba import types

from firmware_protocol import schema
from firmware_protocol.compiled import compact
from hapsim.compiling import entry, helper, inlined
from hapsim.compiling.memory_fence import fence
from hapsim.compiling.native import array_at, function_at, native, record_at
from hapsim.cordis.stored_energy import left_of, share_that_lasts, spend, stored_at, tank_at
from hapsim.cordis.tick import follow_parameters, program_at, set_hands, stored_energy, take_over, tick
from hapsim.loop.buffers import IO_BUFFER

SCENE_SLOT = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("program", np.uint64),  # of the program that is moved
        ("next", np.uint64),  # of the one that it fades to; 0: none
        ("posted", np.uint64),  # of one to take; 0: none
        ("posted_samples", np.int64),  # N, for it
        ("samples", np.int64),  # N
        ("left", np.float64),  # samples until the old scene is dropped
        ("weight", np.float64),  # w
        ("incoming", np.float64, (schema.MAX_CHANNELS,)),  # N, the new scene's force
        ("cross_fade", np.uint64),  # address of the function that moves two; 0: one scene, and none is posted
    ],
    align=True,
)

_CROSS_FADE = types.void(types.uint64, types.uint64, types.uint64, types.uint64)
_call = function_at(_CROSS_FADE)
_slot_at, _io_at, _doubles_at = record_at(SCENE_SLOT), record_at(IO_BUFFER), array_at(np.float64)


@inlined
def move_scene(slot, io, samples):
    """Moves the scene by `samples`, the hands along a line; the force in each is then in `io.asked`."""
    compact()
    for i in range(1, samples + 1):
        position, velocity = io.measured, io.velocity
        if i < samples:
            for c in range(np.uint64(io.channels)):
                rise, gain = io.measured[c] - io.before[c], io.velocity[c] - io.velocity_before[c]
                io.bridge[c] = io.before[c] + rise * i / samples
                io.velocity_bridge[c] = io.velocity_before[c] + gain * i / samples
            position, velocity = io.bridge, io.velocity_bridge
        if slot.cross_fade == 0:
            _move(slot.program, position, velocity, io.asked)
        else:
            at = (np.uint64(position.ctypes.data), np.uint64(velocity.ctypes.data))
            _call(slot.cross_fade, (slot.address, io.address, at[0], at[1]))


@native(_CROSS_FADE.return_type, *_CROSS_FADE.args)
def cross_fade(slot, io, position, velocity):
    """Moves both scenes by a sample, once the posted one is taken."""
    slot, io = _slot_at(slot), _io_at(io)
    position, velocity = _doubles_at(position, io.channels), _doubles_at(velocity, io.channels)
    if slot.posted != 0 and slot.next == 0:
        slot.samples = slot.left = slot.posted_samples
        slot.next = slot.posted
        fence()
        slot.posted = np.uint64(0)
        slot.incoming[:], slot.weight = 0.0, 0.0
        take_over(program_at(slot.program), program_at(slot.next), position)
    _advance(slot, position)
    for c in range(io.channels):
        io.asked[c] = 0.0  # for a channel that the old scene does not have
    _move(slot.program, position, velocity, io.asked)
    _move(slot.next, position, velocity, slot.incoming)
    weight = slot.weight
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
    """Advances the weight by a sample, or as far as the tank lasts."""
    before = slot.weight
    slot.left = max(slot.left - 1.0, 0.0)
    s = 1.0 - slot.left / slot.samples
    slot.weight = s * s * (3.0 - 2.0 * s)
    following = program_at(slot.next)
    if following.parameters.stored == 0:
        return
    added = stored_energy(following, position) - stored_energy(program_at(slot.program), position)
    tank = tank_at(stored_at(following.parameters.stored).tank)
    lasts = share_that_lasts(tank, (slot.weight - before) * added)
    if lasts < 1.0:
        slot.weight = before + lasts * (slot.weight - before)
        slot.left = slot.samples * left_of(slot.weight)
    spend(tank, (slot.weight - before) * added)


@entry
def post(slot, program, samples, cross_fade):
    """Posts the program at this address for a crossfade over `samples` (>= 1), after the last one has ended.
    `cross_fade`: the address of the function of that name."""
    slot.posted_samples = samples
    slot.posted = np.uint64(program)
    fence()
    slot.cross_fade = np.uint64(cross_fade)


@inlined
def _move(program, position, velocity, force):
    program = program_at(program)
    if program.parameters.stored != 0:
        set_hands(program, position)
    follow_parameters(program)
    tick(program, position, velocity, force)
