"""The transition of a large scene as sparse matrices: what it makes of a state, and its shifted inverse.

Left z' = right z. Only an implicit scheme, such as midpoint, needs a left side (``theory.schemes``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Floats, Indices
from hapsim.theory.network.network import Network
from hapsim.theory.network.sparse import Solve, factorised, sparse
from hapsim.theory.network.state import transition_parts
from hapsim.theory.schemes import SCHEMES

A_CALL = 15_000  # numbers that are multiplied in the time that a multiplication takes to begin


class SparseTransition:
    """The transition. ``work``: the cost of one step, in numbers of a state that CORDIS's scheme moves."""

    def __init__(self, right: Any, left: Any = None) -> None:
        self.size, self.right = right.shape[0], right.tocsr()
        self._left, self._step = left, None
        self.work = max(self.size, self.right.nnz // 4)
        self.is_finite = all(bool(np.isfinite(side.data).all()) for side in (right, left) if side is not None)
        if left is not None and self.is_finite:
            # Without looking for pivots: eliminating the positions leaves minus 2 + B T/m + K T²/(2 m), which is
            # definite.
            how = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
            self._step = factorised(left, **how)
            self.work = 3 * self.size
            self.is_finite = self._step is not None

    def __matmul__(self, state: NDArray) -> NDArray:
        """States (size,) or (size, n) at the next sample."""
        forward = np.asarray(self.right @ state)
        if self._step is None:
            return forward
        return self._step(forward) if np.isrealobj(state) else self._step(forward.real) + 1j * self._step(forward.imag)

    def power(self, most: int) -> tuple[Any, int]:
        """(what moves a state by `steps` samples at once, steps): of 1, 2, 4, … up to `most` the quickest."""
        if self._step is not None:
            return self, 1
        power, steps = self.right, 1
        while 2 * steps <= most and (squared := power @ power).nnz < 2 * power.nnz + A_CALL:
            power, steps = squared, 2 * steps
        return power, steps

    def inverse(self, shift: complex) -> Solve | None:
        """x -> (transition - shift)^-1 x; None where the shift is a pole, exactly."""
        from scipy.sparse import eye

        left = eye(self.size, format="csc") if self._left is None else self._left
        solve = factorised(self.right - shift * left, permc_spec="MMD_AT_PLUS_A")
        return None if solve is None else lambda state: solve(left @ state)


@np.errstate(all="ignore")  # numbers out of range become NaN
def sparse_transition(network: Network) -> SparseTransition:
    """The transition of a large scene.

    Raises:
        NotWorkedOutError: its scheme's matrix is not sparse.
    """
    entries, system, size = transition_parts(network)
    scheme, matrix = SCHEMES[network.scheme], sparse(entries, (size, size))
    if scheme is None or system is None:
        return SparseTransition(matrix)
    own = 2 * system.masses
    rates = sparse(system.rates, (system.size, system.size))
    start = sparse(system.start, (system.size, size)).tocsr()
    if callable(scheme.large):
        after = scheme.large(rates, start).tocsr()[:own]
        x, steps = np.split(np.arange(own), 2)
        rows, columns = np.concatenate([system.now, system.before, system.before]), np.concatenate([x, x, steps])
        values = np.repeat([1.0, 1.0, -system.unit], system.masses)
        return SparseTransition(matrix + _matrix(rows, columns, values, (size, own)) @ after)
    # (1 - share Z) z' = (1 + (1 - share) Z) z in the masses' rows, with what pulls from outside held.
    share, rows = scheme.large, np.concatenate([system.now, system.before])
    place = _matrix(rows, np.arange(own), np.ones(own), (size, own))
    others = np.setdiff1d(np.arange(size), rows)
    rates, inner = rates.tocsr()[:own], start[:own]
    moved = rates[:, :own] @ inner
    left = _matrix(others, others, np.ones(others.size), (size, size)) + place @ (inner - share * moved)
    right = matrix + place @ (inner + (1.0 - share) * moved + rates[:, own:] @ start[own:])
    return SparseTransition(right, left.tocsc())


def _matrix(rows: Indices, columns: Indices, values: Floats, shape: tuple[int, int]) -> Any:
    from scipy.sparse import csc_matrix

    return csc_matrix((values, (rows, columns)), shape)
