"""The tests that run with `--all` alone: most cases of those that many cases prove, and more random points."""

from __future__ import annotations

import itertools
import os
import random
from collections import defaultdict
from collections.abc import Sequence

import pytest

ALL = False
"""True with `--all`; set by conftest.py before any test is imported."""


def points(few: int, many: int) -> int:
    """Returns the number of random points of a test: HAPSIM_POINTS, else `many` with `--all`, else `few`."""
    return int(os.environ.get("HAPSIM_POINTS", many if ALL else few))


def left_out(items: Sequence[pytest.Item]) -> set[pytest.Item]:
    """Returns the cases of tests marked `thorough` that do not run. `thorough(keep=n)` keeps n cases of each test,
    always the same ones, and more until every value of a parameter with at most n values is there. With `--all` every
    two values of different parameters meet: of three parameters or more, not all cases run."""
    marked: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        if item.get_closest_marker("thorough") is not None:
            marked[item.nodeid.partition("[")[0]].append(item)
    return {item for cases in marked.values() for item in set(cases) - (_in_pairs if ALL else _kept)(cases)}


def _kept(cases: list[pytest.Item]) -> set[pytest.Item]:
    mark = cases[0].get_closest_marker("thorough")
    count = 0 if mark is None else mark.kwargs.get("keep", 0)
    if count == 0:
        return set()
    shuffled = random.Random(0).sample(cases, len(cases))
    values: dict[str, dict[int, pytest.Item]] = defaultdict(dict)  # a case with each value of each parameter
    for case in shuffled:
        for name, value in case.callspec.params.items():  # type: ignore[attr-defined]
            values[name].setdefault(id(value), case)
    kept = {case for by_value in values.values() if len(by_value) <= count for case in by_value.values()}
    return kept | set([case for case in shuffled if case not in kept][: max(count - len(kept), 0)])


def _in_pairs(cases: list[pytest.Item]) -> set[pytest.Item]:
    kept, met = set(), set[tuple[tuple[str, int], ...]]()
    for case in random.Random(0).sample(cases, len(cases)):
        params = case.callspec.params if hasattr(case, "callspec") else {}
        pairs = [*itertools.combinations([(name, id(value)) for name, value in params.items()], 2)]
        if len(params) < 3 or not met.issuperset(pairs):
            kept.add(case)
            met.update(pairs)
    return kept
