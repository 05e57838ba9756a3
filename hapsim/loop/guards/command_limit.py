"""The command limit of a device in admittance: no command is farther, or turns faster, than it may.

A command moves the handle whatever the hand does. So from sample to sample it goes on by at most the speed limit, and
the step differs from the one before by at most the acceleration limit. Before an end of `device.travel` and its margin
it brakes as early as that acceleration asks for, and stays within: with r the way left and c the acceleration limit in
m per sample squared, a step and k further ones, each shorter by c, fit into r if it is at most

    r/(k + 1) + c k/2,    k (k + 1)/2 <= r/c < (k + 1) (k + 2)/2.

A device that is armed outside may come in, not go out.

The simulated mass is at what is commanded. A hand that is too stiff for it swings ever farther, each time with as much
beyond the acceleration limit as the time before or more. No hand does that by itself if it turns within SHAKE_S, and
after SHAKES turns the run ends.

Other guards stop the command of a channel, while they measure (`held`) or test (`stopped`, force_sensor.py).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import inlined
from hapsim.compiling.native import address_of, record_at
from hapsim.loop.guards.energy_guard import SHAKE_S, count_turn
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.ring import SLEWED
from hapsim.loop.simulated_mass import admittance_at

COMMANDS_SHAKE = -31

SHAKES = 16  # turns in a row, SHAKE_S apart at most: no hand shakes at 10 Hz and more

_EACH = (schema.MAX_CHANNELS,)

COMMAND_LIMIT = np.dtype(
    [
        ("admittance", np.uint64),  # address of the ADMITTANCE
        ("speed", np.float64, _EACH),  # m in a sample, the longest step
        ("change", np.float64, _EACH),  # m, the most by which a step differs from the one before
        ("low", np.float64, _EACH),  # m, between which commands stay
        ("high", np.float64, _EACH),
        ("held", np.int64),  # positions from arming on in which no command moves
        ("stopped", np.int64, _EACH),  # 1: another guard stops the channel
        ("limited", np.int64),  # ticks with a command at a limit
        ("side", np.int64, _EACH),  # on which the acceleration exceeded its limit last,
        ("since", np.int64, _EACH),  # samples since it turned to that side,
        ("peak", np.float64, _EACH),  # m, the largest request beyond it since,
        ("least_peak", np.float64, _EACH),  # the least of these,
        ("turns", np.int64, _EACH),  # and turns in a row
        ("most_turn", np.int64),  # samples from one turn to the next
        ("channel", np.int64),  # which shakes
    ],
    align=True,
)

command_limit_at = record_at(COMMAND_LIMIT)


@hook
def limit_commands(limit, tick):
    """Limits `io.command`. Returns COMMANDS_SHAKE if one shakes at the acceleration limit, else 0."""
    limit, tick = command_limit_at(limit), tick_at(tick)
    io, admittance = io_at(tick.io), admittance_at(limit.admittance)
    code, is_limited = 0, False
    for c in range(np.uint64(io.channels)):
        place, change = admittance.place[c], limit.change[c]
        before, wanted = place - admittance.before[c], io.command[c] - place
        if tick.number < limit.held or limit.stopped[c]:
            wanted = 0.0
        elif _count_turn(limit, c, wanted - before, tick.gap):
            limit.channel, code = c, COMMANDS_SHAKE
        most, least = limit.speed[c], -limit.speed[c]
        most = min(most, _longest_step(max(limit.high[c] - place, 0.0), change))
        least = max(least, -_longest_step(max(place - limit.low[c], 0.0), change))
        step = min(max(wanted, least), most)
        step = min(max(step, before - change), before + change)
        if step != wanted:
            io.command[c] = place + step
            is_limited = True
        elif wanted == 0.0:
            io.command[c] = place
    if is_limited:
        limit.limited += 1
        tick.flags |= SLEWED
    return code


@inlined
def _longest_step(room, change):
    """Returns the longest step from which steps that are `change` shorter each stop within `room`, all in m."""
    if not room < math.inf:
        return math.inf
    more = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * room / change) - 1.0))
    return room / (more + 1.0) + 0.5 * change * more


@inlined
def _count_turn(limit, c, change, gap):
    """Counts a turn of the requested change of a step from beyond one side of its limit to the other. Returns whether
    SHAKES of them have come in a row."""
    beyond = abs(change) - limit.change[c]
    limit.since[c] += gap
    side = 0 if beyond <= 0.0 else 1 if change > 0.0 else -1
    if side != 0 and side != limit.side[c]:
        count_turn(limit, c, limit.peak[c], limit.since[c] > limit.most_turn)
        limit.side[c], limit.since[c], limit.peak[c] = side, 0, 0.0
    limit.peak[c] = max(limit.peak[c], beyond)
    return limit.turns[c] >= SHAKES


def _set_up(loop: Any, setting: Setting) -> Any:
    scene, limit, used = setting.scene, loop.command_limit, slice(setting.scene.channels)
    device, channels = scene.device, scene.channels
    limit.admittance = address_of(loop.admittance)
    limit.speed[used] = np.array(device.speed_limits(channels)) * scene.period
    limit.change[used] = np.array(device.acceleration_limits(channels)) * scene.period**2
    low, high = np.transpose(device.travels(channels))
    margin = np.array(scene.travel_margins) if device.travel is not None else 0.0
    limit.low[used], limit.high[used] = low - margin, high + margin
    limit.most_turn, limit.least_peak[:] = round(SHAKE_S * scene.rate), math.inf
    return limit


def _sentence(run: EndedRun) -> str:
    c = int(run.loop.command_limit.channel)
    units, most = run.scene.units_of(c), run.loop.command_limit.change[c] * run.scene.rate**2
    return (
        f"{run.scene.hand_on(c)} shook at the limit of its acceleration, {units(most, 'm/s²', '.3g')}: from one side "
        f"to the other {SHAKES} times in a row, the last at tick {run.report.ticks}, each time as far or farther"
    )


def _advice(_run: EndedRun) -> str:
    return (
        "No hand does that: it is stiffer than what the simulated mass and damping bear. `hapsim check` has the "
        "smallest that do for an assumed_hand; a firmer grip asks for more (hapsim/STABILITY.md)"
    )


GUARD = Guard(
    "command_limit",
    COMMAND_LIMIT,
    {Stage.KEEP: limit_commands},
    _set_up,
    COMMANDS_SHAKE,
    "commands shaking",
    _sentence,
    _advice,
    mode="admittance",
)
