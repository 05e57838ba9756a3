"""Random devices, and passive things behind their virtual couplings: the loop written out, as referee of the theory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from hapsim.theory import Configuration
from hapsim.theory.coupling import Coupling, stiffest_for


class Behind(NamedTuple):
    """Things behind a coupling, at one point: a mass, a spring and a damper in the backward difference (a contact is
    such a spring and damper, or nothing), and a mass without losses by the trapezoidal rule. The damper may be centred,
    or have a filter of this share."""

    mass: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    lossless: float = 0.0
    damper: str = "backward"
    share: float = 0.3


def radius(hand: Configuration, coupling: Coupling, scene: Behind) -> float:
    """Spectral radius of a hand's mass, friction and spring, a zero-order or ramp hold, a delay, whole or not, the
    coupling and what is behind it."""
    m, k, b, T = hand.mass, hand.stiffness, hand.friction, hand.period
    (Kc, Bc), (M, K, B, lossless, damper, share) = coupling, scene
    rates = np.array([[0.0, 1.0, 0.0, 0.0], [-k / m, -b / m, 1.0 / m, 0.0], [0.0] * 4, [0.0] * 4])
    whole, fraction = divmod(hand.delay, 1.0)
    ramps = hand.hold == "ramp"
    count = int(whole) + (fraction > 0.0) + ramps  # of forces that are on their way
    unit = np.eye(count + 7)
    x, v, (x1, y1, y2, last, filtered) = unit[0], unit[1], unit[2 + count :]
    L = 2.0 * lossless / T**2
    # The damper's force is Z y less what it knows from before.
    Z, before = {
        "backward": (B / T, B / T * y1),
        "centred": (0.5 * B / T, 0.5 * B / T * y2),
        "filtered": (share * B / T, share * B / T * y1 - (1.0 - share) * B * filtered),
    }[damper]
    total = Kc + Bc / T + K + Z + M / T**2 + L
    pushed = (Kc + Bc / T) * x - Bc / T * x1 + Bc / T * y1 + before + (M / T**2 + L) * (2.0 * y1 - y2)
    y = (pushed + last) / total
    force = -(Kc * (x - y) + Bc / T * (x - x1 - y + y1))
    ages = [force, *unit[2 : 2 + count]]
    moved = np.stack([x, v])
    new, before = ages[int(whole)], ages[min(int(whole) + 1, count)]
    parts = ((fraction, before, before), (1.0 - fraction, new, new))
    if ramps:
        begin = fraction * ages[-1] + (1.0 - fraction) * before
        parts = ((fraction, begin, before), (1.0 - fraction, before, fraction * before + (1.0 - fraction) * new))
    for share_of_period, begin, end in parts:
        change = rates * share_of_period * T
        change[2, 3] = 1.0  # the force, on a straight line
        step = expm(change)[:2]
        moved = step[:, :2] @ moved + np.outer(step[:, 2], begin) + np.outer(step[:, 3], end - begin)
    velocity = (1.0 - share) * filtered + share * (y - y1) / T
    trapezoidal = L * (y - 2.0 * y1 + y2) - last if L else 0.0 * last
    rows = [*moved, *ages[:count], x, y, y1, trapezoidal, velocity]
    scale = np.array([1.0, T, *[T**2 / m] * count, 1.0, 1.0, 1.0, T**2 / m, T])  # all of one size, or digits are lost
    matrix = np.array(rows) * scale / scale[:, None]
    if k == K == 0.0:  # nothing holds it: relative to x, without the drift of all, whose 1 is exact
        change = np.eye(len(matrix))
        change[2 + count : 5 + count, 0] = -1.0
        matrix = (change @ matrix @ (2.0 * np.eye(len(matrix)) - change))[1:, 1:]
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))


def random_device(rng: np.random.Generator) -> Configuration:
    """Mostly with little friction, from 300 Hz to 60 kHz."""
    mass, rate = 10 ** rng.uniform(-2.0, 1.0), 10 ** rng.uniform(2.5, 4.8)
    stiffness = 0.0 if rng.random() < 0.6 else min(10 ** rng.uniform(-1.0, 4.0), 0.1 * mass * rate**2)
    delay = float(rng.integers(0, 7)) + (rng.uniform() if rng.random() < 0.3 else 0.0)
    friction, hold = 10 ** rng.uniform(-3.0, 1.0), "ramp" if rng.random() < 0.3 else "zoh"
    return Configuration(mass, rate, friction, delay, hold, stiffness=stiffness)


def random_behind(rng: np.random.Generator) -> Behind:
    of = ((-5.0, 1.0), (0.0, 7.0), (-2.0, 3.0), (-4.5, 1.0))
    amounts = (0.0 if rng.random() < 0.4 else 10 ** rng.uniform(*ends) for ends in of)
    return Behind(*amounts, str(rng.choice(["backward", "centred", "filtered"])), float(rng.uniform(0.05, 1.0)))


def hard_ones(hand: Configuration, coupling: Coupling) -> Iterator[Behind]:
    """Springs and masses without losses, of every size: each is in resonance with device and coupling at one frequency,
    where nothing else damps."""
    for share in np.geomspace(1e-9, 1e3, 61).tolist():
        yield Behind(stiffness=share * coupling.stiffness)
        yield Behind(lossless=share * hand.mass)


def judged(seed: int, count: int) -> tuple[Configuration, Coupling, float]:
    """A random device, the stiffest coupling for its mass, and the largest radius with the hard ones and `count` random
    things behind."""
    rng = np.random.default_rng(seed)
    hand = random_device(rng)
    coupling = stiffest_for([hand])
    assert coupling is not None
    scenes = [*hard_ones(hand, coupling), *(random_behind(rng) for _ in range(count))]
    return hand, coupling, max(radius(hand, coupling, scene) for scene in scenes)
