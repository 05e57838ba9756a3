"""The gate of the motor, `device.when`: the whole force is multiplied by a weight w, which fades between 0 and 1 when
that input changes, as the weights of live values do (cordis/parameters.py). It includes excitation and pushes.

A step dw adds the energy dw H, with H stored in the scene (cordis/stored_energy.py). One that adds more than the tank
of changes holds is shortened, and the fade takes longer. At arming w is 1 if the input is on, else 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hapsim.compiling.native import address_of, record_at
from hapsim.cordis.parameters import FADE_S, part_of_fade
from hapsim.cordis.stored_energy import affordable_share, smooth, spend, tank_at
from hapsim.cordis.substep_loop import SCENE_SLOT, stored_in
from hapsim.loop.buffers import scale_force
from hapsim.loop.hooks import Guard, Setting, Stage, hook, io_at, tick_at

MOTOR_GATE = np.dtype(
    [
        ("mask", np.int64),  # of its input,
        ("inverted", np.int64),  # which is on while that bit is 0, if this has it too
        ("fade", np.float64),  # samples of a whole fade
        ("phase", np.float64),  # s, of which w = 3 s² - 2 s³
        ("slot", np.uint64),  # address of the SCENE_SLOT,
        ("tank", np.uint64),  # and of the TANK
    ],
    align=True,
)

_gate_at, _slot_at = record_at(MOTOR_GATE), record_at(SCENE_SLOT)


@hook
def gate_motor(gate, tick):
    """Moves the weight, and lowers force and excitation of every channel."""
    gate, tick = _gate_at(gate), tick_at(tick)
    io = io_at(tick.io)
    is_on = (io.inputs ^ gate.inverted) & gate.mask != 0
    step = tick.gap / gate.fade if tick.number > 0 else 1.0
    before, phase = gate.phase, min(gate.phase + step, 1.0) if is_on else max(gate.phase - step, 0.0)
    tank = tank_at(gate.tank)
    if phase != before and tick.number > 0 and tank.address != 0:
        work = (smooth(phase) - smooth(before)) * stored_in(_slot_at(gate.slot), io.measured)
        share = affordable_share(tank, work)
        if share < 1.0:
            work *= share
            phase = part_of_fade(before, phase, share)
        spend(tank, work)
    gate.phase = phase
    weight = smooth(phase)
    for c in range(np.uint64(io.channels)):
        scale_force(io, c, weight)
    return 0


def _set_up(loop: Any, setting: Setting) -> Any:
    scene, gate = setting.scene, loop.motor_gate
    if scene.device.when is None:
        return None
    its = scene.inputs[scene.device.when]
    gate.mask, gate.inverted, gate.fade = its.mask, its.mask if its.inverted else 0, FADE_S * scene.rate
    gate.slot, gate.tank = address_of(loop.slot), address_of(loop.tank)
    return gate


GUARD = Guard("motor_gate", MOTOR_GATE, {Stage.LOWER: gate_motor}, _set_up)
