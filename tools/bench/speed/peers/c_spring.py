"""A hand on one spring and damper in C: `reference/spring.c`, the smallest tick there is."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import POINTER, Structure, byref, c_double, c_int64

import numpy as np
from numpy.typing import NDArray

from hapsim.speed_accuracy.strings import cost_of, hand_motion
from speed.reference.build import build_c
from speed.reference.memory import pointer

_BLOCK = 1024  # samples of the hand's motion that are ready: few enough to stay in the nearest cache


class _State(Structure):
    _fields_ = (
        ("hand", c_double),
        ("ground", c_double),
        ("stiffness", c_double),
        ("damping_per_sample", c_double),
    )


class CSpring:
    """K in N/m and B in N·s/m between a hand and the ground, at `rate` Hz. `how`: "run"; "run_called", its scene behind
    a pointer; "run_free", so that the compiler may work on many ticks at once. `plain`: compiled with -O3 -march=native
    and nothing else."""

    def __init__(self, stiffness: float, damping: float, rate: float, how: str = "run", plain: bool = False) -> None:
        built = build_c("spring.c", plain=plain)
        library = built.load()
        self.preparation_s = built.seconds
        self._rate = rate
        self._run = library[f"spring_{how}"]
        self._run.argtypes = [POINTER(_State), c_int64, c_int64, POINTER(c_double), POINTER(c_double)]
        self._state = _State(stiffness=stiffness, damping_per_sample=damping * rate)

    def run(self, motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """The forces on the hand in N while it moves as told, in m; shape (samples,) both."""
        moved = np.ascontiguousarray(motion)
        forces = np.zeros(moved.size)
        self._run(byref(self._state), moved.size, moved.size, pointer(moved), pointer(forces))
        return forces

    def cost(self, rounds: int) -> list[float]:
        """Seconds of processor time for a simulated second, one for each round."""
        return cost_of(self.advancing(), self._rate, rounds)

    def advancing(self) -> Callable[[int], None]:
        """Returns a function that simulates a number of samples while the hand moves."""
        motion, forces = hand_motion(_BLOCK, self._rate), np.zeros(_BLOCK)
        there, back, state = pointer(motion), pointer(forces), byref(self._state)

        def advance(samples: int) -> None:
            self._run(state, samples, _BLOCK, there, back)

        return advance
