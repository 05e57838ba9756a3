"""Moving two scenes for a while, after a change of a scene's structure.

Another thread posts the program of the new scene, and the loop takes it between two samples. What both scenes have
continues from where it is (the program's list `take_over`); the same hands move both, and the force crossfades:

    F = F_old + w(s) (F_new - F_old),     w = 3 s² - 2 s³,     s = 1/N, 2/N, ... 1

over N steps: none adds more than 1.5/N of the difference. A step that adds more energy than the tank has is
shortened (cordis/stored_energy.py), and the crossfade takes longer. At its end the old scene is dropped.

A scene that never changes its structure never compiles the crossfade: its address is 0 until a scene is posted.
"""

from __future__ import annotations

import numpy as np

from hapsim.compiling import fence, helper
from hapsim.compiling.native import array_at, native, record_at
from hapsim.cordis.dispatch import call_hear
from hapsim.cordis.stored_energy import left_of, share_that_lasts, spend, stored_at, tank_at
from hapsim.cordis.substep_loop import CROSS_FADE, SCENE_SLOT, move_by_step
from hapsim.cordis.tick import program_at, stored_energy, take_over
from hapsim.loop.buffers import IO_BUFFER

_slot_at, _io_at, _doubles_at = record_at(SCENE_SLOT), record_at(IO_BUFFER), array_at(np.float64)


@native(CROSS_FADE.return_type, *CROSS_FADE.args)
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
    move_by_step(slot.program, position, velocity, io.asked)
    move_by_step(slot.next, position, velocity, slot.incoming)
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
