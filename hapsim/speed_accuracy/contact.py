"""A simulated mass thrown against a buffer on a ground: how long it stays, and how fast it leaves.

While it is below the surface by p, a real contact that never pulls holds m p'' = -max(0, K p + B p'). Thrown with
velocity v it is at p = 0 at the time 0. With w = sqrt(K/m), z = B/(2 sqrt(K m)) the force ends, before the surface is
reached again, when K p + B p' = 0: at

    t = 2 acos(z)/(w sqrt(1 - z²)),      with the velocity e v,      e = exp(-2 z acos(z)/sqrt(1 - z²))

From there the mass flies, and crosses the surface at t + B/K. So its stay below the surface, from the straight line on
which it came to that on which it leaves, both exact whatever the samples, and its restitution e give K and B: z from
-ln e, then w from the stay. `found` reads both lines from the samples, takes the k and b that would have the same stay
and restitution in continuous time, and says how far they are off: the root mean square over several phases of arrival
between two samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from hapsim.cordis.offline import start, ticks_watched
from hapsim.cordis.program import compile_scene, numbers_of
from hapsim.cordis.schemes import SCHEMES
from hapsim.scene import Buffer, Device, DevicePoint, Ground, Mass, Scene
from hapsim.speed_accuracy.results import Found

MASS = 0.02  # kg
STIFFNESS, DAMPING = 8000.0, 0.85  # N/m, N·s/m
VELOCITY = 1.0  # m/s
PHASES = 8

_STAYS = 6.0  # of the continuous one: a mass that is below for longer does not leave
_SO_HEAVY = 1e9  # kg: it stays where it is


class Contact:
    """5 ms long, with a restitution of 0.9."""

    name = "contact"
    title = "a mass thrown against a buffer"
    quantities: tuple[str, ...] = ("k", "b")
    methods: tuple[str, ...] = tuple(SCHEMES)

    def scene(self, method: str, precision: str, rate: float) -> Scene:
        """A mass so heavy that the buffer is touched in every sample, which is the dearer of its two cases."""
        return _scene(method, precision, rate, Mass(mass=_SO_HEAVY, position=-1e-3))

    def found(self, method: str, precision: str, rate: float) -> Found:
        """Throws the mass at the surface PHASES times, each a part of a sample later: rms of k and b, relative."""
        pairs = []
        for i in range(PHASES):
            stay, restitution = _thrown(method, precision, rate, (i + 0.5) / PHASES)
            if not (math.isfinite(stay) and 0.0 < restitution < math.inf):
                return Found({}, "the mass did not leave again, or faster and faster")
            pairs.append(contact_felt(stay, restitution))
        if not np.isfinite(pairs).all():
            return Found({}, "no spring and damper throws back so little")
        k, b = np.transpose(pairs)
        off_k, off_b = (float(np.sqrt(np.mean(off**2))) for off in (k / STIFFNESS - 1.0, b / DAMPING - 1.0))
        return Found({"k": off_k, "b": off_b})


def contact_of(k: float, b: float, mass: float = MASS) -> tuple[float, float]:
    """(stay below the surface in s, restitution) of the continuous contact, z < 1; a negative b throws back faster."""
    z = b / (2.0 * math.sqrt(k * mass))
    angle = math.acos(z) / math.sqrt(1.0 - z * z)
    return math.sqrt(mass / k) * (2.0 * angle + 2.0 * z), math.exp(-2.0 * z * angle)


def contact_felt(stay: float, restitution: float, mass: float = MASS) -> tuple[float, float]:
    """(k, b) of the continuous contact with this stay and restitution. NaN where there is none."""
    lost = -math.log(restitution)
    most = 1.0 - 1e-9

    def beyond(z: float) -> float:
        return 2.0 * z * math.acos(z) / math.sqrt(1.0 - z * z) - lost

    if not beyond(-most) < 0.0 < beyond(most):
        return math.nan, math.nan
    z = float(brentq(beyond, -most, most, xtol=1e-16, rtol=1e-14))
    w = 2.0 * (math.acos(z) / math.sqrt(1.0 - z * z) + z) / stay
    return mass * w * w, 2.0 * z * mass * w


def _thrown(method: str, precision: str, rate: float, phase: float) -> tuple[float, float]:
    """(stay, restitution) of a mass that reaches the surface `phase` of a sample period after a sample."""
    above = (2.0 + phase) * VELOCITY / rate
    scene = _scene(method, precision, rate, Mass(mass=MASS, position=above, velocity=-VELOCITY))
    program, ball = compile_scene(scene), numbers_of(scene)["ball"]
    start(program, np.zeros(scene.channels))
    watched = np.empty(math.ceil(_STAYS * contact_of(STIFFNESS, DAMPING)[0] * rate) + 8)
    ticks_watched(program, [row[ball:] for row in program.rows], np.ones(1), watched)
    return stay_of([above, *watched], rate)


def stay_of(positions: Sequence[float] | NDArray[np.float64], rate: float) -> tuple[float, float]:
    """(stay in s, restitution) from the lines of flight through the first two and the last two positions."""
    x = np.asarray(positions)
    came, left = x[1] - x[0], x[-1] - x[-2]
    if not (np.isfinite(x).all() and came < 0.0 < left and x[-2] > 0.0):
        return math.nan, math.nan
    arrival = -x[0] / came
    departure = x.size - 1 - x[-1] / left
    return float((departure - arrival) / rate), float(-left / came)


def _scene(method: str, precision: str, rate: float, ball: Mass) -> Scene:
    modules: dict[str, Any] = {
        "hand": DevicePoint(channel=0),
        "floor": Ground(),
        "ball": ball,
        "bounce": Buffer(between=("ball", "floor"), stiffness=STIFFNESS, damping=DAMPING),
    }
    numerics: Any = {"scheme": method, "precision": precision}
    return Scene(version=1, rate=rate, device=Device(clock="lockstep", mass=0.2), modules=modules, **numerics)
