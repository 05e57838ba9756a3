"""A program without a device: single ticks or a compiled loop of them, for timing and tests; and the measured cost of
each part of a compiled scene per tick on this machine.

Between two ticks of a loop with a device, other code runs: memory is written and read anew. The loops here do the same
(`_other_code`); otherwise the compiler would merge several ticks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.cordis.dispatch import CALLS, Batch, call_all
from hapsim.cordis.program import PART_TYPES, Program, compile_scene, numbers_of
from hapsim.cordis.spring_energy import number_at
from hapsim.cordis.tick import start as _start_inlined
from hapsim.cordis.tick import take_over as _take_over_inlined
from hapsim.cordis.tick import tick as _tick_inlined
from hapsim.cordis.tick import update_parameters as _update_inlined
from hapsim.scene import Scene

Reals = NDArray[np.float64]

_PAIR_BYTES = 16
_ROUNDS = 7
_ROUND_S = 2e-3
_SHARE = 0.8


@intrinsic
def _other_code(_typing: Any) -> Any:
    """Stands for code that may read and write all memory, for the compiler."""

    def _generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        nothing = cgutils.ir.FunctionType(cgutils.ir.VoidType(), [])
        builder.asm(nothing, "", "~{memory}", [], side_effect=True)
        return context.get_dummy_value()

    return types.void(), _generate


def start(program: Program, measured: Reals) -> None:
    """Puts the device points at `measured` (m, one per channel), at rest. Call it before the first tick."""
    _start(program.record, measured)


def take_over(older: Program, program: Program, measured: Reals) -> None:
    """Starts a program that `take_over_from` prepared to follow `older`. Call it instead of `start`."""
    _take_over(older.record, program.record, measured)


def update_parameters(program: Program) -> None:
    """Moves posted live parameters by a sample. Call it before a tick."""
    _update_parameters(program.record)


def tick(program: Program, measured: Reals, velocity: Reals, force: Reals) -> None:
    """Runs a tick. Arrays have one value per channel: `measured` m, `velocity` m/s, and the result `force`, N."""
    _tick(program.record, measured, velocity, force)


def ticks(program: Program, measured: Reals, velocity: Reals, force: Reals, samples: int) -> None:
    """Runs `samples` ticks, each with the next row of the hands' positions and velocities, (rows, channels), repeated.
    Writes the forces in N to the same row of `force`."""
    _ticks(program.record, measured, velocity, force, samples)


def ticks_watched(program: Program, rows: list[NDArray[Any]], weights: Reals, watched: Reals) -> None:
    """Runs as many ticks as `watched` has room for, all hands at 0. Writes after each the sum of `weights` times the
    current one of two `rows`, contiguous, of the program's type of number. Raises ValueError for other rows."""
    addresses = np.array([row.ctypes.data for row in rows], np.uint64)
    if any(row.dtype != program.rows.dtype or row.size < weights.size for row in rows):
        raise ValueError("rows of another type of number, or too short")
    still = np.zeros(1 + int(program.record.channel.max()))
    _ticks_watched(program.record, still, np.zeros_like(still), addresses, weights, watched)


_start, _take_over = entry(_start_inlined), entry(_take_over_inlined)
_update_parameters, _tick = entry(_update_inlined), entry(_tick_inlined)


@entry
def _ticks(program, measured, velocity, force, samples):
    for begin in range(0, samples, measured.shape[0]):
        for n in range(np.uint64(min(measured.shape[0], samples - begin))):
            _tick_inlined(program, measured[n], velocity[n], force[n])
            _other_code()


@entry
def _ticks_watched(program, measured, force, rows, weights, watched):
    for n in range(watched.size):
        _tick_inlined(program, measured, measured, force)
        row, total = rows[np.uint64(program.turn)], 0.0
        for i in range(weights.size):
            total += weights[i] * number_at(row, i, program.single)
        watched[n] = total


@entry
def _call_many(program, calls, samples):
    for _ in range(samples):
        call_all(calls, program.states[np.uint64(program.turn)])
        _other_code()


class ExplainedPart(NamedTuple):
    """One part of a program. `seconds`: its time alone in a tick; NaN if it does nothing in a tick."""

    name: str
    modules: int
    compiled_as: str
    bytes: int
    seconds: float


class Explanation(NamedTuple):
    """A whole program. `seconds`: of a tick; a sample has `substeps` of them. The parts may take less or more together
    than one by one. `absent`: types of module without compiled code. `points`: hands, grounds and masses."""

    parts: tuple[ExplainedPart, ...]
    absent: tuple[str, ...]
    points: int
    precision: str
    bytes: int
    seconds: float
    period: float
    substeps: int

    @property
    def share(self) -> float:
        """Share of the sample period that its ticks take."""
        return self.seconds * self.substeps / self.period

    @property
    def most_substeps(self) -> int:
        """Number of ticks that fit into the sample period beside an exchange."""
        return most_substeps(self.seconds, self.period)


def explain(scene: Scene, on_part: Callable[[str], None] = lambda _: None) -> Explanation:
    """Compiles `scene` and runs it with resting hands. Returns its parts and times. `on_part` receives each name."""
    program = compile_scene(scene)
    on_part("the whole tick")
    whole = tick_seconds(program, scene.channels)
    parts = []
    for name, modules, compiled_as, part in _named_parts(scene, program):
        on_part(name)
        parts.append(ExplainedPart(name, modules, compiled_as, _bytes_of(part.numbers), _part_seconds(program, part)))
    absent = tuple(kind.name for kind in PART_TYPES if not kind.select(scene))
    size = _bytes_of((program.rows, program.force, *(part.numbers for part in program.parts)))
    return Explanation(
        tuple(parts), absent, len(numbers_of(scene)), scene.precision, size, whole, scene.period, scene.substeps
    )


def tick_seconds(program: Program, channels: int) -> float:
    """Returns the shortest measured time of a tick on this machine, s, with all hands at rest at 0."""
    rest, force = np.zeros((2, 1, channels))
    start(program, rest[0])
    return _seconds(lambda samples: ticks(program, rest, rest, force, samples))


def most_substeps(seconds: float, period: float) -> int:
    """Returns the number of ticks of `seconds` that fit into a sample period, less a fifth for the exchange."""
    return int(_SHARE * period / seconds)


def _named_parts(scene: Scene, program: Program) -> Iterator[tuple[str, int, str, Batch]]:
    """Yields the program's parts: name, number of modules, description, part."""
    if scene.scheme != "cordis":  # there a part is not one type of module
        words = f"a part of the scheme {scene.scheme}, or what pulls from outside it"
        yield from ((type(part.numbers).__name__, 0, words, part) for part in program.parts)
        return
    present = [(kind, len(modules)) for kind in PART_TYPES if (modules := kind.select(scene))]
    for (kind, count), part in zip(present, program.parts, strict=True):
        yield kind.name, count, kind.compiled_as, part


def _part_seconds(program: Program, part: Batch) -> float:
    """Returns a part's time in a tick, s, by itself at the program's own state; NaN if a tick does not call it."""
    seconds = []
    for name in ("add_forces", "integrate"):
        having = [one for one in program.parts if getattr(one, name) is not None]
        for number in (i for i, one in enumerate(having) if one is part):
            alone = new_record(CALLS)
            alone.pairs, alone.count = program.record[name].pairs + np.uint64(_PAIR_BYTES * number), 1
            seconds.append(_seconds(partial(_call_many, program.record, alone)))
    return sum(seconds) or float("nan")


def _seconds(run: Callable[[int], None]) -> float:
    """Returns the shortest time of one sample, s."""
    run(1)
    samples = 64
    while _timed(run, samples) < _ROUND_S:
        samples *= 2
    return min(_timed(run, samples) for _ in range(_ROUNDS)) / samples


def _timed(run: Callable[[int], None], samples: int) -> float:
    begin = time.thread_time()  # of the processor, whatever else it is doing
    run(samples)
    return time.thread_time() - begin


def _bytes_of(numbers: Any) -> int:
    """Returns the bytes of a part's arrays, with its columns of the parameters."""
    if isinstance(numbers, tuple):
        return sum(map(_bytes_of, numbers))
    return numbers.nbytes if isinstance(numbers, np.ndarray) else 0
