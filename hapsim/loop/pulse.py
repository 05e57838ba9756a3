"""Pulses: forces of a length of their own, which a program adds for a hand to feel: a click, a knock, a buzz.

A pulse is a list of forces, one for each of the device's samples; a lost position skips one of them. The loop adds it
to the scene's force as an excitation, so the force limit, the slew limit, the travel and the soft start apply to the
sum. Guards that judge the scene do not take a pulse for the scene's own force.

**Its energy.** The work of the pulses on the hand is the part of the acting force that they caused (force_history.py),
times the way. It is taken from the tank of live changes (cordis/stored_energy.py). A pulse is lowered for the rest of
its time to what the tank holds for the forces under way, at the hand's present speed, or a count in a sample. So pulses
and changes together give a hand no more than the tank's content and what refills it.

The hooks join a running loop with its first pulse: a run without pulses has none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from hapsim.compiling.native import address_of, array_at, record_at
from hapsim.cordis.stored_energy import tank_at
from hapsim.loop.force_history import IN_ALL, OF_SCENE, acting_force, history_at
from hapsim.loop.hooks import Hook, Stage, hook, io_at, tick_at

_EACH = (schema.MAX_CHANNELS,)
_NOT_BEGUN = -1

PULSES = np.dtype(
    [
        ("tank", np.uint64),  # address of the TANK; 0: no energy is accounted for
        ("forces", np.uint64, _EACH),  # address of the newest pulse, N, one for each sample,
        ("count", np.int64, _EACH),  # and of how many samples it is
        ("begin", np.int64, _EACH),  # sample of its first force; -1: the next one
        ("share", np.float64, _EACH),  # of it that the tank has allowed
        ("until", np.int64),  # sample at which the forces of all pulses have acted
        ("measures", np.int64),  # 1: `position` is that of the last sample
        ("position", np.float64, _EACH),  # m
        ("spent", np.float64),  # J, the work of all pulses on the hand
    ],
    align=True,
)

_pulses_at, _forces_at = record_at(PULSES), array_at(np.float64)


@hook
def add_pulses(pulses, tick):
    """Sets the push (N) of each channel to its pulse's force of this sample."""
    pulses, tick = _pulses_at(pulses), tick_at(tick)
    io, history = io_at(tick.io), history_at(tick.history)
    for c in range(np.uint64(io.channels)):
        if pulses.begin[c] == _NOT_BEGUN:
            pulses.begin[c], pulses.share[c] = tick.sample, 1.0
        at = tick.sample - pulses.begin[c]
        tick.push[c] = 0.0
        if at < pulses.count[c]:
            force = _forces_at(pulses.forces[c], pulses.count[c])[np.uint64(at)]
            ahead = history.lag + 1  # samples whose forces are under way
            pulses.until = max(pulses.until, tick.sample + ahead + 1)
            if pulses.tank != 0:
                way = max(abs(io.measured[c] - io.before[c]) / tick.gap, io.position_scale[c])
                work, level = abs(force) * way * ahead, max(tank_at(pulses.tank).level, 0.0)
                if work > level:
                    pulses.share[c] = min(pulses.share[c], level / work)
            tick.push[c] = pulses.share[c] * force
    return 0


@hook
def spend_on_pulses(pulses, tick):
    """Takes the work of the pulses since the last sample from the tank."""
    pulses, tick = _pulses_at(pulses), tick_at(tick)
    io, history, work = io_at(tick.io), history_at(tick.history), 0.0
    for c in range(io.channels):
        position = io.position_counts[c] * io.position_scale[c]
        force = 0.0
        for i in range(tick.gap):
            force += acting_force(history, IN_ALL + c, i) - acting_force(history, OF_SCENE + c, i)
        work += force / tick.gap * (position - pulses.position[c])
        pulses.position[c] = position
    if pulses.measures and tick.sample <= pulses.until and abs(work) < math.inf:
        tank = tank_at(pulses.tank)
        tank.level = min(tank.capacity, tank.level - work)
        pulses.spent += work
    pulses.measures = 1
    return 0


class LoopPulses:
    """The pulses of a loop: the writer's side of PULSES, for one thread at a time."""

    def __init__(self, record: Any, tank: Any) -> None:
        """`tank`: the loop's TANK, without an address if no energy is accounted for."""
        self.record, self._tank = record, tank
        self.forces: list[NDArray[np.float64]] = [np.zeros(0) for _ in range(schema.MAX_CHANNELS)]
        """Forces of each channel's newest pulse, N."""

    def hooks(self) -> list[Hook]:
        """Returns the hooks that a loop needs for pulses."""
        self.record.tank = self._tank.address
        spends = [Hook(Stage.KEEP, spend_on_pulses, self.record)] if self._tank.address else []
        return [Hook(Stage.LEAD, add_pulses, self.record), *spends]

    @property
    def lengths(self) -> tuple[int, ...]:
        """Samples of each channel's newest pulse; () before the first."""
        return tuple(map(len, self.forces)) if any(map(len, self.forces)) else ()

    def is_running(self, channel: int, sample: int) -> bool:
        """Returns whether a channel's newest pulse is not over at this sample."""
        begin = int(self.record.begin[channel])
        return begin == _NOT_BEGUN or sample + 1 - begin < int(self.record.count[channel])

    def words(self, channel: int, forces: Sequence[float]) -> Mapping[str, int]:
        """Takes the forces of a new pulse, N; returns the numbers that begin it, by the record's fields."""
        self.forces[channel] = np.array(forces)
        return {"forces": address_of(self.forces[channel]), "count": len(forces), "begin": _NOT_BEGUN}
