"""The lease: a client's promise to renew in time, and the fallback scene whose force the hand gets when it did not.

The loop itself counts, by the times at which positions arrived, in virtual time by their numbers. So no program, thread
or lock of Python can hold it up. At the first tick at or after the lease's end

    F = F_scene + w(s) (F_fallback - F_scene),     w = 3 s² - 2 s³,

begins with s = 1/N and reaches 1 in FADE_S, however many positions are lost. The scene goes on beneath, with its ramps
and crossfades. A renewal turns the fade round. A step that adds energy is shortened by the tank, as in `crossfade.py`:
w H_fallback + (1 - w) H_scene is stored.

The fallback moves only while w > 0. It begins each time in the initial state of its scene, its hands where they are
and with their velocity. `count_down` decides before the scene moves, `fall_back` mixes the forces after. Both are
compiled, and put behind the other hooks, when a session first asks for a lease.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import fence, helper
from hapsim.compiling.native import record_at
from hapsim.cordis.spring_energy import stored_at
from hapsim.cordis.stored_energy import affordable_share, remaining_ramp, smooth, spend, tank_at
from hapsim.cordis.substep_loop import SCENE_SLOT, move_scene, stored_in
from hapsim.cordis.tick import program_at, start, stored_energy
from hapsim.loop.hooks import Hook, Stage, hook, io_at, tick_at
from hapsim.loop.posted import call_copy

FADE_S = 0.05  # of the whole force

LEASE = np.dtype(
    [
        ("asked", np.int64),  # requests for a lease; another thread writes it, last of all,
        ("length", np.int64),  # and what they ask for: ns, in virtual time samples; 0: no lease
        ("taken", np.int64),  # requests that the loop has taken, the last one
        ("tick", np.int64),  # in this tick,
        ("sample", np.int64),  # at this sample, counted from arming
        ("counts_samples", np.int64),  # 1: virtual time
        ("due", np.int64),  # end of the lease, ns or sample; 0: the loop has taken none
        ("is_out", np.int64),  # 1: it has run out, and was not renewed
        ("out_count", np.int64),  # how often that happened, the last time
        ("out_sample", np.int64),  # at this sample
        ("weight", np.float64),  # w
        ("steps", np.float64),  # N
        ("of_scene", np.float64, (schema.MAX_CHANNELS,)),  # N, the force of the scene
        ("scene", np.uint64),  # address of its SCENE_SLOT
        ("fallback", SCENE_SLOT),
        ("copy", np.uint64),  # address of `copy_blocks`, which puts the fallback into its initial state,
        ("blocks", np.uint64),  # and its argument
    ],
    align=True,
)

_own_at, _slot_at = record_at(LEASE), record_at(SCENE_SLOT)


@hook
def count_down(own, tick):
    """Takes a request, finds that the lease has run out, and moves the weight by the samples of this tick."""
    own, tick = _own_at(own), tick_at(tick)
    io, now = io_at(tick.io), tick.sample if own.counts_samples else tick.now_ns
    if own.taken != own.asked:
        fence()
        own.due, own.is_out = now + own.length if own.length > 0 else 0, 0
        own.tick, own.sample = tick.number, tick.sample
        fence()
        own.taken = own.asked
    elif own.due != 0 and own.is_out == 0 and now >= own.due:  # `length` may be that of a request under way
        own.out_sample, own.is_out = tick.sample, 1
        fence()
        own.out_count += 1
    if own.is_out == 0 and own.weight == 0.0:
        return 0
    for c in range(np.uint64(io.channels)):
        io.asked[c] = 0.0  # for a channel without a hand in the scene
    if own.weight == 0.0:
        call_copy(own.copy, (own.blocks,))
        start(program_at(own.fallback.program), io.before)
    _fade(own, io.measured, tick.gap if own.is_out else -tick.gap)
    return 0


@helper
def _fade(own, position, samples):
    """Moves the weight by a number of samples of the fade, backwards if negative, or as far as the tank allows."""
    before = own.weight
    s = min(max(1.0 - remaining_ramp(before) + samples / own.steps, 0.0), 1.0)
    after = smooth(s)
    if after == before:
        return
    fallback = program_at(own.fallback.program)
    if fallback.parameters.stored != 0:
        added = (after - before) * (stored_energy(fallback, position) - stored_in(_slot_at(own.scene), position))
        tank = tank_at(stored_at(fallback.parameters.stored).tank)
        share = affordable_share(tank, added)
        after = before + share * (after - before)
        spend(tank, share * added)
    own.weight = after


@hook
def fall_back(own, tick):
    """Moves the fallback, and mixes its force into that of the scene."""
    own, tick = _own_at(own), tick_at(tick)
    weight, io = own.weight, io_at(tick.io)
    if weight == 0.0:
        return 0
    for c in range(np.uint64(io.channels)):
        own.of_scene[c], io.asked[c] = io.asked[c], 0.0
    move_scene(own.fallback, io, tick.gap)
    for c in range(np.uint64(io.channels)):
        if weight < 1.0:  # else the scene's force does not count, even if it is NaN
            io.asked[c] = own.of_scene[c] + weight * (io.asked[c] - own.of_scene[c])
    return 0


def lease_hooks(own: Any) -> list[Hook]:
    """Returns the hooks of a LEASE."""
    return [Hook(Stage.READ, count_down, own), Hook(Stage.ADD, fall_back, own)]
