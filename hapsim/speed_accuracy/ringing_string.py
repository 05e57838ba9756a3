"""A string of masses with a hand on one of them: where its first modes ring.

It weighs 5 g and rings at 20 Hz with a damping ratio of 1e-4; its ends are fixed. The error is that of the frequency of
modes 1 to 5, the worst of them, identified from the run of each mode by itself. For these runs the hand's link has
neither stiffness nor damping; for the time that a tick takes, a hundredth of a link's.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
from scipy.fft import dst

from hapsim.cordis.offline import start, ticks_watched
from hapsim.cordis.program import compile_scene, numbers_of
from hapsim.cordis.schemes import SCHEMES
from hapsim.cordis.schemes.exact import ExactModes
from hapsim.scene import Device, DevicePoint, Scene, String, ViscoElastic
from hapsim.speed_accuracy.results import Found
from hapsim.speed_accuracy.strings import STEADY, StringOfMasses, Vector, frequencies_of, hand_link, held_mass

MODES = (1, 2, 3, 4, 5)
_STEADY_IN_SINGLE = 1.0 + 1e-4


class RingingString:
    """A `string` and how it is called."""

    quantities: tuple[str, ...] = ("frequency",)
    methods: tuple[str, ...] = tuple(SCHEMES)

    def __init__(self, name: str, title: str, string: StringOfMasses) -> None:
        self.name, self.title, self.string = name, title, string

    def scene(self, method: str, precision: str, rate: float) -> Scene:
        """Returns the string with a hand's link, simulated by `method` at `rate` (Hz)."""
        return scene_of(self.string, method, precision, rate, *hand_link(self.string))

    def found(self, method: str, precision: str, rate: float) -> Found:
        """Rings it in some of its modes: the frequency that is furthest off, relative."""
        steady = STEADY if precision == "double" else _STEADY_IN_SINGLE
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
    ends = ("hand", f"string.{held_mass(string)}")
    modules: dict[str, Any] = {
        "hand": DevicePoint(channel=0),
        "string": String(**asdict(string)),
        "touch": ViscoElastic(between=ends, stiffness=stiffness, damping=damping),
    }
    numerics: Any = {"scheme": method, "precision": precision}
    return Scene(version=1, rate=rate, device=Device(clock="lockstep", mass=0.2), modules=modules, **numerics)


def record(scene: Scene, string: StringOfMasses, shape: Vector, samples: int) -> Vector:
    """The motion along `shape` (N,), sample by sample, once the scene's string was released in it; shape (samples,)."""
    program = compile_scene(scene)
    # It is kept as positions of its masses in the row whose turn it is; or, by the exact scheme, as how much there is
    # of each of its modes: sines, all of one norm, the slowest first.
    modes = next((part.numbers for part in program.parts if isinstance(part.numbers, ExactModes)), None)
    if modes is not None:
        rows, amounts = 2 * [modes.position], dst(shape, type=1) / (shape.size + 1)
    else:
        first = numbers_of(scene)["string.0"]
        rows, amounts = [row[first:] for row in program.rows], shape
    for row in rows:
        row[: string.masses] = amounts
    start(program, np.zeros(scene.channels))
    watched = np.empty(samples)
    ticks_watched(program, rows, amounts / (amounts @ amounts), watched)
    return watched
