"""Integration schemes: the step of a linear system from one sample to the next, by the scene's names for the schemes.

The numbers z have the rates of change A z, such as positions and velocities under M x'' + B x' + K x = f. The rest of
the theory uses only the attributes of a scheme and never its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats

TAYLOR_TERMS = 18  # for a norm of 1: beyond rounding
FASTEST = 1000.0  # limit of the radians in a sample period, about, for twelve digits of a sparse exponential
LEAST_ENTRY = 1e-18  # smaller entries of a sparse exponential are dropped
MOST_ENTRIES = 10_000_000  # in a sparse exponential; more would take over a minute


class NotWorkedOutError(Exception):
    """Raised if the poles of a scene cannot be computed for its scheme; the message is the reason, after a colon."""


class LinkNature(NamedTuple):
    """Properties of a link that a scheme depends on.

    Attributes:
        in_a_matrix: the link is a spring and a backward damper and nothing else.
        memoryless: its force depends on the present positions and velocities of its ends alone.
        at_channel: one of its ends is a device channel.
    """

    in_a_matrix: bool
    memoryless: bool
    at_channel: bool


def in_a_matrix(link: LinkNature) -> bool:
    """Returns whether a scheme that puts the scene into one matrix includes the link."""
    return link.in_a_matrix and not link.at_channel


def between_samples(link: LinkNature) -> bool:
    """Returns whether a scheme that needs forces at several instants of a sample period can compute this link's."""
    return link.memoryless


class Scheme(NamedTuple):
    """Scheme other than CORDIS's.

    Attributes:
        change: function of T A (N, N), several z (N, n) and T times other rates (N, n), held from sample to sample.
            It returns z[n+1] - z[n] (N, n), as arrays or scipy's sparse matrices. If the change is not sparse: the
            share for which (1 - share T A) (z[n+1] - z[n]) = T A z[n] + held.
        inside: function that returns whether the force of a link is computed between two samples, as in the kernel.
            The force of any other link is held from sample to sample.
    """

    change: Callable[[Any, Any, Any], Any] | float
    inside: Callable[[LinkNature], bool]

    def changed(self, rates: Any, z: Any, held: Any) -> Any:
        """Returns z[n+1] - z[n], of arrays, or of sparse matrices if the change is sparse."""
        if callable(self.change):
            return self.change(rates, z, held)
        return np.linalg.solve(np.eye(len(rates)) - self.change * rates, rates @ z + held)


def exactly(rates: Any, z: Any, held: Any) -> Any:
    """Returns (exp(T A) - 1) z plus the integral of exp(T A s), s from 0 to 1, times ``held``.

    The method is the Taylor series of A/2^n, doubled n times. Sparse matrices drop their negligible entries.

    Raises:
        NotWorkedOutError: the motion is too fast for a sparse matrix, or too many entries remain.
    """
    size = float(abs(rates).sum(axis=1).max()) if rates.shape[0] else 0.0
    if isinstance(rates, np.ndarray):
        trimmed, one = _keep, np.eye(len(rates))
        if not math.isfinite(size):
            return np.full(z.shape, np.nan)
    else:
        from scipy.sparse import eye

        trimmed, one = _trim, eye(rates.shape[0], format="csr")
        if not size <= FASTEST:
            raise NotWorkedOutError("its fastest motion is too fast for the rate")
    halvings = math.ceil(math.log2(max(size, 1.0)))
    scaled = rates / 2.0**halvings
    mean = one
    for n in reversed(range(2, TAYLOR_TERMS + 2)):
        mean = trimmed(one + scaled @ mean / n)
    flow = scaled @ mean
    for _ in range(halvings):  # doubles the time
        mean = trimmed(mean + 0.5 * (flow @ mean))
        flow = trimmed(2.0 * flow + flow @ flow)
    return flow @ z + mean @ held


def _keep(matrix: Floats) -> Floats:
    return matrix


def _trim(matrix: Any) -> Any:
    matrix.data[np.abs(matrix.data) < LEAST_ENTRY] = 0.0
    matrix.eliminate_zeros()
    if matrix.nnz > MOST_ENTRIES:
        raise NotWorkedOutError("each of its masses moves too many others in a sample period")
    return matrix


def _rk4(rates: Any, z: Any, held: Any) -> Any:
    """Returns the Runge-Kutta step, dense or sparse: exp(s T) becomes 1 + z + z²/2 + z³/6 + z⁴/24 with z = s T."""
    rate = rates @ z + held
    return rate + rates @ (rate + rates @ (rate + rates @ rate / 4.0) / 3.0) / 2.0


SCHEMES: dict[str, Scheme | None] = {
    "cordis": None,
    "semi_implicit": None,  # v[n+1] = v[n] + T F[n]/m, x[n+1] = x[n] + T v[n+1]: equals CORDIS's scheme
    "midpoint": Scheme(0.5, in_a_matrix),  # every exp(s T) becomes (1 + s T/2)/(1 - s T/2)
    "rk4": Scheme(_rk4, between_samples),
    "exact": Scheme(exactly, in_a_matrix),
}
"""Schemes by name; None: CORDIS's scheme, m/T² (x[n+1] - 2 x[n] + x[n-1]) = F[n] for every mass."""
