"""Of a loop that is unstable as it stands: between which factors of one link's stiffness, or damping, it is stable.

Those that it crosses on its way from 0 to infinity are known, and how many poles go outward at each (``margin.py``). So
is how many are outside as it stands, at 1. Where the count is none in between two of them, it is stable.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Floats
from hapsim.theory.network.margin_poles import Range, Varied


class Stabilizing(NamedTuple):
    """By what a link's stiffness, and its damping, may be multiplied so that an unstable loop becomes stable, all else
    as it is.

    The nearest range of factors (from, to) below 1, and the nearest above, as far as there are any: from 0, or to
    infinity, where it has no other end. None where they were not worked out.
    """

    stiffness: tuple[Range, ...] | None
    damping: tuple[Range, ...] | None


def stable_ranges(factors: Floats, poles: NDArray[np.intp], growing: int) -> tuple[Range, ...] | None:
    """Those of one link's quantity; None where a factor is not known.

    ``factors``: at which it takes poles across the circle; ``poles``: how many go outward as the factor grows;
    ``growing``: how many are outside at a factor of 1.
    """
    if not np.isfinite(factors).all():
        return None
    order = np.argsort(factors, kind="stable")
    ends = np.concatenate([[0.0], factors[order], [math.inf]])
    gone = np.concatenate([[0], np.cumsum(poles[order])])
    outside = growing + gone - gone[np.searchsorted(ends, 1.0) - 1]
    stable = np.concatenate([[False], outside <= 0, [False]])
    first, last = np.flatnonzero(~stable[:-1] & stable[1:]), np.flatnonzero(stable[:-1] & ~stable[1:])
    every = list(zip(ends[first].tolist(), ends[last].tolist(), strict=True))
    below, above = [one for one in every if one[1] <= 1.0], [one for one in every if one[0] >= 1.0]
    return (*below[-1:], *above[:1])


def by_poles_agree(varied: Varied, ranges: tuple[Range, ...] | None) -> bool:
    """Whether the loop's poles are within the circle in each, and not just outside it; or nowhere, where there is
    none."""
    if ranges is None:
        return False
    if not ranges:
        return all(varied.is_unstable(factor) for factor in (1e-6, 0.5, 2.0, 30.0))
    return all(varied.is_stable_between(*one) for one in ranges)
