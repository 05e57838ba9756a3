"""What a blow does to the real mass, and its integrals over time: all that a hold and a sampling are made of.

Time in sample periods. By the Taylor series of the whole chain velocity, position and its three integrals, halved
until it converges at once and then doubled: one code for no friction, hardly any, a spring, critical damping and
beyond.
"""

from __future__ import annotations

import math

import numpy as np

from hapsim.theory.arrays import Floats

VELOCITY, POSITION, AREA, DOUBLE_AREA, TRIPLE_AREA = range(5)
TAYLOR_TERMS = 20  # where friction and spring turn the motion by less than a half: beyond rounding


def response_to_a_blow(damping: float, stiffness: float, time: float) -> Floats:
    """(5,): velocity, position and its three integrals, ``time`` >= 0 after a unit blow on the mass at rest.

    ``damping``: b0 T/m. ``stiffness``: k0 T²/m.
    """
    chain = np.diag(np.ones(4), -1)
    chain[VELOCITY, [VELOCITY, POSITION]] = -damping, -stiffness
    turn = time * max(damping, math.sqrt(stiffness))
    halvings = max(0, math.ceil(math.log2(2.0 * turn))) if turn > 0.0 else 0
    scaled = chain * (time / 2.0**halvings)
    flow = np.eye(5)
    for n in reversed(range(1, TAYLOR_TERMS + 1)):
        flow = np.eye(5) + scaled @ flow / n
    return np.asarray(np.linalg.matrix_power(flow, 2**halvings)[:, VELOCITY])
