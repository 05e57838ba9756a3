"""Faust's mi.lib: the string as a mass-interaction model, compiled to straight code."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import CDLL, POINTER, c_double, c_int, c_void_p
from math import nan

import numpy as np
from numpy.typing import NDArray

from hapsim.speed_accuracy.strings import StringOfMasses, cost_of, frequencies_of, hand_motion, project
from speed.peers.faust_build import BuiltByFaust, build_faust, why_no_faust
from speed.peers.faust_model import Drive, program_of
from speed.reference.build import BuildError

_BLOCK = 512  # samples that one call computes


class FaustMi:
    """The string alone, pushed at one mass, or with a `hand` there.

    Frequencies are those of the same string with a force on every mass, which is how a mode is set off.
    """

    precision = "double"

    def __init__(self, hand: bool = False) -> None:
        self.hand = hand
        self.name = "Faust mi.lib with a hand" if hand else "Faust mi.lib"
        self.preparation_s: float | None = None
        self.note = ""

    def available(self) -> str:
        return why_no_faust()

    def cost(self, string: StringOfMasses, rate: float, rounds: int) -> list[float]:
        run = self.running(string, rate, Drive.HAND if self.hand else Drive.ONE)
        return cost_of(run.advance, rate, rounds) if run else []

    def frequencies(self, string: StringOfMasses, rate: float, modes: Sequence[int]) -> list[float]:
        timed = self.running(string, rate, Drive.HAND if self.hand else Drive.ONE)
        noted = self.note, self.preparation_s
        run = self.running(string, rate, Drive.ALL) if timed else None
        if run is None:
            return [nan for _ in modes]
        self.note, self.preparation_s = noted

        def record(shape: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
            return run.after_blow(shape * string.mass * rate**2, shape, samples)

        return frequencies_of(record, string, rate, modes)

    def running(self, string: StringOfMasses, rate: float, drive: Drive) -> RunningFaust | None:
        """The program for `drive`; None, and a note why, where a compiler gave up."""
        try:
            made = build_faust(program_of(string, drive))
        except BuildError as error:
            self.preparation_s, self.note = None, str(error)
            return None
        self.preparation_s, self.note = made.seconds, _note_on(made)
        return RunningFaust(made.built.load(), string, rate, drive)


def _note_on(made: BuiltByFaust) -> str:
    return f"faust took {made.faust_s:.2f} s, g++ {made.built.seconds:.2f} s"


class RunningFaust:
    """The compiled program and its state."""

    def __init__(self, library: CDLL, string: StringOfMasses, rate: float, drive: Drive) -> None:
        self._library = library
        library.faust_new.restype = c_void_p
        library.faust_new.argtypes = [c_int]
        library.faust_clear.argtypes = library.faust_delete.argtypes = [c_void_p]
        library.faust_compute.argtypes = [c_void_p, c_int, POINTER(POINTER(c_double)), POINTER(POINTER(c_double))]
        wires = string.masses if drive is Drive.ALL else 1
        self._inputs, self._outputs = np.zeros((wires, _BLOCK)), np.zeros((wires, _BLOCK))
        self._in, self._out = _wires(self._inputs), _wires(self._outputs)
        scale = 1.0 if drive is Drive.HAND else string.stiffness
        self._inputs[0] = scale * hand_motion(_BLOCK, rate)
        self._made = c_void_p(library.faust_new(round(rate)))

    def __del__(self) -> None:
        self._library.faust_delete(self._made)

    def advance(self, samples: int) -> None:
        """Simulates a number of samples. The input repeats after a block."""
        compute, made, there, back = self._library.faust_compute, self._made, self._in, self._out
        for begin in range(0, samples, _BLOCK):
            compute(made, min(_BLOCK, samples - begin), there, back)

    def after_blow(self, force: NDArray[np.float64], shape: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
        """The motion along `shape` after `force` in N on each mass for one sample, from rest."""
        self._library.faust_clear(self._made)
        self._inputs[:] = 0.0
        self._inputs[:, 0] = force
        motion = []
        for begin in range(0, samples, _BLOCK):
            self._library.faust_compute(self._made, _BLOCK, self._in, self._out)
            motion.append(project(self._outputs.T[: samples - begin], shape))
            self._inputs[:] = 0.0
        return np.concatenate(motion)

    def run(self, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the response to `signal` from rest; shape (samples,) both, one wire."""
        self._library.faust_clear(self._made)
        there, back = signal.reshape(1, -1).astype(np.float64), np.zeros((1, signal.size))
        self._library.faust_compute(self._made, signal.size, _wires(there), _wires(back))
        return back[0]


def _wires(buffers: NDArray[np.float64]):  # type: ignore[no-untyped-def]
    """An array of pointers to the rows."""
    pointers = [row.ctypes.data_as(POINTER(c_double)) for row in buffers]
    return (POINTER(c_double) * len(pointers))(*pointers)
