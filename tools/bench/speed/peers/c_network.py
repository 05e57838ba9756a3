"""A C program for any network of masses and links: `reference/network.c`. A hand is one of its points."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import CDLL, POINTER, Structure, byref, c_double, c_int64, c_uint32

import numpy as np
from numpy.typing import NDArray

from hapsim.speed_accuracy.ringing import frequencies_of, project
from hapsim.speed_accuracy.strings import StringOfMasses, hand_link, hand_motion, held_mass
from hapsim.speed_accuracy.timing import cost_of
from speed.reference.build import build_c, why_no_compiler
from speed.reference.memory import pointer, rows

_BLOCK = 16384  # samples of the hand's motion that are ready in memory
_HAND, _LEFT, _RIGHT, _MASSES = range(4)  # the points: the hand, the two ends, and where the masses begin


class CNetwork:
    """The string as a network, N + 1 links and one to the hand."""

    name = "C network with a hand"
    precision = "double"

    def __init__(self) -> None:
        self.preparation_s: float | None = None
        self.note = ""

    def available(self) -> str:
        return why_no_compiler()

    def cost(self, string: StringOfMasses, rate: float, rounds: int) -> list[float]:
        run = self.running(string, rate)
        run.start_in(string.plucked())
        run.hold(*hand_link(string))
        return cost_of(run.with_hand, rate, rounds)

    def frequencies(self, string: StringOfMasses, rate: float, modes: Sequence[int]) -> list[float]:
        """The hand's link is there but without stiffness and damping."""
        run = self.running(string, rate)

        def record(shape: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
            run.start_in(shape)
            return np.array([project(run.step_and_see(), shape) for _ in range(samples)])

        return frequencies_of(record, string, rate, modes)

    def running(self, string: StringOfMasses, rate: float) -> RunningNetwork:
        """The program and its state, at rest."""
        built = build_c("network.c")
        self.preparation_s = built.seconds
        return RunningNetwork(built.load(), string, rate)


class _State(Structure):
    _fields_ = (
        ("points", c_int64),
        ("links", c_int64),
        ("masses", c_int64),
        ("first_mass", c_int64),
        ("first", POINTER(c_uint32)),
        ("second", POINTER(c_uint32)),
        ("stiffness", POINTER(c_double)),
        ("damping_per_sample", POINTER(c_double)),
        ("mobility", POINTER(c_double)),
        ("position", POINTER(c_double)),
        ("previous", POINTER(c_double)),
        ("force", POINTER(c_double)),
    )


class RunningNetwork:
    """The compiled program and its state."""

    def __init__(self, library: CDLL, string: StringOfMasses, rate: float) -> None:
        self._rate = rate
        self._run = library.network_run
        self._run.argtypes = [POINTER(_State), c_int64, POINTER(c_double), POINTER(c_double)]
        self._first, self._second = _ends(string)
        count = string.masses + _MASSES
        self._position, self._previous, self._force, self._stiffness, self._damping, self._mobility = rows(6, count)
        self._links = self._first.size
        self._stiffness[: self._links - 1] = string.stiffness
        self._damping[: self._links - 1] = string.damping * rate
        self._mobility[: string.masses] = 1.0 / (string.mass * rate**2)
        self._motion = hand_motion(_BLOCK, rate)
        self._forces = np.zeros(_BLOCK)
        self._state = self._described(string)

    def start_in(self, displacement: NDArray[np.float64]) -> None:
        """Puts the masses at `displacement` in m, shape (N,), at rest, and lets go of them."""
        for row in (self._position, self._previous):
            row[:_MASSES] = 0.0
            row[_MASSES:] = displacement
        self.hold(0.0, 0.0)

    def hold(self, stiffness: float, damping: float) -> None:
        """Links the hand to its mass, K in N/m and B in N·s/m."""
        self._stiffness[self._links - 1] = stiffness
        self._damping[self._links - 1] = damping * self._rate

    def with_hand(self, samples: int) -> None:
        """The hand's motion repeats itself after a block."""
        run, state = self._run, byref(self._state)
        motion, forces = pointer(self._motion), pointer(self._forces)
        for begin in range(0, samples, _BLOCK):
            run(state, min(_BLOCK, samples - begin), motion, forces)

    def run(self, motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """The forces on the hand in N while it moves as told, in m; shape (samples,) both."""
        moved = np.ascontiguousarray(motion)
        forces = np.zeros(moved.size)
        self._run(byref(self._state), moved.size, pointer(moved), pointer(forces))
        return forces

    def step_and_see(self) -> NDArray[np.float64]:
        """The masses' positions in m after one sample."""
        self.with_hand(1)
        return self._position[_MASSES:]

    def _described(self, string: StringOfMasses) -> _State:
        return _State(
            points=string.masses + _MASSES,
            links=self._links,
            masses=string.masses,
            first_mass=_MASSES,
            first=self._first.ctypes.data_as(POINTER(c_uint32)),
            second=self._second.ctypes.data_as(POINTER(c_uint32)),
            stiffness=pointer(self._stiffness),
            damping_per_sample=pointer(self._damping),
            mobility=pointer(self._mobility),
            position=pointer(self._position),
            previous=pointer(self._previous),
            force=pointer(self._force),
        )


def _ends(string: StringOfMasses) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """The points that each link joins: along the string, then the hand's."""
    masses = [_MASSES + i for i in range(string.masses)]
    first = [_LEFT, *masses, _HAND]
    second = [*masses, _RIGHT, _MASSES + held_mass(string)]
    return np.array(first, np.uint32), np.array(second, np.uint32)
