"""How a scheme moves a linear system from one sample to the next, by the scene's names for the schemes.

z are numbers whose rates of change are A z, such as positions and velocities under M x'' + B x' + K x = f. The rest of
the theory reads what a scheme says of itself and never its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats

TAYLOR_TERMS = 18  # for a norm of 1: beyond rounding
FASTEST = 1000.0  # about the radians in a sample period up to which a sparse exponential keeps twelve digits
NOTHING = 1e-18  # an entry of a sparse exponential below this is dropped
MOST_ENTRIES = 10_000_000  # of a sparse exponential: what follows takes a minute


class NotWorkedOutError(Exception):
    """The poles of this scene are not worked out for its scheme; the words say why, and follow a colon."""


class LinkNature(NamedTuple):
    """What a scheme needs to know of a link.

    Attributes:
        in_a_matrix: the link is a spring and a backward damper and nothing else.
        memoryless: its force depends on the positions and velocities of its ends and on nothing earlier.
        at_channel: one of its ends is a device channel.
    """

    in_a_matrix: bool
    memoryless: bool
    at_channel: bool


def in_a_matrix(link: LinkNature) -> bool:
    """Whether a scheme that puts the scene into one matrix includes the link."""
    return link.in_a_matrix and not link.at_channel


def at_every_instant(link: LinkNature) -> bool:
    """Whether a scheme that needs forces at several instants of a sample period can have this link's."""
    return link.memoryless


class Scheme(NamedTuple):
    """A scheme other than CORDIS's.

    Attributes:
        change: returns z[n+1] - z[n]: (N, N) T A, (N, n) several z, and (N, n) T times what else changes them, held
            from sample to sample -> (N, n), arrays or scipy's sparse matrices; or, where that is not sparse, the share
            for which (1 - share T A) (z[n+1] - z[n]) = T A z[n] + held.
        inside: whether a link is asked for its force between two samples, as in the kernel. The force of any other
            link is held from sample to sample.
    """

    change: Callable[[Any, Any, Any], Any] | float
    inside: Callable[[LinkNature], bool]

    def changed(self, rates: Any, z: Any, held: Any) -> Any:
        """What ``change`` says, of arrays, or of sparse matrices where it is sparse."""
        if callable(self.change):
            return self.change(rates, z, held)
        return np.linalg.solve(np.eye(len(rates)) - self.change * rates, rates @ z + held)


def exactly(rates: Any, z: Any, held: Any) -> Any:
    """(exp(T A) - 1) z and the integral of exp(T A s), s from 0 to 1, times ``held``: by the Taylor series of A/2^n,
    doubled n times.

    Of sparse matrices what is next to nothing, far from the diagonal, is dropped.

    Raises:
        NotWorkedOutError: too much is left of a sparse one.
    """
    size = float(abs(rates).sum(axis=1).max()) if rates.shape[0] else 0.0
    if isinstance(rates, np.ndarray):
        trimmed, one = _whole, np.eye(len(rates))
        if not math.isfinite(size):
            return np.full(z.shape, np.nan)
    else:
        from scipy.sparse import eye

        trimmed, one = _trimmed, eye(rates.shape[0], format="csr")
        if not size <= FASTEST:
            raise NotWorkedOutError("its fastest motion is too fast for the rate")
    halvings = math.ceil(math.log2(max(size, 1.0)))
    scaled = rates / 2.0**halvings
    mean = one
    for n in reversed(range(2, TAYLOR_TERMS + 2)):
        mean = trimmed(one + scaled @ mean / n)
    flow = scaled @ mean
    for _ in range(halvings):  # over twice the time
        mean = trimmed(mean + 0.5 * (flow @ mean))
        flow = trimmed(2.0 * flow + flow @ flow)
    return flow @ z + mean @ held


def _whole(matrix: Floats) -> Floats:
    return matrix


def _trimmed(matrix: Any) -> Any:
    matrix.data[np.abs(matrix.data) < NOTHING] = 0.0
    matrix.eliminate_zeros()
    if matrix.nnz > MOST_ENTRIES:
        raise NotWorkedOutError("in a sample period each of its masses moves too many others")
    return matrix


def _rk4(rates: Any, z: Any, held: Any) -> Any:
    """Runge-Kutta: every exp(s T) becomes 1 + z + z²/2 + z³/6 + z⁴/24 of z = s T. Arrays, or sparse matrices."""
    rate = rates @ z + held
    return rate + rates @ (rate + rates @ (rate + rates @ rate / 4.0) / 3.0) / 2.0


SCHEMES: dict[str, Scheme | None] = {
    "cordis": None,
    "semi_implicit": None,  # v[n+1] = v[n] + T F[n]/m, x[n+1] = x[n] + T v[n+1]: CORDIS's scheme in other words
    "midpoint": Scheme(0.5, in_a_matrix),  # every exp(s T) becomes (1 + s T/2)/(1 - s T/2)
    "rk4": Scheme(_rk4, at_every_instant),
    "exact": Scheme(exactly, in_a_matrix),
}
"""None: CORDIS's scheme, m/T² (x[n+1] - 2 x[n] + x[n-1]) = F[n] for every mass."""
