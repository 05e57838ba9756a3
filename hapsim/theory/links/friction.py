"""Dry friction: stuck it is a spring, sliding a constant force, which has neither stiffness nor damping.

The linear theory takes it as stuck, which is what a small motion meets. Of a large one the first harmonic tells
(`describing_function`): the stiffness falls towards nothing as the swing grows, and the part that is in phase with the
velocity is always positive: over a closed cycle friction only ever takes energy (Dahl; Hayward and Armstrong).

That holds in continuous time. Sampled and delayed, the bristle that sticks is a spring like any other, and one too
stiff for the loop shakes the hand: where the stuck loop is unstable the motion grows until it slides enough to lose in
a cycle what the delay adds, and stays there, a limit cycle of about the width of the bristle's reach.
"""

from __future__ import annotations

import math

from hapsim.theory.links.linear import Linear


def friction(stiffness: float, damping: float) -> Linear:
    """Friction while it sticks: its bristle. N/m, N·s/m."""
    return Linear(stiffness, damping, "is taken as stuck, a spring; sliding, its force is constant and adds none")


def describing_function(force: float, stiffness: float, amplitude: float) -> complex:
    """First harmonic of the tension over that of d = amplitude cos(wt), N/m, where static and kinetic force are equal.

    The real part is a stiffness; the imaginary part is the damping times w, of whatever frequency. With the bristle's
    reach z = force/stiffness, where amplitude > z:

        cos p = 1 - 2 z/amplitude,      N = (K/pi) (p - sin p cos p + j sin² p)
    """
    reach = force / stiffness
    if not amplitude > reach:
        return complex(stiffness, 0.0)
    angle = math.acos(1.0 - 2.0 * reach / amplitude)
    in_phase, across = angle - math.sin(angle) * math.cos(angle), math.sin(angle) ** 2
    return stiffness / math.pi * complex(in_phase, across)
