"""The samplings: how a motion becomes a number. A new one is an entry here, and its window in the mock.

The loop reads a sampling's window (``device_step.py``), an impedance its transfer function. That the two agree is a
test of both.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hapsim.holds import Term


def whole_and_fraction(delay: float) -> tuple[int, float]:
    """A delay in sample periods as whole samples and the fraction of one, 0 <= fraction < 1."""
    whole = math.floor(delay)
    return whole, delay - whole


class Sampling(NamedTuple):
    """How a motion becomes a number.

    Attributes:
        terms: of the transfer function from the position to the reading.
        window: sample periods, 0 to 1, that end with the sample, over which the reading is the mean; 0 where the
            position is read at the sample.
    """

    terms: tuple[Term, ...]
    window: float

    @property
    def lag(self) -> float:
        """Its mean delay in sample periods."""
        return 0.5 * self.window


IDEAL = Sampling(terms=(Term(1.0, 0.0, 0),), window=0.0)
"""The computer reads the position at the instant of the sample."""

AVERAGE = Sampling(terms=(Term(1.0, 0.0, 1), Term(-1.0, 1.0, 1)), window=1.0)
"""It reads the mean position over the sample period that has just ended: the paper's "1 sample integrator at input"
(Florens et al., §6.2)."""

SAMPLINGS: dict[str, Sampling] = {"ideal": IDEAL, "average": AVERAGE}
