"""A C program for one string: `reference/stencil.c`."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import CDLL, POINTER, Structure, byref, c_double, c_int64

import numpy as np
from numpy.typing import NDArray

from hapsim.speed_accuracy.strings import (
    StringOfMasses,
    cost_of,
    frequencies_of,
    hand_link,
    hand_motion,
    held_mass,
    project,
)
from speed.reference.build import build_c, why_no_compiler
from speed.reference.memory import pointer, rows

_BLOCK = 16384  # samples of the hand's motion that are ready in memory


class CStencil:
    """The string alone, or with a `hand` on one of its masses; compiled for its number of masses and the widest vectors
    there are, or, `plain`, for any number with -O3 -march=native."""

    precision = "double"

    def __init__(self, hand: bool = False, plain: bool = False) -> None:
        self.hand, self.plain = hand, plain
        self.name = "C stencil with a hand" if hand else "C stencil"
        self.preparation_s: float | None = None
        self.note = ""

    def available(self) -> str:
        return why_no_compiler()

    def cost(self, string: StringOfMasses, rate: float, rounds: int) -> list[float]:
        run = self.running(string, rate)
        run.start_in(string.plucked())
        run.hold(*hand_link(string))
        return cost_of(run.with_hand if self.hand else run.alone, rate, rounds)

    def frequencies(self, string: StringOfMasses, rate: float, modes: Sequence[int]) -> list[float]:
        """Returns the frequencies of modes, Hz. A hand's link has no stiffness and damping here."""
        run = self.running(string, rate)

        def record(shape: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
            run.start_in(shape)
            step = run.with_hand if self.hand else run.alone
            return np.array([project(run.step_and_see(step), shape) for _ in range(samples)])

        return frequencies_of(record, string, rate, modes)

    def running(self, string: StringOfMasses, rate: float) -> RunningStencil:
        """The program and its state, at rest."""
        built = build_c("stencil.c", f"MASSES={string.masses}", plain=self.plain)
        self.preparation_s = built.seconds
        return RunningStencil(built.load(), string, rate)


class _State(Structure):
    _fields_ = (
        ("now", POINTER(c_double)),
        ("before", POINTER(c_double)),
        ("next", POINTER(c_double)),
        ("centre", c_double),
        ("side", c_double),
        ("old_centre", c_double),
        ("old_side", c_double),
        ("mobility", c_double),
        ("hand_stiffness", c_double),
        ("hand_damping", c_double),
        ("hand_before", c_double),
        ("held", c_int64),
        ("masses", c_int64),
    )


class RunningStencil:
    """The compiled program and its state: `now` and `before`, the positions in m of all points."""

    def __init__(self, library: CDLL, string: StringOfMasses, rate: float) -> None:
        self._library = library
        self._masses = string.masses
        self._rate = rate
        self._rows = rows(3, string.masses + 2, at=1)
        self._motion = hand_motion(_BLOCK, rate)
        self._forces = np.zeros(_BLOCK)
        library.stencil_run.argtypes = [POINTER(_State), c_int64, POINTER(c_double), POINTER(c_double)]
        library.stencil_run_alone.argtypes = [POINTER(_State), c_int64]
        self._state = self._at_rest(string)

    def start_in(self, displacement: NDArray[np.float64]) -> None:
        """Puts the masses at `displacement` in m, shape (N,), at rest, and releases them."""
        self._state.now, self._state.before, self._state.next = (pointer(row) for row in self._rows)
        for row in self._rows[:2]:
            row[1:-1] = displacement
        self._state.hand_stiffness = self._state.hand_damping = 0.0

    def hold(self, stiffness: float, damping: float) -> None:
        """Links the hand to its mass, K in N/m and B in N·s/m."""
        self._state.hand_stiffness = stiffness
        self._state.hand_damping = damping * self._rate

    def alone(self, samples: int) -> None:
        self._library.stencil_run_alone(byref(self._state), samples)

    def with_hand(self, samples: int) -> None:
        """The hand's motion repeats itself after a block."""
        run, state = self._library.stencil_run, byref(self._state)
        motion, forces = pointer(self._motion), pointer(self._forces)
        for begin in range(0, samples, _BLOCK):
            run(state, min(_BLOCK, samples - begin), motion, forces)

    def run(self, motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """The forces on the hand in N while it moves as told, in m; shape (samples,) both."""
        moved = np.ascontiguousarray(motion)
        forces = np.zeros(moved.size)
        self._library.stencil_run(byref(self._state), moved.size, pointer(moved), pointer(forces))
        return forces

    def step_and_see(self, step) -> NDArray[np.float64]:  # type: ignore[no-untyped-def]
        """The masses' positions in m after one sample by `step`."""
        step(1)
        return np.ctypeslib.as_array(self._state.now, (self._masses + 2,))[1:-1]

    def _at_rest(self, string: StringOfMasses) -> _State:
        mobility = 1.0 / (string.mass * self._rate**2)
        damping = mobility * string.damping * self._rate
        both = mobility * string.stiffness + damping
        return _State(
            *(pointer(row) for row in self._rows),
            centre=2.0 - 2.0 * both,
            side=both,
            old_centre=1.0 - 2.0 * damping,
            old_side=damping,
            mobility=mobility,
            held=held_mass(string) + 1,
            masses=string.masses,
        )
