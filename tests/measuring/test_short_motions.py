"""Poles of a motion that is hardly longer than they are many."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.measuring.fitted_pair import _visible_poles

POLES = np.array([0.9 + 0.1j, 0.9 - 0.1j, 0.5 + 0j, 1.1 + 0j])


@pytest.mark.parametrize("samples", range(9))
def test_a_short_motion_shows_every_pole_or_those_it_has(samples: int) -> None:
    motion = np.real(POLES[0] ** np.arange(samples))
    (seen,), (energy,) = _visible_poles(motion, POLES[None])
    assert seen.shape == energy.shape == POLES.shape
    assert seen[:2].all()
    if samples < POLES.size + 2:  # a motion and a constant fit it whatever the poles
        assert seen.all()
