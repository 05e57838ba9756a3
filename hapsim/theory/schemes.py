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
        advance: returns z after a sample: (N, N) T A, (N, n) several z -> (N, n).
        inside: whether a link is asked for its force between two samples, as in the kernel. The force of any other
            link is held from sample to sample.
        large: `advance` for scipy's sparse matrices; or, where the result is not sparse, the share for which
            (1 - share T A) z[n+1] = (1 + (1 - share) T A) z[n].
    """

    advance: Callable[[Any, Any], Any]
    inside: Callable[[LinkNature], bool]
    large: Callable[[Any, Any], Any] | float


def _midpoint(rates: Floats, start: Floats) -> Floats:
    """z[n+1] = z[n] + T A (z[n] + z[n+1])/2: every exp(s T) becomes (1 + s T/2)/(1 - s T/2)."""
    half = 0.5 * rates
    return np.asarray(np.linalg.solve(np.eye(len(half)) - half, start + half @ start), float)


def _exact(rates: Floats, start: Floats) -> Floats:
    """exp(T A) z[n]."""
    from scipy.linalg import expm

    after: Floats = expm(rates) @ start
    return after


def _exact_sparse(rates: Any, start: Any) -> Any:
    """The same by the Taylor series of A/2^n, squared n times: far from the diagonal there is next to nothing.

    Raises:
        NotWorkedOutError: too much is left of it.
    """
    from scipy.sparse import eye

    largest = max(1.0, float(abs(rates).sum(axis=1).max()))
    if not largest <= FASTEST:
        raise NotWorkedOutError("its fastest motion is too fast for the rate")
    halvings = math.ceil(math.log2(largest))
    one = eye(rates.shape[0], format="csr")
    flow, scaled = one, rates.tocsr() / 2.0**halvings
    for n in reversed(range(1, TAYLOR_TERMS + 1)):
        flow = _trimmed(one + scaled @ flow / n)
    for _ in range(halvings):
        flow = _trimmed(flow @ flow)
    return flow @ start


def _trimmed(matrix: Any) -> Any:
    matrix.data[np.abs(matrix.data) < NOTHING] = 0.0
    matrix.eliminate_zeros()
    if matrix.nnz > MOST_ENTRIES:
        raise NotWorkedOutError("in a sample period each of its masses moves too many others")
    return matrix


def _rk4(z: Any, start: Any) -> Any:
    """Runge-Kutta: every exp(s T) becomes 1 + z + z²/2 + z³/6 + z⁴/24 of z = s T. Arrays, or sparse matrices."""
    return start + z @ (start + z @ (start + z @ (start + z @ start / 4.0) / 3.0) / 2.0)


SCHEMES: dict[str, Scheme | None] = {
    "cordis": None,
    "semi_implicit": None,  # v[n+1] = v[n] + T F[n]/m, x[n+1] = x[n] + T v[n+1]: CORDIS's scheme in other words
    "midpoint": Scheme(_midpoint, in_a_matrix, 0.5),
    "rk4": Scheme(_rk4, at_every_instant, _rk4),
    "exact": Scheme(_exact, in_a_matrix, _exact_sparse),
}
"""None: CORDIS's scheme, m/T² (x[n+1] - 2 x[n] + x[n-1]) = F[n] for every mass."""
