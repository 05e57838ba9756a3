"""The comparison: every object, method, precision and rate runs once; then all are timed in turn, round by round.

The cost is the processor time of a simulated second of a scene: compiled ticks in a compiled loop, with a correction's
work around each.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of
from hapsim.cordis.offline import start, ticks
from hapsim.cordis.program import compile_scene
from hapsim.cordis.schemes import SCHEMES
from hapsim.device.mock.assemble_mock import describe_mock
from hapsim.errors import UsageError
from hapsim.loop.exchange import LOOP
from hapsim.loop.hooks import set_hooks
from hapsim.loop.predictor import corrected_ticks
from hapsim.prediction.correction import rendered
from hapsim.running.correction_setup import LoopCorrection
from hapsim.scene import Scene
from hapsim.speed_accuracy.objects import OBJECTS
from hapsim.speed_accuracy.results import OURS, Found, Object, Row
from hapsim.speed_accuracy.strings import Timed, hand_motion

_ROUND_S = 0.02
_BLOCK = 1024  # samples of the hand's motion that are ready: few enough to stay in the nearest cache


class Running:
    """A scene whose first hand repeats the first samples of `hand_motion`."""

    def __init__(self, scene: Scene) -> None:
        rendering = rendered(scene)
        self._program = compile_scene(rendering.scene)
        self._measured, self._velocity, self._force = np.zeros((3, _BLOCK, scene.channels))
        self._measured[:, 0] = hand_motion(_BLOCK, scene.rate)
        start(self._program, self._measured[0])
        self._loop: Any = None
        if rendering.predictors():
            self._loop = new_record(LOOP)
            tick = self._loop.tick
            tick.address, tick.io, tick.gap, tick.age = address_of(tick), address_of(self._loop.io), 1, 1
            self._loop.io.channels = scene.channels
            self._kept = LoopCorrection(self._loop, rendering, describe_mock(scene))
            self._calls = set_hooks(self._loop.hooks, self._kept.hooks)

    def advance(self, samples: int) -> None:
        """Simulates this number of samples."""
        if self._loop is not None:
            corrected_ticks(self._loop, self._program.record, self._measured, samples)
        else:
            ticks(self._program, self._measured, self._velocity, self._force, samples)


PRECISIONS = ("double", "single")
RATES = (500.0, 1000.0, 2000.0, 5000.0, 10_000.0, 20_000.0, 50_000.0)
"""Sample rates, Hz."""

OnStep = Callable[[str], None]


def objects_named(names: Iterable[str]) -> list[Object]:
    """Returns the objects with these names, in their own order; all for no name. Raises UsageError for another."""
    chosen = _named("--object", names, [one.name for one in OBJECTS])
    return [one for one in OBJECTS if not chosen or one.name in chosen]


def schemes_named(names: Iterable[str]) -> list[str]:
    """Returns the schemes with these names, in their own order; none for no name. Raises UsageError for another."""
    return _named("--scheme", names, list(SCHEMES))


def _named(option: str, names: Iterable[str], known: list[str]) -> list[str]:
    wanted = set(names)
    for name in sorted(wanted - set(known)):
        raise UsageError(f"{option}: found '{name}', expected one of {', '.join(known)}")
    return [name for name in known if name in wanted]


class Case(NamedTuple):
    """One combination, which is run once and timed in every round."""

    object: Object
    method: str
    precision: str
    rate: float

    def __str__(self) -> str:
        return f"{self.object.title}: {self.method}, {self.precision}, {self.rate:g} Hz"

    def run(self) -> Found:
        """Returns the errors of the case."""
        try:
            return self.object.found(*self[1:])
        except UsageError as error:  # a scheme that rejects the scene
            return Found({}, str(error))

    def timed(self) -> Timed:
        """Compiles the scene and runs it warm."""
        scene = self.object.scene(*self[1:])
        return Timed(Running(scene).advance, scene.rate, _ROUND_S)


class Comparison:
    """Cases that have run, and are timed round by round. Unstable ones are reported as such, and have no cost.

    `schemes`: the only ones to run, if an object has a choice. `on_step`: called with each step of the progress.
    """

    def __init__(
        self,
        objects: Sequence[Object],
        rates: Sequence[float],
        on_step: OnStep = lambda _: None,
        schemes: Sequence[str] = (),
    ) -> None:
        skipped = set(SCHEMES) - set(schemes) if schemes else set()
        cases = [
            Case(one, method, precision, rate)
            for one in objects
            for method, precision, rate in itertools.product(one.methods, PRECISIONS, rates)
            if method not in skipped
        ]
        self._found: dict[Case, Found] = {}
        for i, case in enumerate(cases):
            on_step(f"running {i + 1} of {len(cases)}: {case}")
            self._found[case] = case.run()
        self._costs: dict[Case, list[float]] = {case: [] for case, found in self._found.items() if found.errors}
        self._apart = ThreadPoolExecutor(1)  # so that the caller's arithmetic stays as it is
        self._timed: dict[Case, Timed] = {}
        for i, case in enumerate(self._costs):
            on_step(f"warming up {i + 1} of {len(self._costs)}: {case}")
            self._timed[case] = self._apart.submit(case.timed).result()

    def round(self) -> None:
        """Times every case once."""
        for case, timed in self._timed.items():
            self._costs[case].append(self._apart.submit(timed.round).result())

    def rows(self) -> list[Row]:
        """Returns a row for each case and quantity, in the order of the objects."""
        rows = []
        for case, found in self._found.items():
            one, method, precision, rate = case
            costs = tuple(self._costs.get(case, ()))
            for quantity in one.quantities:
                error = found.errors.get(quantity, math.nan)
                rows.append(Row(one.name, OURS, method, precision, rate, quantity, error, costs, found.why_not))
        return rows

    def close(self) -> None:
        """Ends the thread of the timing."""
        self._apart.shutdown()


def compare(
    objects: Sequence[Object],
    rates: Sequence[float],
    rounds: int,
    on_step: OnStep = lambda _: None,
    schemes: Sequence[str] = (),
) -> list[Row]:
    """Returns the rows of a comparison with `rounds` rounds."""
    with contextlib.closing(Comparison(objects, rates, on_step, schemes)) as comparison:
        for number in range(rounds):
            on_step(f"timing, round {number + 1} of {rounds}")
            comparison.round()
        return comparison.rows()
