"""Averaged sampling: the computer reads the mean position over the sample period that has just ended.

The paper's "1 sample integrator at input" (Florens et al., §6.2).
"""

from __future__ import annotations

from hapsim.theory.interface.shape import Sampling, Term

AVERAGE = Sampling(terms=(Term(1.0, 0, 1), Term(-1.0, 1, 1)), lag=0.5, reads_mean=True)
