"""Ideal sampling: the computer reads the position at the instant of the sample."""

from __future__ import annotations

from hapsim.theory.interface.shape import Sampling, Term

IDEAL = Sampling(terms=(Term(1.0, 0, 0),), lag=0.0, reads_mean=False)
