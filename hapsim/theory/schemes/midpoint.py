"""The implicit midpoint scheme: z[n+1] = z[n] + T A (z[n] + z[n+1])/2, with A the rates of change.

Every motion's exp(s T) becomes (1 + s T/2)/(1 - s T/2), which is within the circle wherever s is left of the imaginary
axis. Undamped, tan(theta/2) = omega T/2, so theta = omega T (1 - (omega T)²/12 + ...).
"""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.schemes.scheme import Advance, Implicit, SchemeModel, always_stable, in_a_matrix, step_by


def _advance(rates: Floats, start: Floats) -> Floats:
    half = 0.5 * rates
    return np.asarray(np.linalg.solve(np.eye(len(half)) - half, start + half @ start), float)


MIDPOINT = SchemeModel(
    step_by(_advance),
    always_stable,
    order=2,
    error=-1.0 / 12.0,
    advance=Advance(_advance, in_a_matrix, Implicit(0.5)),
)
