"""The pieces that keep the digits: the mass in a period, roots, and functions on a pair of poles."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from hapsim.theory.device_step import device_step
from hapsim.theory.hand.poles import roots


@pytest.mark.parametrize("damping", [0.0, 1e-15, 1e-6, 0.3, 2.0, 40.0, 500.0])
@pytest.mark.parametrize("stiffness", [0.0, 1e-12, 0.0225, 1.0, 1.0000001, 9.0])
def test_what_a_period_makes_of_the_mass_is_good_to_rounding(damping: float, stiffness: float) -> None:
    step = device_step(damping, 0.0, "zoh", stiffness)
    with mp.workdps(60):
        rate = mp.matrix([[0, 1, 0], [-mp.mpf(stiffness), -mp.mpf(damping), 1], [0, 0, 0]])
        exact = mp.expm(rate, method="taylor") - mp.eye(3)
        for row in range(2):
            for column, found in enumerate((*step.motion[row], step.forces[row, 0])):
                assert abs(found - float(exact[row, column])) < 1e-13 * max(abs(float(exact[row, column])), 1e-3)


def test_roots_are_those_that_the_polynomials_were_made_of() -> None:
    rng = np.random.default_rng(4)
    for degree in range(2, 9):
        pairs = rng.uniform(0.3, 1.0, (300, degree // 2)) * np.exp(1j * rng.uniform(0.0, 3.0, (300, degree // 2)))
        exact = np.concatenate([pairs, pairs.conj(), rng.uniform(-0.9, 1.0, (300, degree % 2))], axis=1)
        found = roots(np.array([np.poly(row).real for row in exact]))
        assert (np.diff(np.abs(found), axis=1) <= 0.0).all()
        off = np.abs(found[:, :, None] - exact[:, None, :]).min(axis=1)
        assert np.median(off) < 1e-14
        assert np.quantile(off, 0.99) < 1e-7
    assert np.isnan(roots(np.array([1.0, np.inf, 0.5]))).all()
