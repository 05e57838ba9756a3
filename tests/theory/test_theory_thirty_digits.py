"""The simulated element of (k, b) against 50-digit arithmetic, for every configuration, over twelve decades."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from hapsim.theory import Configuration

MASS, RATE = 0.2, 1000.0
UNIT = MASS * RATE**2
HOLDS = ("zoh", "impulse")
SAMPLINGS = ("ideal", "average")
DELAYS = (0.0, 0.37, 1.0, 1.5, 2.0)
DAMPERS = {"backward": None, "centred": None, "filtered": 80.0, "sensed": None}
RATIOS = (0.001, 0.1, 0.5, 0.999, 1.0 - 1e-9, 1.0, 1.0 + 1e-9, 1.001, 1.5, 3.0)
Readings = Callable[[mp.mpf], tuple[mp.mpf, mp.mpf]]


def readings_of(c: Configuration) -> Readings:
    """Returns the loop's readings after one computed force, (position, growth that the damper uses), at z.

    By matrix exponentials of velocity, position, the position's integral and the held force; no transform of it is
    written down.
    """
    m, T, b0, k0 = mp.mpf(c.mass), 1 / mp.mpf(c.rate), mp.mpf(c.friction), mp.mpf(c.stiffness)
    whole = int(mp.floor(c.delay))
    late = (mp.mpf(c.delay) - whole) * T
    rate = mp.matrix([[0, 1, 0, 0], [-k0 / m, -b0 / m, 1 / m, 0], [0, 0, 0, 0], [1, 0, 0, 0]])
    before, after, full = (mp.expm(rate * t, method="taylor") for t in (late, T - late, T))
    if c.hold == "zoh":
        ended = before * mp.matrix([0, 0, 1, 0])
        ended[2] = 0
        effects = {whole: after * mp.matrix([0, 0, 1, 0]), whole + 1: after * ended}
    else:
        effects = {whole: after * mp.matrix([0, T / m, 0, 0])}

    def read(z: mp.mpf) -> tuple[mp.mpf, mp.mpf]:
        effect = mp.matrix([0, 0, 0, 0])
        for age, column in effects.items():
            effect += column * z**-age
        x, v = mp.lu_solve(z * mp.eye(2) - full[0:2, 0:2], effect[0:2])
        if c.sampling == "average":
            # The mean of the position over the period, and of the velocity: the way made in it.
            v = (x - x / z) / T
            x = (full[3, 0] * x + full[3, 1] * (z * x - full[0, 0] * x - effect[0]) / full[0, 1] + effect[3]) / (T * z)
        return x, velocity(x, v, z)

    def velocity(x: mp.mpf, v: mp.mpf, z: mp.mpf) -> mp.mpf:
        if c.damper == "sensed":
            return v
        if c.damper == "centred":
            return (x - x / z**2) / (2 * T)
        difference = (x - x / z) / T
        if c.damper == "filtered":
            kept = mp.exp(-2 * mp.pi * mp.mpf(c.cutoff) * T)
            return (1 - kept) * difference / (1 - kept / z)
        return difference

    return read


def simulated_to_50_digits(c: Configuration, read: Readings, k: float, b: float) -> tuple[mp.mpf, mp.mpf]:
    """1 + K x + B v = 0 at both poles, per unit of computed force."""
    m, T, k, b = mp.mpf(c.mass), 1 / mp.mpf(c.rate), mp.mpf(k), mp.mpf(b)
    root = mp.sqrt((b / (2 * m)) ** 2 - k / m) or mp.mpf(10) ** -25
    (x1, v1), (x2, v2) = (read(mp.exp(T * (-b / (2 * m) + sign * root))) for sign in (1, -1))
    determinant = x1 * v2 - x2 * v1
    return mp.re((v1 - v2) / determinant), mp.re((x2 - x1) / determinant)


def worst_errors(c: Configuration, k: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """The largest relative errors of K and of B."""
    K, B = c.simulated(k, b, dominant=False)
    worst = [0.0, 0.0]
    with mp.workdps(60):
        read = readings_of(c)
        for index in np.ndindex(b.shape):
            exact = simulated_to_50_digits(c, read, np.broadcast_to(k, b.shape)[index], b[index])
            for which, found in enumerate((K[index], B[index])):
                worst[which] = max(worst[which], float(abs(found / exact[which] - 1)))
    return worst[0], worst[1]


# Every damper, and a spring of the device; and two more frictions, with digits that such a spring would take.
DEVICES = [("backward", 0.0, friction) for friction in (0.0, 1.0)]
DEVICES += [(damper, stiffness, 0.7) for damper in DAMPERS for stiffness in (0.0, 0.04, 4e4)]


@pytest.mark.thorough(keep=8)
@pytest.mark.parametrize(("damper", "stiffness", "friction"), DEVICES)
@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize("hold", HOLDS)
def test_simulated_agrees_over_twelve_decades(
    hold: str, sampling: str, delay: float, damper: str, stiffness: float, friction: float, figures: Any
) -> None:
    device = {"friction": friction, "delay": delay, "hold": hold, "sampling": sampling, "stiffness": stiffness}
    c = Configuration(MASS, RATE, **device, damper=damper, cutoff=DAMPERS[damper])  # type: ignore[arg-type]
    # The element's own stiffness goes over the decades; what is felt has the device's spring too.
    k = stiffness + (np.geomspace(1e-12, 0.3 if stiffness or damper != "backward" else 3.0, 6) * UNIT)[:, None]
    ratios = np.array((0.1, 1.0 - 1e-9, 1.5) if friction == 0.7 else RATIOS)
    K_error, B_error = worst_errors(c, k, 2.0 * ratios * np.sqrt(k * MASS))
    assert K_error < (1e-9 if friction == 0.7 else 5e-12)  # a spring a millionth as stiff as the device's own
    assert B_error < 5e-12
    figures.most(f"K off by, relative, over twelve decades{', beside a spring' if stiffness else ''}", K_error)
    figures.most("B off by, relative, over twelve decades", B_error)


@pytest.mark.parametrize("delay", [0.0, 1.5])
def test_a_soft_spring_on_heavy_friction_keeps_the_digits_of_its_small_damping(delay: float) -> None:
    """Asked for just the real friction, B has only to make up for the delay: about K T (delay + 1/2)."""
    c = Configuration(mass=MASS, rate=RATE, friction=100.0, delay=delay)
    k = np.geomspace(1e-12, 1e-4, 5) * UNIT
    K, B = c.simulated(k, c.friction)
    with mp.workdps(60):
        read = readings_of(c)
        for i in range(k.size):
            exact_k, exact_b = simulated_to_50_digits(c, read, k[i], c.friction)
            assert abs(K[i] / exact_k - 1) < 1e-13
            assert abs(B[i] / exact_b - 1) < 1e-11
