"""The transition: the matrix that takes the state of a scene (``layout.py``) at one sample to the state at the next.

Of a large scene as sparse matrices: what it makes of a state, and its shifted inverse. Left z' = right z. Only an
implicit scheme, such as midpoint, needs a left side (``theory.schemes``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Complexes, Floats, Indices
from hapsim.theory.network.mass_rates import MassRates, advanced
from hapsim.theory.network.network import Network
from hapsim.theory.network.sparse import Solve, Triplets, dense, factorised, sparse
from hapsim.theory.network.state import is_large, transition_parts
from hapsim.theory.network.substeps import Lift, lift_of
from hapsim.theory.schemes import SCHEMES, NotWorkedOutError

Parts = tuple[Triplets, MassRates | None, int]
"""As ``transition_parts`` returns them."""

MOST_INVERSE = 200_000  # numbers of a state times steps in a sample period: some tens of inverses take half a minute
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

    def part(self, slots: Indices) -> SparseTransition:
        """What it makes of these numbers out of themselves."""
        sides = (side if side is None else side.tocsr()[slots][:, slots] for side in (self.right, self._left))
        right, left = sides
        return SparseTransition(right, None if left is None else left.tocsc())

    def inverse(self, shift: complex) -> Solve | None:
        """x -> (transition - shift)^-1 x; None where the shift is a pole, exactly."""
        from scipy.sparse import eye

        left = eye(self.size, format="csc") if self._left is None else self._left
        solve = factorised(self.right - shift * left, permc_spec="MMD_AT_PLUS_A")
        return None if solve is None else lambda state: solve(left @ state)


class LiftedTransition:
    """The same of a scene with substeps (``Lift``), whose N-th power is never formed. A shifted inverse of it is

        (A^N - z)^-1 = 1/(N z) times the sum of w (A - w)^-1 over the N roots w of w^N = z

    for what the steps move; the device's few numbers are eliminated. ``step``: a step; ``held``: the same of what it
    moves, the hands held still.
    """

    def __init__(self, network: Network) -> None:
        self._lift = lift = lift_of(network)
        self.size, self.steps = lift.layout.size, network.substeps
        self.step = _sparse_of(network, (*lift.stepped(), lift.size), lift.moved_hands())
        self.work, self.is_finite = self.steps * self.step.work, self.step.is_finite
        self.held = self.step.part(lift.scene)
        self._power = self.step.power(self.steps & -self.steps) if self.is_finite else (self.step, 1)
        self.embedded = sparse(lift.embedded(), (lift.size, self.size)).tocsr()
        self._device = sparse(lift.of_device(), (self.size, self.size + lift.asked.size)).tocsr()

    def __matmul__(self, state: NDArray) -> NDArray:
        """States (size,) or (size, n) at the next sample."""
        moved = self._after_steps(state)
        after = np.asarray(self._device @ np.concatenate([state, moved[self._lift.asked]]))
        after[self._lift.scene] = moved[self._lift.scene]
        return after

    def placed(self, held: NDArray) -> NDArray:
        """States (size,) or (size, n) out of those of ``held``; what the device has is 0."""
        state = np.zeros((self.size, *held.shape[1:]), held.dtype)
        state[self._lift.scene] = held
        return state

    def _after_steps(self, state: NDArray) -> NDArray:
        power, steps = self._power
        moved = self.embedded @ state
        for _ in range(self.steps // steps):
            moved = power @ moved
        return moved

    def power(self, _most: int) -> tuple[Any, int]:
        """As of ``SparseTransition``: a sample."""
        return self, 1

    def inverse(self, shift: complex) -> Solve | None:
        """x -> (transition - shift)^-1 x; None where the shift is a pole, exactly.

        Raises:
            NotWorkedOutError: that takes too long.
        """
        if self.size * self.steps > MOST_INVERSE:
            raise NotWorkedOutError(f"{self.steps} substeps of as many masses take too long")
        turns = (np.angle(shift) + 2.0 * np.pi * np.arange(self.steps)) / self.steps
        roots = abs(shift) ** (1.0 / self.steps) * np.exp(1j * turns)
        solves = [self.held.inverse(root) for root in roots.tolist()]
        if any(solve is None for solve in solves):
            return None
        scene, asked = self._lift.scene, self._lift.asked
        others = np.setdiff1d(np.arange(self.size), scene)

        def of_scene(wanted: NDArray) -> NDArray:
            pairs = zip(roots, solves, strict=True)
            parts = (root * solve(wanted.astype(complex)) for root, solve in pairs if solve is not None)
            found: NDArray = sum(parts) / (shift * self.steps)
            return found if np.iscomplexobj(wanted) or np.imag(shift) else found.real

        units = np.zeros((self.size, others.size))
        units[others, np.arange(others.size)] = 1.0
        by_others = self._after_steps(units)
        pushed = of_scene(by_others[scene])
        own, by_force = np.split(self._device[others].toarray(), [self.size], axis=1)
        asks = by_others[asked] - self._after_steps(self.placed(pushed))[asked]
        inner = own[:, others] - shift * np.eye(others.size) + by_force @ asks

        def solve(state: NDArray) -> NDArray:
            found = self.placed(of_scene(state[scene]))
            moved = np.linalg.solve(inner, state[others] - by_force @ self._after_steps(found)[asked])
            found = found - self.placed(pushed @ moved)
            found[others] = moved
            return found

        return solve


Transition = SparseTransition | LiftedTransition


def sparse_transition(network: Network) -> Transition:
    """The transition of a large scene.

    Raises:
        NotWorkedOutError: its scheme's matrix is not sparse.
    """
    with np.errstate(all="ignore"):  # numbers out of range become NaN
        return _sparse_of(network, transition_parts(network)) if network.substeps == 1 else LiftedTransition(network)


@np.errstate(all="ignore")  # numbers out of range become NaN
def transition(network: Network) -> Any:
    """The square matrix that takes the state at one sample to the state at the next.

    An array; of a large scene by CORDIS's scheme, once a sample, a sparse one, of scipy, by compressed columns.
    """
    if network.substeps == 1:
        parts = transition_parts(network)
        if is_large(network) and parts[1] is None:
            return sparse(parts[0], (parts[2], parts[2]))
        return _dense_of(network, parts)
    lift = lift_of(network)
    size, scene = lift.layout.size, lift.scene
    steps = np.linalg.matrix_power(_dense_step(network, lift), network.substeps)
    moved = steps @ dense(lift.embedded(), (lift.size, size))
    own, by_force = np.split(dense(lift.of_device(), (size, size + lift.asked.size)), [size], axis=1)
    matrix = own + by_force @ moved[lift.asked]
    matrix[scene] = moved[scene]
    return matrix


def steps_of_motions(network: Network, poles: Complexes, states: NDArray) -> tuple[Floats, Floats]:
    """Of motions (size, n) of a scene with substeps: the radians (n,) that they turn in a sample period, from step to
    step, each point for as much energy as it has; and this energy (points, n), in any unit."""
    lift = lift_of(network)
    if is_large(network):
        lifted = LiftedTransition(network)
        step, embedded = lifted.step, lifted.embedded
    else:
        step, embedded = _dense_step(network, lift), dense(lift.embedded(), (lift.size, lift.layout.size))
    mass = np.concatenate([network.channel_mass, network.point_mass])[:, None]
    motion, turned = embedded @ states, np.zeros(states.shape[1])
    energy, ways = np.zeros((mass.size, states.shape[1])), list[NDArray]()
    for _ in range(network.substeps):
        after = step @ motion
        ways = [*ways[:1], *ways[-1:], (after - motion)[: mass.size]]  # the first, the last but one, the last
        turned += np.angle((mass * ways[-2:][0].conj() * ways[-1]).sum(axis=0))
        energy += mass * np.abs(ways[-1]) ** 2
        motion = after
    return turned + np.angle((mass * ways[-1].conj() * poles * ways[0]).sum(axis=0)), energy


def _dense_step(network: Network, lift: Lift) -> Any:
    return _dense_of(network, (*lift.stepped(), lift.size)) @ dense(lift.moved_hands(), (lift.size, lift.size))


def _dense_of(network: Network, parts: Parts) -> Floats:
    entries, system, size = parts
    matrix = dense(entries, (size, size))
    if system is not None:
        matrix[system.now], matrix[system.before] = advanced(network, system, size)
    return matrix


def _sparse_of(network: Network, parts: Parts, first: Triplets | None = None) -> SparseTransition:
    """``first``: a matrix that moves the state before."""
    entries, system, size = parts
    scheme, matrix = SCHEMES[network.scheme], sparse(entries, (size, size))
    every = np.arange(size)
    before = sparse(first or Triplets(every, every, np.ones(size)), (size, size))
    if scheme is None or system is None:
        return SparseTransition(matrix @ before)
    own = 2 * system.masses
    rates = sparse(system.rates, (system.size, system.size))
    start = sparse(system.start, (system.size, size)).tocsr()
    if callable(scheme.large):
        after = scheme.large(rates, start).tocsr()[:own]
        x, steps = np.split(np.arange(own), 2)
        rows, columns = np.concatenate([system.now, system.before, system.before]), np.concatenate([x, x, steps])
        values = np.repeat([1.0, 1.0, -system.unit], system.masses)
        return SparseTransition((matrix + _matrix(rows, columns, values, (size, own)) @ after) @ before)
    # (1 - share Z) z' = (1 + (1 - share) Z) z in the masses' rows, with what pulls from outside held.
    share, rows = scheme.large, np.concatenate([system.now, system.before])
    place = _matrix(rows, np.arange(own), np.ones(own), (size, own))
    others = np.setdiff1d(np.arange(size), rows)
    rates, inner = rates.tocsr()[:own], start[:own]
    moved = rates[:, :own] @ inner
    left = _matrix(others, others, np.ones(others.size), (size, size)) + place @ (inner - share * moved)
    right = matrix + place @ (inner + (1.0 - share) * moved + rates[:, own:] @ start[own:])
    return SparseTransition(right @ before, left.tocsc())


def _matrix(rows: Indices, columns: Indices, values: Floats, shape: tuple[int, int]) -> Any:
    from scipy.sparse import csc_matrix

    return csc_matrix((values, (rows, columns)), shape)
