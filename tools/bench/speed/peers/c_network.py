"""A C program for any network of masses and links: `reference/network.c`. A hand is one of its points."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import CDLL, POINTER, Structure, byref, c_double, c_int64, c_uint32
from dataclasses import dataclass

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
_HAND, _LEFT, _RIGHT, _MASSES = range(4)  # the points of a string: the hand, the two ends, and where the masses begin


@dataclass(frozen=True)
class Network:
    """Point 0 is the hand; then come `fixed` points that stay, at 0, then the masses, `mass` in kg each, shape (M,).

    `first`, `second`: the points that each link joins; `stiffness`, `damping`: N/m, N·s/m; shape (L,).
    """

    fixed: int
    mass: NDArray[np.float64]
    first: NDArray[np.uint32]
    second: NDArray[np.uint32]
    stiffness: NDArray[np.float64]
    damping: NDArray[np.float64]


def network_of(string: StringOfMasses) -> Network:
    """The string, and a last link from the hand to a mass, without stiffness and damping."""
    masses = [_MASSES + i for i in range(string.masses)]
    first, second = [_LEFT, *masses, _HAND], [*masses, _RIGHT, _MASSES + held_mass(string)]
    along = np.append(np.ones(string.masses + 1), 0.0)
    return Network(
        fixed=2,
        mass=np.full(string.masses, string.mass),
        first=np.array(first, np.uint32),
        second=np.array(second, np.uint32),
        stiffness=string.stiffness * along,
        damping=string.damping * along,
    )


class CNetwork:
    """The string as a network, N + 1 links and one to the hand. `plain`: compiled with -O3 -march=native and nothing
    else."""

    name = "C network with a hand"
    precision = "double"

    def __init__(self, plain: bool = False) -> None:
        self.plain = plain
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
        built = build_c("network.c", plain=self.plain)
        self.preparation_s = built.seconds
        return RunningNetwork(built.load(), network_of(string), rate)


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

    def __init__(self, library: CDLL, network: Network, rate: float) -> None:
        self._network, self._rate = network, rate
        self._run = library.network_run
        self._run.argtypes = [POINTER(_State), c_int64, POINTER(c_double), POINTER(c_double)]
        self._first_mass = 1 + network.fixed
        self._position, self._previous, self._force = rows(3, self._first_mass + network.mass.size)
        self._stiffness, self._damping = rows(2, network.first.size)
        (self._mobility,) = rows(1, network.mass.size)
        self._stiffness[:] = network.stiffness
        self._damping[:] = network.damping * rate
        self._mobility[:] = 1.0 / (network.mass * rate**2)
        self._motion = hand_motion(_BLOCK, rate)
        self._forces = np.zeros(_BLOCK)
        self._state = self._described()

    def start_in(self, displacement: NDArray[np.float64]) -> None:
        """Puts the masses at `displacement` in m, shape (N,), at rest, and releases them."""
        for row in (self._position, self._previous):
            row[: self._first_mass] = 0.0
            row[self._first_mass :] = displacement
        self.hold(0.0, 0.0)

    def hold(self, stiffness: float, damping: float) -> None:
        """Gives the last link, the hand's, its K in N/m and B in N·s/m."""
        self._stiffness[-1] = stiffness
        self._damping[-1] = damping * self._rate

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
        return self._position[self._first_mass :]

    def _described(self) -> _State:
        network = self._network
        return _State(
            points=self._position.size,
            links=network.first.size,
            masses=network.mass.size,
            first_mass=self._first_mass,
            first=network.first.ctypes.data_as(POINTER(c_uint32)),
            second=network.second.ctypes.data_as(POINTER(c_uint32)),
            stiffness=pointer(self._stiffness),
            damping_per_sample=pointer(self._damping),
            mobility=pointer(self._mobility),
            position=pointer(self._position),
            previous=pointer(self._previous),
            force=pointer(self._force),
        )
