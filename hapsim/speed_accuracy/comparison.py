"""Everything at once: objects by methods by precisions by rates."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from hapsim.cordis.schemes import SCHEMES
from hapsim.errors import UsageError
from hapsim.speed_accuracy.contact import Contact
from hapsim.speed_accuracy.cost import Clocks
from hapsim.speed_accuracy.one_spring import OneSpring
from hapsim.speed_accuracy.results import OURS, PRECISIONS, Found, Object, Row
from hapsim.speed_accuracy.strings import RingingString, StringOfMasses

SHARP = 0.2  # by which bending raises mode 5

OBJECTS: tuple[Object, ...] = (
    OneSpring(),
    Contact(),
    RingingString("string-10", "a string of 10 masses", StringOfMasses.tuned(10)),
    RingingString("string-100", "a string of 100 masses", StringOfMasses.tuned(100)),
    RingingString("string-1000", "a string of 1000 masses", StringOfMasses.tuned(1000)),
    RingingString("stiff-string-100", "a stiff string of 100 masses", StringOfMasses.tuned(100, sharp=SHARP)),
)


def objects_named(names: Iterable[str]) -> list[Object]:
    """Those of these names, in their own order; all of them where there is no name. UsageError for another name."""
    known = {one.name: one for one in OBJECTS}
    wanted = set(names)
    for name in sorted(wanted - known.keys()):
        raise UsageError(f"--object: found '{name}', expected one of {', '.join(known)}")
    return [one for one in OBJECTS if not wanted or one.name in wanted]


RATES = (500.0, 1000.0, 2000.0, 5000.0, 10_000.0, 20_000.0, 50_000.0)
"""Hz"""


Tell = Callable[[str], None]


def quiet(_words: str) -> None:
    """Tells nobody."""


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


class Comparison:
    """Cases that have run, and are timed round by round. What is unstable is reported as such, and has no cost.

    `tell` hears what is at hand.
    """

    def __init__(
        self, objects: Sequence[Object], rates: Sequence[float], tell: Tell = quiet, schemes: Sequence[str] = ()
    ) -> None:
        self._cases = cases_of(objects, rates, schemes)
        self._found = [_found(case, f"{i + 1} of {len(self._cases)}", tell) for i, case in enumerate(self._cases)]
        self._timed = [case for case, found in zip(self._cases, self._found, strict=True) if found.errors]
        self._costs: dict[Case, list[float]] = {case: [] for case in self._timed}
        self._clocks = Clocks()
        for i, case in enumerate(self._timed):
            tell(f"warming up {i + 1} of {len(self._timed)}: {case.words}")
            self._clocks.add(case.object.scene(case.method, case.precision, case.rate))

    def round(self) -> None:
        """Times every case once."""
        for case, cost in zip(self._timed, self._clocks.round(), strict=True):
            self._costs[case].append(cost)

    def rows(self) -> list[Row]:
        """A row for each case and quantity, in the order of the objects."""
        return [
            row
            for case, found in zip(self._cases, self._found, strict=True)
            for row in _rows(case, found, tuple(self._costs.get(case, ())))
        ]

    def close(self) -> None:
        """Ends the clocks."""
        self._clocks.close()


def compare(
    objects: Sequence[Object], rates: Sequence[float], rounds: int, tell: Tell = quiet, schemes: Sequence[str] = ()
) -> list[Row]:
    """The rows of a comparison of so many rounds; `schemes`: those alone, where there are any to choose from."""
    with contextlib.closing(Comparison(objects, rates, tell, schemes)) as comparison:
        for number in range(rounds):
            tell(f"timing, round {number + 1} of {rounds}")
            comparison.round()
        return comparison.rows()


def cases_of(objects: Sequence[Object], rates: Sequence[float], schemes: Sequence[str] = ()) -> list[Case]:
    """All there are. Where an object's methods are no schemes, it has them all."""
    left_out = set(SCHEMES) - set(schemes) if schemes else set()
    return [
        Case(one, method, precision, rate)
        for one in objects
        for method, precision, rate in itertools.product(one.methods(), PRECISIONS, rates)
        if method not in left_out
    ]


def _found(case: Case, where: str, tell: Tell) -> Found:
    tell(f"running {where}: {case.words}")
    try:
        return case.object.found(case.method, case.precision, case.rate)
    except UsageError as error:  # a scheme that refuses the scene
        return Found({}, str(error))


def _rows(case: Case, found: Found, costs: tuple[float, ...]) -> list[Row]:
    blank = Row(case.object.name, OURS, case.method, case.precision, case.rate, "", math.nan, costs, found.why_not)
    return [
        replace(blank, quantity=quantity, error=found.errors.get(quantity, math.nan))
        for quantity in case.object.quantities
    ]
