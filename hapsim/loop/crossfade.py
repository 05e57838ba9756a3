"""The crossfade after a change of a scene's structure: the loop moves two scenes for a while.

Another thread posts the program of the new scene, and the loop takes it between two samples. Modules of both scenes
continue from their state (`take_over` of `cordis/tick.py`). The same hands move both scenes, and the force crossfades:

    F = F_old + w(s) (F_new - F_old),     w = 3 s² - 2 s³,     s = 1/N, 2/N, ... 1

over N steps: none adds more than 1.5/N of the difference. A step that adds more energy than the tank holds is
shortened (cordis/stored_energy.py), and the crossfade takes longer. At its end the loop drops the old scene.

A scene that never changes its structure never compiles the crossfade: its address is 0 until a scene is posted.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import fence, helper
from hapsim.compiling.native import array_at, native, record_at
from hapsim.cordis.dispatch import call_add_frame
from hapsim.cordis.spring_energy import stored_at
from hapsim.cordis.stored_energy import affordable_share, remaining_ramp, smooth, spend, tank_at
from hapsim.cordis.substep_loop import CROSS_FADE, SCENE_SLOT, move_by_step
from hapsim.cordis.tick import program_at, stored_energy, take_over
from hapsim.loop.buffers import IO_BUFFER

_slot_at, _io_at, _doubles_at = record_at(SCENE_SLOT), record_at(IO_BUFFER), array_at(np.float64)


@native(CROSS_FADE.return_type, *CROSS_FADE.args)
def cross_fade(slot, io, position, velocity):
    """Takes the posted scene, if it has not yet, and moves both scenes by a step."""
    slot, io = _slot_at(slot), _io_at(io)
    position, velocity = _doubles_at(position, schema.MAX_CHANNELS), _doubles_at(velocity, schema.MAX_CHANNELS)
    if slot.posted != 0 and slot.next == 0:
        slot.steps = slot.left = slot.posted_steps
        slot.next = slot.posted
        slot.posted = np.uint64(0)
        slot.incoming[:], slot.weight, slot.moved = 0.0, 0.0, 0
        take_over(program_at(slot.program), program_at(slot.next), position)
    _advance(slot, position)
    for c in range(io.channels):
        io.asked[c] = 0.0  # for a channel without a hand in the old scene
    move_by_step(slot.program, position, velocity, io.asked)
    move_by_step(slot.next, position, velocity, slot.incoming)
    weight = slot.weight
    if slot.add_frame != 0:
        older, newer = program_at(slot.program).pick_up_values, program_at(slot.next).pick_up_values
        call_add_frame(slot.add_frame, (slot.sound, older, newer, 1.0 if slot.left == 0 else weight))
    for c in range(io.channels):
        # At the end only the new scene's force counts, even if the old one's was NaN.
        io.asked[c] = io.asked[c] + weight * (slot.incoming[c] - io.asked[c]) if slot.left > 0 else slot.incoming[c]
    if slot.left == 0:
        slot.program = slot.next
        slot.next = np.uint64(0)
        fence()
        slot.cross_fade = np.uint64(0)


@helper
def _advance(slot, position):
    """Advances the weight by a step, or as far as the tank allows."""
    before = slot.weight
    slot.moved += 1
    slot.left = max(slot.left - 1.0, 0.0)
    s = 1.0 - slot.left / slot.steps
    slot.weight = smooth(s)
    following = program_at(slot.next)
    if following.parameters.stored == 0:
        return
    added = stored_energy(following, position) - stored_energy(program_at(slot.program), position)
    tank = tank_at(stored_at(following.parameters.stored).tank)
    share = affordable_share(tank, (slot.weight - before) * added)
    if share < 1.0:
        slot.weight = before + share * (slot.weight - before)
        slot.left = slot.steps * remaining_ramp(slot.weight)
    spend(tank, (slot.weight - before) * added)
