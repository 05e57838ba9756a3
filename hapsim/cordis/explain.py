"""What a scene was compiled to, and what each part of it costs per tick: measured, on this machine, now."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hapsim.cordis.dispatch import Part
from hapsim.cordis.offline import act_alone, start, ticks
from hapsim.cordis.program import PART_TYPES, Program, compile_scene, numbers_of
from hapsim.scene import Scene

_ROUNDS = 7
_ROUND_S = 2e-3
_SHARE = 0.8


class ExplainedPart(NamedTuple):
    """One part of a program: `seconds` is what it takes alone, NaN where it does nothing in a tick."""

    name: str
    modules: int
    compiled_as: str
    bytes: int
    seconds: float


class Explanation(NamedTuple):
    """A whole program. `seconds`: of a tick, of which a sample has `substeps`; its parts take less together than one by
    one, or more, as they overlap. `absent`: types of module of which nothing was compiled. `points`: hands, grounds and
    masses."""

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
        """What a sample's ticks take of the sample period."""
        return self.seconds * self.substeps / self.period

    @property
    def most_substeps(self) -> int:
        """How many ticks fit into the sample period beside an exchange."""
        return most_substeps(self.seconds, self.period)

    def as_document(self) -> dict[str, Any]:
        """The same by names, for scripts."""
        return self._asdict() | {"share": self.share, "parts": [part._asdict() for part in self.parts]}


def explain(scene: Scene, on_part: Callable[[str], None] = lambda _: None) -> Explanation:
    """Compiles `scene`, runs it on a hand that rests, and reports its parts; `on_part` hears each part's name."""
    program = compile_scene(scene)
    on_part("the whole tick")
    whole = tick_seconds(program, scene.channels)
    parts = []
    for name, modules, compiled_as, part in _named(scene, program):
        on_part(name)
        parts.append(ExplainedPart(name, modules, compiled_as, _bytes_of(part.numbers), _alone(program, part)))
    absent = tuple(kind.name for kind in PART_TYPES if not kind.select(scene))
    size = _bytes_of((program.rows, program.force, *(part.numbers for part in program.parts)))
    return Explanation(
        tuple(parts), absent, len(numbers_of(scene)), scene.precision, size, whole, scene.period, scene.substeps
    )


def tick_seconds(program: Program, channels: int) -> float:
    """What a tick of this program takes at best, with all hands at rest at 0: measured, on this machine, now."""
    rest, force = np.zeros((2, 1, channels))
    start(program, rest[0])
    return _seconds(lambda samples: ticks(program, rest, rest, force, samples))


def most_substeps(seconds: float, period: float) -> int:
    """How many ticks of so many seconds fit into a sample period, with a fifth of it left for the exchange."""
    return int(_SHARE * period / seconds)


def _named(scene: Scene, program: Program) -> Iterator[tuple[str, int, str, Part]]:
    """The program's parts, with their names, how many modules each has, and in words what they are."""
    if scene.scheme != "cordis":  # whose parts are not one for each type of module
        words = f"a part of the scheme {scene.scheme}, or what pulls from outside it"
        yield from ((type(part.numbers).__name__, 0, words, part) for part in program.parts)
        return
    present = [(kind, len(modules)) for kind in PART_TYPES if (modules := kind.select(scene))]
    for (kind, count), part in zip(present, program.parts, strict=True):
        yield kind.name, count, kind.compiled_as, part


def _alone(program: Program, part: Part) -> float:
    """What a part takes of a tick, called by itself; NaN where a tick does not call it."""
    in_a_tick = [name for name in ("add_forces", "integrate") if getattr(part, name) is not None]
    return sum(_seconds(partial(act_alone, program, name, part)) for name in in_a_tick) or float("nan")


def _seconds(run: Callable[[int], None]) -> float:
    """What one sample takes, at best."""
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
    """What its arrays take, those counted once that it has from the array of the parameters."""
    if isinstance(numbers, tuple):
        return sum(map(_bytes_of, numbers))
    return numbers.nbytes if isinstance(numbers, np.ndarray) else 0
