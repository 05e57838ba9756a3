"""The guard of a hand that is armed inside a wall: until it is out once, its force is low.

A wall that asks for more than the force limit when the device is armed would throw the hand out, with the work of the
whole limit over its depth: no hand has put that in. So the force of such a hand is at most

    ARMED_INSIDE energy_limit / depth,

with the depth at arming, until it is in no contact, or its force turns by more than 90 degrees: then it has passed
where two contacts hold it between them. The force keeps its direction. The depth is that in the deepest contact
of the hand; a contact is a shape, a buffer, a click, or a table that has no force on one side, or in its middle.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.compiling.native import address_of, record_at
from hapsim.cordis.spring_energy import depth_in_contacts, stored_at
from hapsim.cordis.substep_loop import SCENE_SLOT
from hapsim.cordis.tick import program_at, set_hands
from hapsim.loop.buffers import scale_force, share_within_limit
from hapsim.loop.hooks import Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.ring import FADED
from hapsim.prediction.force_bounds import ARMED_INSIDE
from hapsim.scene import DevicePoint, Link, Scene

_EACH = (schema.MAX_CHANNELS,)

INSIDE = np.dtype(
    [
        ("slot", np.uint64),  # address of the SCENE_SLOT
        ("work", np.float64),  # J: most work of the force over a depth
        ("begun", np.int64),  # 1: there was a sample
        ("hands", np.int64),  # that are not out yet
        ("most", np.float64, _EACH),  # N, by the first channel of such a hand; 0: another
        ("depth", np.float64, _EACH),  # m, at arming,
        ("place", np.float64, _EACH),  # with the place, m,
        ("asked", np.float64, _EACH),  # and the scene's force, N, by channel
    ],
    align=True,
)

_inside_at, _slot_at = record_at(INSIDE), record_at(SCENE_SLOT)


@hook
def lower_inside(inside, tick):
    """Lowers force and excitation of the hands that were armed inside a contact and are not out yet."""
    inside, tick = _inside_at(inside), tick_at(tick)
    if inside.begun and inside.hands == 0:
        return 0
    io, program = io_at(tick.io), program_at(_slot_at(inside.slot).program)
    if program.parameters.stored == 0:
        return 0
    stored, position = stored_at(program.parameters.stored), program.rows[np.uint64(program.turn)]
    set_hands(program, io.measured)
    for h in range(program.hands):
        c = program.channel[np.uint64(h)]
        other = c + io.to_next[c]  # c, if the hand has one channel
        if inside.begun and inside.most[c] == 0.0:
            continue
        depth = depth_in_contacts(stored, position, h)
        if inside.begun == 0:
            inside.place[c], inside.asked[c] = io.measured[c], io.asked[c]
            is_beyond = share_within_limit(io, c, False) < 1.0 or abs(io.asked[c]) > io.force_limit[c]
            if depth > 0.0 and is_beyond:
                inside.most[c], inside.depth[c] = inside.work / depth, depth
                inside.hands += 1
        elif not (depth > 0.0 and io.asked[c] * inside.asked[c] + io.asked[other] * inside.asked[other] > 0.0):
            inside.most[c] = 0.0
            inside.hands -= 1
        if inside.most[c] > 0.0 and _lower(io, c, other, inside.most[c]):
            tick.flags |= FADED
    inside.begun = 1
    return 0


@helper
def _lower(io, c, other, most):
    """Brings the force of a hand down to `most` N, whole, so that it does not turn. Returns whether it was more."""
    x, y = io.force_counts[c] * io.force_scale[c], io.force_counts[other] * io.force_scale[other]
    size = math.hypot(x, y) if other != c else abs(x)
    for one in range(np.uint64(io.channels) if size > most else np.uint64(0)):
        if one in (c, other):
            counts = np.int64(io.force_counts[one] * most / size)  # towards zero
            scale_force(io, one, most / size)
            io.force_counts[one] = counts
    return size > most


def _is_contact(link: Link) -> bool:
    """Returns whether a link pushes its ends back from an edge before which it has no force."""
    table = link.table()
    return any(one.pushes for one in link.potentials) if table is None else bool(table.contact_edges)


def _set_up(loop: Any, setting: Setting) -> Any:
    scene, work = setting.scene, ARMED_INSIDE * setting.bounds.energy_limit
    hands = {name for name, one in scene.modules.items() if isinstance(one, DevicePoint)}
    links = (scene.links | scene.plane_links).values()
    if not (math.isfinite(work) and any(hands & {*one.between} and _is_contact(one) for one in links)):
        return None
    loop.armed_inside.slot, loop.armed_inside.work = address_of(loop.slot), work
    return loop.armed_inside


def inside_sentence(scene: Scene, inside: Any) -> str:
    """Returns a sentence, without a full stop, about the hand that was armed deepest inside a contact; "" if none
    was."""
    c = int(np.argmax(inside.depth))
    if not inside.depth[c] > 0.0:
        return ""
    units = scene.units_of(c)
    place = ", ".join(units.number(inside.place[one], "m", ".3g") for one in scene.hand_of(c))
    most = min(inside.work / float(inside.depth[c]), scene.device.force_limit)
    where = f"{units(inside.depth[c], 'mm', '.3g')} inside a contact, at {units(place, 'm')}"
    until = f"Until it is out once, its force is at most {units(most, 'N', '.3g')}: move it out"
    return f"{scene.hand_on(c)} was armed {where}. {until}"


GUARD = Guard("armed_inside", INSIDE, {Stage.LOWER: lower_inside}, _set_up)
