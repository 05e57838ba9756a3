"""The samplings: how a motion becomes a number. A new one is an entry here, and its reading in the mock."""

from __future__ import annotations

from typing import NamedTuple

from hapsim.theory.interface.terms import Term


class Sampling(NamedTuple):
    """How a motion becomes a number: its terms, its mean delay, and whether it is the mean over the period."""

    terms: tuple[Term, ...]
    lag: float
    reads_mean: bool


IDEAL = Sampling(terms=(Term(1.0, 0.0, 0),), lag=0.0, reads_mean=False)
"""The computer reads the position at the instant of the sample."""

AVERAGE = Sampling(terms=(Term(1.0, 0.0, 1), Term(-1.0, 1.0, 1)), lag=0.5, reads_mean=True)
"""It reads the mean position over the sample period that has just ended: the paper's "1 sample integrator at input"
(Florens et al., §6.2)."""

SAMPLINGS: dict[str, Sampling] = {"ideal": IDEAL, "average": AVERAGE}
