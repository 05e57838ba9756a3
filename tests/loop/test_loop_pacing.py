"""The clock's rule, as compiled loops and the loop in Python have it."""

from __future__ import annotations

import numba
import pytest

from hapsim.loop.clocks import next_point

DUE, PERIOD = 1_000_000, 500

next_point_compiled = numba.njit(next_point)


@pytest.mark.parametrize("rule", [next_point, next_point_compiled])
@pytest.mark.parametrize(
    ("late", "point", "missed"),
    [
        (-100, DUE + PERIOD, 0),
        (0, DUE + PERIOD, 0),
        (PERIOD - 1, DUE + PERIOD, 0),  # late, and the next point stays where it was
        (PERIOD, DUE + 2 * PERIOD, 1),
        (PERIOD + 1, DUE + 2 * PERIOD + 1, 1),  # the grid starts anew
        (10**9, DUE + 10**9 + PERIOD, 1),  # one miss, and no burst
    ],
)
def test_a_point_kept_less_than_a_period_late_leaves_the_grid_and_a_later_one_starts_it_anew(
    rule: object, late: int, point: int, missed: int
) -> None:
    assert callable(rule)
    assert rule(DUE, DUE + late, PERIOD) == (point, missed)
