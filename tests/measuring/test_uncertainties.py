"""Errors of random measurements in their stated uncertainties (`tools/bench/measured_uncertainties` has 500)."""

from __future__ import annotations

import numpy as np
import pytest

from tests import thorough
from tests.measured_scenes import KINDS, compared, random_scene

NUMBERS = {"line": (8, 16), "hands": (1, 2), "plane": (1, 2)}
FIRST = {"plane": 5}
"""Seeds: of this one in the plane the links bend with the square of the way, a hundred times as much as noise."""


@pytest.mark.parametrize("kind", KINDS)
def test_errors_are_as_large_as_stated(kind: str) -> None:
    number, first = thorough.points(*NUMBERS[kind.partition(",")[0]]), FIRST.get(kind, 0)
    found = [
        one for seed in range(first, first + number) if (one := compared(kind, *random_scene(kind, seed))) is not None
    ]
    assert len(found) > 0.8 * number
    apart = np.concatenate([one.apart for one in found])
    assert np.abs(apart).max() < 4.0
    assert 0.15 < np.sqrt(np.mean(apart**2)) < 1.6
