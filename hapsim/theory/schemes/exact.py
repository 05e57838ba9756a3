"""The exact solution: exp(A T), with A the rates of change."""

from __future__ import annotations

from hapsim.theory.arrays import Floats
from hapsim.theory.schemes.scheme import Advance, ByModes, SchemeModel, always_stable, in_a_matrix, step_by


def _advance(rates: Floats, start: Floats) -> Floats:
    from scipy.linalg import expm

    after: Floats = expm(rates) @ start
    return after


EXACT = SchemeModel(
    step_by(_advance), always_stable, order=0, error=0.0, advance=Advance(_advance, in_a_matrix, ByModes())
)
