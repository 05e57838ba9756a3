"""The transition of a large scene, as what an iteration asks of it: what it makes of a state, and its shifted inverse.

The scheme says which (``theory.schemes``). Under CORDIS's and rk4 it is one sparse matrix. Under midpoint it is sparse
on either side, left z' = right z. Under exact it is full, and its modes are what is sparse (``exact_modes.py``).
"""

from __future__ import annotations

from typing import Any, Protocol, assert_never

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.network.mass_rates import MassRates
from hapsim.theory.network.network import Network
from hapsim.theory.network.sparse import Solve, factorised, sparse
from hapsim.theory.network.state import transition_parts
from hapsim.theory.schemes import SCHEMES, Advance, ByModes, Implicit, Polynomial


class Operator(Protocol):
    """A transition of ``size`` numbers. ``work``: what one step costs, in numbers of a state that CORDIS's moves."""

    size: int
    work: int

    def __matmul__(self, state: NDArray) -> NDArray:
        """States (size,) or (size, n) at the next sample."""

    def inverse(self, shift: complex) -> Solve | None:
        """x -> (transition - shift)^-1 x; None where the shift is a pole, exactly."""

    def positions(self, motions: NDArray) -> NDArray:
        """The points' part (C + M, n) of states (size, n)."""

    def is_finite(self) -> bool:
        """Whether all of its numbers are."""


class Explicit:
    """One sparse matrix."""

    def __init__(self, matrix: Any, points: int, work: int) -> None:
        self.matrix, self.work, self.size = matrix, work, matrix.shape[0]
        self._rows, self._points = matrix.tocsr(), points

    def __matmul__(self, state: NDArray) -> NDArray:
        return np.asarray(self._rows @ state)

    def inverse(self, shift: complex) -> Solve | None:
        from scipy.sparse import eye

        return factorised(self.matrix - shift * eye(self.size, format="csc"))

    def positions(self, motions: NDArray) -> NDArray:
        return motions[: self._points]

    def is_finite(self) -> bool:
        return bool(np.isfinite(self.matrix.data).all())


class TwoSided:
    """Two sparse matrices, left z' = right z."""

    def __init__(self, left: Any, right: Any, points: int) -> None:
        self._left, self._right, self._points = left, right, points
        self.size = left.shape[0]
        self._finite = bool(np.isfinite(left.data).all() and np.isfinite(right.data).all())
        # Without looking for pivots: eliminating the positions leaves minus 2 + B T/m + K T²/(2 m), which is definite.
        how = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        self._step = factorised(left, **how) if self._finite else None
        self.work = 3 * self.size

    def __matmul__(self, state: NDArray) -> NDArray:
        assert self._step is not None
        forward = self._right @ state
        return self._step(forward) if np.isrealobj(state) else self._step(forward.real) + 1j * self._step(forward.imag)

    def inverse(self, shift: complex) -> Solve | None:
        solve = factorised(self._right - shift * self._left)
        return None if solve is None else lambda state: solve(self._left @ state)

    def positions(self, motions: NDArray) -> NDArray:
        return motions[: self._points]

    def is_finite(self) -> bool:
        return self._step is not None


@np.errstate(all="ignore")  # what is out of range becomes NaN
def operator_of(network: Network) -> Operator:
    """The transition of a large scene.

    Raises:
        NotWorkedOutError: by modes, of a scene whose modes damping joins, or that has too many masses.
    """
    entries, system, size = transition_parts(network)
    points = network.channel_mass.size + network.point_mass.size
    advance = SCHEMES[network.scheme].advance
    if advance is None or system is None:
        return Explicit(sparse(entries, (size, size)), points, size)
    match advance.large:
        case ByModes():
            from hapsim.theory.network.exact_modes import modal_operator

            return modal_operator(network, entries, system, size)
        case Polynomial():
            matrix = sparse(entries, (size, size)) + _placed(system, size) @ _advanced(advance, system, size)
            return Explicit(matrix.tocsc(), points, max(size, matrix.nnz // 4))
        case Implicit(share):
            return _two_sided(sparse(entries, (size, size)), system, size, points, share)
        case other:
            assert_never(other)


def _advanced(advance: Advance, system: MassRates, size: int) -> Any:
    """Sparse (2 M, size): the masses' next positions and steps, by a scheme that is a polynomial of the rates."""
    rates = sparse(system.rates, (system.size, system.size))
    return advance(rates, sparse(system.start, (system.size, size))).tocsr()[: 2 * system.masses]


def _placed(system: MassRates, size: int) -> Any:
    """Sparse (size, 2 M): where positions and steps go in the state, x and x - w."""
    from scipy.sparse import csc_matrix

    own = np.arange(system.masses)
    rows = np.concatenate([system.now, system.before, system.before])
    columns = np.concatenate([own, own, system.masses + own])
    values = np.concatenate([np.ones(2 * own.size), -np.ones(own.size)])
    return csc_matrix((values, (rows, columns)), (size, 2 * own.size))


def _two_sided(matrix: Any, system: MassRates, size: int, points: int, share: float) -> TwoSided:
    """(1 - share Z) z' = (1 + (1 - share) Z) z in the masses' rows, with what pulls from outside held."""
    from scipy.sparse import csc_matrix

    own = 2 * system.masses
    rates = sparse(system.rates, (system.size, system.size)).tocsr()[:own]
    start = sparse(system.start, (system.size, size)).tocsr()
    rows = np.concatenate([system.now, system.before])
    place = csc_matrix((np.ones(own), (rows, np.arange(own))), (size, own))
    others = np.ones(size)
    others[rows] = 0.0
    kept = csc_matrix((others, (np.arange(size), np.arange(size))), (size, size))
    inner = start[:own]
    way = rates[:, :own] @ inner
    left = kept + place @ (inner - share * way)
    right = matrix + place @ (inner + (1.0 - share) * way + rates[:, own:] @ start[own:])
    return TwoSided(left.tocsc(), right.tocsc(), points)
