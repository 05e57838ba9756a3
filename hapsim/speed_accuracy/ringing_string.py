"""A string of masses with a hand on one of them: where its first modes ring.

It weighs 5 g and rings at 20 Hz with a damping ratio of 1e-4; its ends are fixed. The error is that of the frequency of
modes 1 to 5, the worst of them, identified from the run of each mode by itself; for these runs the hand's link is there
but without stiffness and damping, and for the time that a tick takes with a hundredth of a link's.
"""

from __future__ import annotations

import math
from functools import partial

from hapsim.scene import Device, DevicePoint, Scene, String, ViscoElastic
from hapsim.speed_accuracy.compared import Found
from hapsim.speed_accuracy.methods import schemes
from hapsim.speed_accuracy.release import record
from hapsim.speed_accuracy.ringing import STEADY, STEADY_IN_SINGLE, frequencies_of
from hapsim.speed_accuracy.strings import StringOfMasses, hand_link, held_mass

MODES = (1, 2, 3, 4, 5)


class RingingString:
    """A `string` and how it is called."""

    quantities: tuple[str, ...] = ("frequency",)

    def __init__(self, name: str, title: str, string: StringOfMasses) -> None:
        self.name, self.title, self.string = name, title, string

    def methods(self) -> tuple[str, ...]:
        return schemes()

    def scene(self, method: str, precision: str, rate: float) -> Scene:
        return scene_of(self.string, method, precision, rate, *hand_link(self.string))

    def found(self, method: str, precision: str, rate: float) -> Found:
        """Rings it in some of its modes: the frequency that is furthest off, relative."""
        steady = STEADY if precision == "double" else STEADY_IN_SINGLE
        ring = partial(record, scene_of(self.string, method, precision, rate), self.string)
        rung = frequencies_of(ring, self.string, rate, MODES, steady=steady)
        errors = [frequency / self.string.frequency(mode) - 1.0 for mode, frequency in zip(MODES, rung, strict=True)]
        if not all(math.isfinite(error) for error in errors):
            return Found({}, "unstable")
        return Found({"frequency": max(errors, key=abs)})


def scene_of(
    string: StringOfMasses, method: str, precision: str, rate: float, stiffness: float = 0.0, damping: float = 0.0
) -> Scene:
    """The string as a scene; the hand's link in N/m and N·s/m."""
    return Scene(
        version=1,
        scheme=method,  # type: ignore[arg-type]
        precision=precision,  # type: ignore[arg-type]
        rate=rate,
        device=Device(clock="lockstep", mass=0.2),
        modules={
            "hand": DevicePoint(channel=0),
            "string": String(
                masses=string.masses,
                mass=string.mass,
                stiffness=string.stiffness,
                damping=string.damping,
                bending=string.bending,
            ),
            "touch": ViscoElastic(
                between=("hand", f"string.{held_mass(string)}"), stiffness=stiffness, damping=damping
            ),
        },
    )
