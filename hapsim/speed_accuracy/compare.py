"""Everything at once: objects by methods by precisions by rates."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from hapsim.errors import UsageError
from hapsim.scene import Scene
from hapsim.speed_accuracy.compared import Found, Object
from hapsim.speed_accuracy.cost import costs_of
from hapsim.speed_accuracy.methods import PRECISIONS
from hapsim.speed_accuracy.rows import OURS, Row

RATES = (500.0, 1000.0, 2000.0, 5000.0, 10_000.0, 20_000.0, 50_000.0)
"""Hz"""


@dataclass(frozen=True)
class Case:
    """What is run once and timed in every round."""

    object: Object
    method: str
    precision: str
    rate: float

    @property
    def words(self) -> str:
        return f"{self.object.title}: {self.method}, {self.precision}, {self.rate:g} Hz"


def compare(
    objects: Sequence[Object], rates: Sequence[float], rounds: int, tell: Callable[[str], None] = lambda _: None
) -> list[Row]:
    """A row for each case and quantity, in the order of the objects. What is unstable has no cost.

    `tell` hears what is at hand.
    """
    cases = cases_of(objects, rates)
    found = [_found(case, f"{i + 1} of {len(cases)}", tell) for i, case in enumerate(cases)]
    good = [i for i, one in enumerate(found) if one.errors]
    costs = costs_of(
        [_scene(cases[i]) for i in good],
        rounds,
        lambda i: tell(f"timing, round {i + 1} of {rounds}"),
        lambda i: tell(f"timing, warming up: {cases[good[i]].words}"),
    )
    taken = dict(zip(good, costs, strict=True))
    return [row for i, case in enumerate(cases) for row in _rows(case, found[i], taken.get(i, ()))]


def cases_of(objects: Sequence[Object], rates: Sequence[float]) -> list[Case]:
    """All there are."""
    return [
        Case(one, method, precision, rate)
        for one in objects
        for method, precision, rate in itertools.product(one.methods(), PRECISIONS, rates)
    ]


def _found(case: Case, where: str, tell: Callable[[str], None]) -> Found:
    tell(f"running {where}: {case.words}")
    try:
        return case.object.found(case.method, case.precision, case.rate)
    except UsageError as error:  # a scheme that refuses the scene
        return Found({}, str(error))


def _scene(case: Case) -> Scene:
    return case.object.scene(case.method, case.precision, case.rate)


def _rows(case: Case, found: Found, costs: tuple[float, ...]) -> list[Row]:
    blank = Row(case.object.name, OURS, case.method, case.precision, case.rate, "", math.nan, costs, found.why_not)
    return [
        replace(blank, quantity=quantity, error=found.errors.get(quantity, math.nan))
        for quantity in case.object.quantities
    ]
