"""What a scene was compiled to, and what each part of it costs per tick: measured, on this machine, now."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from hapsim.compiled import jit
from hapsim.cordis.acting import move_all, pull_all
from hapsim.cordis.desk import desk_of, other_code, ticks
from hapsim.cordis.device_point import felt
from hapsim.cordis.ground import GROUND
from hapsim.cordis.kinds import KINDS
from hapsim.cordis.moment import at_hand, registers_for
from hapsim.cordis.program import Program, compile_scene, numbers_of
from hapsim.cordis.tick import start
from hapsim.scene import Scene

_ROUNDS = 7
_ROUND_S = 2e-3


class ExplainedPart(NamedTuple):
    """One part of a program: `seconds` is what it takes alone, NaN where it does nothing in a tick."""

    name: str
    modules: int
    compiled_as: str
    bytes: int
    seconds: float


class Explanation(NamedTuple):
    """A whole program. `seconds`: of a tick; its parts take less together than one by one, or more, as they overlap."""

    parts: tuple[ExplainedPart, ...]
    absent: tuple[str, ...]
    """Kinds of module that the scene does not have, and of which nothing was compiled."""
    points: int
    """Hands, grounds and masses, without what structures have beside theirs."""
    precision: str
    bytes: int
    seconds: float
    period: float

    def as_document(self) -> dict[str, Any]:
        """The same by names, for scripts."""
        return self._asdict() | {"parts": [part._asdict() for part in self.parts]}


def explain(scene: Scene, on_part: Callable[[str], None] = lambda _: None) -> Explanation:
    """Compiles `scene`, runs it on a hand that rests, and tells what it is made of; `on_part` hears what is at hand."""
    program = compile_scene(scene)
    desk = desk_of(scene)
    start(program, desk["measured"])
    on_part("the whole tick")
    whole = _seconds(lambda samples: ticks(program, desk, samples))
    parts = []
    for name, modules, compiled_as, part in _named(scene, program):
        on_part(name)
        alone = float("nan") if part is program.grounds else _alone(program, part, desk)
        parts.append(ExplainedPart(name, modules, compiled_as, _bytes_of(part), alone))
    absent = tuple(kind.name for kind in KINDS if not kind.select(scene))
    points = len(numbers_of(scene))
    return Explanation(tuple(parts), absent, points, scene.precision, _bytes_of(program), whole, scene.period)


def _named(scene: Scene, program: Program) -> Iterator[tuple[str, int, str, Any]]:
    """The program's parts, with their names, how many modules each has, and in words what they are."""
    if scene.scheme != "cordis":  # whose parts are not one for each kind of module
        if program.grounds is not None:
            yield GROUND.name, len(scene.grounds), GROUND.compiled_as, program.grounds
        for part in program.parts:
            yield type(part).__name__, 0, f"a part of the scheme {scene.scheme}, or pulled from outside it", part
        return
    acting = iter(program.parts)
    for kind in KINDS:
        modules = kind.select(scene)
        if modules:
            yield kind.name, len(modules), kind.compiled_as, program.grounds if kind is GROUND else next(acting)


def _alone(program: Program, part: Any, desk: Any) -> float:
    return _seconds(lambda samples: _acts(program, (part,), desk, samples))


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


@jit
def _acts(program, parts, desk, samples):
    moment = at_hand(program, desk.velocity, registers_for(program))
    for _ in range(samples):
        pull_all(parts, moment)
        felt(program.devices, moment.force, desk.force)
        move_all(parts, moment)
        other_code()


def _bytes_of(part: Any) -> int:
    """What its arrays take, those counted once that it has from the array of the parameters."""
    return sum(array.nbytes for array in _arrays(part))


def _arrays(part: Any) -> Iterator[np.ndarray]:
    if isinstance(part, np.ndarray):
        yield part
    elif isinstance(part, tuple):
        for field in part:
            yield from _arrays(field)
