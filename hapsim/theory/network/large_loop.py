"""Loop of a large scene on sparse rows: its transition and the shifted inverse.

No dense matrix of the state's size is ever formed.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Floats, Indices
from hapsim.theory.network.network import Network
from hapsim.theory.rows import Rows, as_rows, cut, stack, unit_rows
from hapsim.theory.sample import Sample
from hapsim.theory.schemes import SCHEMES, NotWorkedOutError

Solve = Callable[[NDArray], NDArray]

MOST_INVERSE = 50_000  # numbers that a step moves, times steps: some tens of inverses of a membrane take ten seconds
PIVOTS: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.1,
}  # rows of a loop are nearly symmetric
CALL_COST = 15_000  # multiplications that take as long as the call of one product
CALL_NUMBERS = 600  # numbers of a state that a step moves while one product is called


def factorised(matrix: Any, **options: Any) -> Solve | None:
    """Returns the function x -> matrix^-1 x; None if there is no inverse. ``options``: of scipy's ``splu``."""
    from scipy.sparse import linalg

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            solve: Solve = linalg.splu(matrix.tocsc(), **options).solve
        except RuntimeError:
            return None
    return solve


class Implicit(NamedTuple):
    """Equation of a scheme without a sparse change: numbers d with left d = rate state add ``by`` d to the change."""

    by: Rows
    rate: Rows
    left: Rows


class SparseTransition:
    """Matrix from a state to the next, 1 + ``change``. ``work``: cost of one step, in numbers of a state that CORDIS's
    scheme moves. ``points`` (C + M, size), ``push`` (size, C), ``of_forces`` (C, size): as in ``Loop``."""

    points: Rows
    push: Floats
    of_forces: Rows

    def __init__(self, change: Rows, implicit: Implicit | None = None) -> None:
        self.size, self._implicit = change.shape[0], implicit
        self.right = (change + unit_rows(self.size, True)).tocsr()
        self.work = max(self.size, self.right.nnz // 4) if implicit is None else 3 * self.size
        self.is_finite = all(bool(np.isfinite(one.data).all()) for one in (change, *(implicit or ())))
        if implicit is not None and self.is_finite:
            # No pivoting: eliminating the positions leaves 1 + B T/2 m + K T²/4 m, which is definite.
            options: dict[str, Any] = {
                "permc_spec": "MMD_AT_PLUS_A",
                "diag_pivot_thresh": 0.0,
                "options": {"SymmetricMode": True},
            }
            self._solve = factorised(implicit.left, **options)
            self.is_finite = self._solve is not None

    def __matmul__(self, state: NDArray) -> NDArray:
        """Returns the states (size,) or (size, n) at the next sample."""
        after = np.asarray(self.right @ state)
        if self._implicit is None:
            return after
        rate, solve = self._implicit.rate @ state, self._solve
        assert solve is not None
        found = solve(rate) if np.isrealobj(rate) else solve(rate.real) + 1j * solve(rate.imag)
        return after + np.asarray(self._implicit.by @ found)

    def forces(self, state: NDArray) -> NDArray:
        """Forces computed for the channels, (C,) or (C, n), N."""
        return np.asarray(self.of_forces @ state)

    def power(self, most: int) -> tuple[Any, int]:
        """Returns the fastest power of the matrix and its steps, out of 1, 2, 4, … up to `most`."""
        if self._implicit is not None:
            return self, 1
        power, steps = self.right, 1
        while 2 * steps <= most and (squared := power @ power).nnz < 2 * power.nnz + CALL_COST:
            power, steps = squared, 2 * steps
        return power, steps

    def part(self, slots: slice) -> SparseTransition:
        """Returns the transition of these numbers from themselves alone."""
        own = (self.right - unit_rows(self.size, True))[slots, slots]
        if self._implicit is None:
            return SparseTransition(own)
        by, rate, left = self._implicit
        return SparseTransition(own, Implicit(by[slots], rate[:, slots], left))

    def inverse(self, shift: complex) -> Solve | None:
        """Returns the function x -> (transition - shift)^-1 x; None if the shift is exactly a pole."""
        from scipy.sparse import bmat

        whole = self.right - shift * unit_rows(self.size, True)
        if self._implicit is not None:
            by, rate, left = self._implicit
            whole = bmat([[whole, by], [rate, -left]])
        solve, more = factorised(whole, permc_spec="MMD_AT_PLUS_A"), whole.shape[0] - self.size
        if solve is None or not more:
            return solve
        return lambda state: solve(np.concatenate([state, np.zeros((more, *state.shape[1:]), state.dtype)]))[
            : self.size
        ]


class LiftedTransition:
    """Transition of a scene with substeps, whose N-th power is never formed. Its shifted inverse is

        (A^N - z)^-1 = 1/(N z) times the sum of w (A - w)^-1 over the N roots w of w^N = z

    for the parts that the steps move; the few numbers of the device are eliminated. One system of all steps' numbers
    would take four times as long to factorise. ``step``: one step. ``held``: the same without the device, the hands
    held still.
    """

    def __init__(self, network: Network) -> None:
        sample = Sample(network, sparse=True)
        self.size, self.steps = sum(sample.sizes.values()), network.substeps
        self.step, of_step = sparse_step(sample), sum(sample.step_sizes.values())
        self.work, self.is_finite = self.steps * self.step.work, self.step.is_finite
        first = 2 * sample.step_sizes["hand"] + 2 * sample.step_sizes["sensed"]
        self.held = self.step.part(slice(first, of_step - sample.step_sizes["force"]))
        own = cut(np.arange(self.size)[:, None], sample.sizes)
        self._scene = np.concatenate([own[name].ravel() for name in ("mass", "mass_step", "old_steps", "old_rates")])
        channels = network.channel_mass.size
        rows = unit_rows(self.size + of_step + channels, True)
        state = cut(rows, sample.sizes)
        last, start = cut(rows[self.size :], sample.step_sizes), sample.start(state)
        moved = {name: last[name] - start[name] for name in start}
        state_change = sample.state_change(state, moved, rows[self.size + of_step :]) + rows[: self.size]
        self.start = stack([*start.values()])[:, : self.size]
        self.own, self.by_last = state_change[:, : self.size], state_change[:, self.size : self.size + of_step]
        self.points, self.push = sample.points(state)[:, : self.size], state_change[:, self.size + of_step :].toarray()
        self._power = self.step.power(self.steps & -self.steps) if self.is_finite else (self.step, 1)
        self.work = max(self.work, CALL_NUMBERS * (self.steps // self._power[1]))

    def __matmul__(self, state: NDArray) -> NDArray:
        """Returns the states (size,) or (size, n) at the next sample."""
        return np.asarray(self.own @ state + self.by_last @ self._after_steps(state))

    def forces(self, state: NDArray) -> NDArray:
        """Forces computed for the channels, (C,) or (C, n), N."""
        return self._after_steps(state)[self.by_last.shape[1] - self.push.shape[1] :]

    def _after_steps(self, state: NDArray) -> NDArray:
        power, steps = self._power
        moved = self.start @ state
        for _ in range(self.steps // steps):
            moved = power @ moved
        return np.asarray(moved)

    def placed(self, held: NDArray) -> NDArray:
        """Returns states (size,) or (size, n) from those of ``held``; the device's numbers are 0."""
        state = np.zeros((self.size, *held.shape[1:]), held.dtype)
        state[self._scene] = held
        return state

    def power(self, _most: int) -> tuple[Any, int]:
        """Returns one sample, as ``SparseTransition.power``."""
        return self, 1

    def inverse(self, shift: complex) -> Solve | None:
        """Returns the function x -> (transition - shift)^-1 x; None if the shift is exactly a pole.

        Raises:
            NotWorkedOutError: the computation takes too long.
        """
        if self.held.size * self.steps > MOST_INVERSE:
            raise NotWorkedOutError(f"{self.steps} substeps of this many masses take too long")
        turns = (np.angle(shift) + 2.0 * np.pi * np.arange(self.steps)) / self.steps
        roots = abs(shift) ** (1.0 / self.steps) * np.exp(1j * turns)
        solves = [self.held.inverse(root) for root in roots.tolist()]
        if any(solve is None for solve in solves):
            return None
        others, by_others = self._by_others

        def of_scene(wanted: NDArray) -> NDArray:
            """Solves for the state of the scene alone, over all substeps."""
            pairs = zip(roots, solves, strict=True)
            parts = (root * solve(wanted.astype(complex)) for root, solve in pairs if solve is not None)
            found: NDArray = sum(parts) / (shift * self.steps)
            return found if np.iscomplexobj(wanted) or np.imag(shift) else found.real

        acting = by_others[self._scene].any(axis=0)  # few of a long delay's forces
        pushed = of_scene(by_others[self._scene][:, acting])
        inner = by_others[others] - shift * np.eye(others.size)
        inner[:, acting] -= (self @ self.placed(pushed))[others]
        of_others = factorised(as_rows(inner, sparse=True).astype(complex))
        if of_others is None:
            return None

        def solve(state: NDArray) -> NDArray:
            """Solves for the whole state: the scene, and all others by their Schur complement."""
            found = self.placed(of_scene(state[self._scene]))
            moved = of_others((state[others] - (self @ found)[others]).astype(complex))
            moved = moved if np.iscomplexobj(found) else moved.real
            found = found - self.placed(pushed @ moved[acting])
            found[others] = moved
            return found

        return solve

    @cached_property
    def _by_others(self) -> tuple[Indices, Floats]:
        """Returns the numbers that the steps do not move, and the states one sample after 1 in each of them."""
        others = np.setdiff1d(np.arange(self.size), self._scene)
        units = np.zeros((self.size, others.size))
        units[others, np.arange(others.size)] = 1.0
        return others, self @ units


Transition = SparseTransition | LiftedTransition


def sparse_transition(network: Network) -> Transition:
    """Returns the transition of a large scene.

    Raises:
        NotWorkedOutError: its scheme's matrix is not sparse.
    """
    with np.errstate(all="ignore"):  # numbers out of range become NaN
        if network.substeps > 1:
            return LiftedTransition(network)
        sample = Sample(network, sparse=True)
        size = sum(sample.sizes.values())
        unknown, channels = _unknowns(sample), network.channel_mass.size
        rows = unit_rows(size + channels + unknown, True)
        state = cut(rows, sample.sizes)
        moved = sample.tick.step(sample.start(state), unknown=rows[size + channels :] if unknown else None)
        change = sample.state_change(state, moved, rows[size : size + channels])
        found = SparseTransition(change[:, :size], _implicit(sample, change, moved.get("unknown")))
        found.points, found.push = sample.points(state)[:, :size], change[:, size : size + channels].toarray()
        found.of_forces = moved["force"][:, :size]
        return found


def _unknowns(sample: Sample) -> int:
    scheme = SCHEMES[sample.network.scheme]
    if scheme is None or callable(scheme.change) or not sample.network.point_mass.size:
        return 0
    return int(sample.tick.rates.shape[0])


def _implicit(sample: Sample, change: Rows, rate: Rows | None) -> Implicit | None:
    scheme, size = SCHEMES[sample.network.scheme], change.shape[0]
    if rate is None or scheme is None:
        return None
    left = unit_rows(rate.shape[0], True) - scheme.change * sample.tick.rates
    return Implicit(change[:, -rate.shape[0] :].tocsr(), rate[:, :size].tocsr(), left.tocsc())


def sparse_step(sample: Sample) -> SparseTransition:
    """Returns the transition of one step."""
    size, unknown = sum(sample.step_sizes.values()), _unknowns(sample)
    rows = unit_rows(size + unknown, True)
    moved = sample.tick.step(cut(rows[:size], sample.step_sizes), unknown=rows[size:] if unknown else None)
    rate = moved.pop("unknown", None)
    change = stack([*moved.values()])
    return SparseTransition(change[:, :size], _implicit(sample, change, rate))
