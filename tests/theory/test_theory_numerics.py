"""The pieces that keep the digits: the mass in a period, roots, and functions on a pair of poles."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from hapsim.theory.device_step import device_step
from hapsim.theory.hand.pole_pair import PolePair, oscillator_of_quadratic
from hapsim.theory.hand.poles import all_within, roots


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


class TestFunctionsOnAPair:
    """Slopes against derivatives and divided differences at 40 digits."""

    P = np.array([2.0, 2.0, 2.0, 0.3, 1e-6, 1.0])
    Q = np.array([1.0, 1.0 - 1e-14, 1.0 + 1e-14, 0.5, 1e-12, 0.1])  # double, almost, complex, slow, far apart

    def slope(self, index: int, power: int, over: float) -> mp.mpf:
        with mp.workdps(40):
            p, q = mp.mpf(self.P[index]), mp.mpf(self.Q[index])
            root = mp.sqrt(p * p / 4 - q) or mp.mpf(10) ** -15
            one, other = -p / 2 + root, -p / 2 - root
            f = [(w + 3) ** power / (w + over) for w in (one, other)]
            return mp.re((f[0] - f[1]) / (one - other))

    def test_slopes_of_powers_and_quotients_keep_their_digits_where_the_poles_meet(self) -> None:
        w = PolePair(self.P, self.Q).w
        for power, over in ((0, 5.0), (1, 5.0), (3, 2.0), (7, 4.0)):
            f = w.plus(3.0).power(power).over(w.plus(over))
            for index in range(len(self.P)):
                exact = float(self.slope(index, power, over))
                assert np.broadcast_to(f.slope, self.P.shape)[index] == pytest.approx(exact, rel=1e-12)

    def test_a_polynomial_is_the_sum_of_its_powers(self) -> None:
        w = PolePair(self.P, self.Q).w
        direct = w.polynomial(np.array([2.0, -1.0, 0.5, 3.0]))
        square, cube = w.power(2), w.power(3)
        np.testing.assert_allclose(direct.constant, 2 * cube.constant - square.constant + 3, atol=1e-15)
        np.testing.assert_allclose(direct.slope, 2 * cube.slope - square.slope + 0.5)

    def test_the_oscillator_is_the_logarithm_of_the_poles(self) -> None:
        sigma, kappa = oscillator_of_quadratic(self.P[3:], self.Q[3:])
        for i, (p, q) in enumerate(zip(self.P[3:], self.Q[3:], strict=True)):
            with mp.workdps(40):
                root = mp.sqrt((mp.mpf(p) / 2) ** 2 - mp.mpf(q))
                s = [mp.log(1 - mp.mpf(p) / 2 + sign * root) for sign in (1, -1)]
                assert sigma[i] == pytest.approx(float(mp.re(-s[0] - s[1])), rel=1e-12)
                assert kappa[i] == pytest.approx(float(mp.re(s[0] * s[1])), rel=1e-12)


def test_jurys_test_agrees_with_the_roots() -> None:
    rng = np.random.default_rng(5)
    for degree in (0, 1, 2, 5):
        coefficients = np.concatenate([np.ones((200, 1)), rng.normal(size=(200, degree))], axis=1)
        radius = rng.uniform(0.5, 2.0, 200)
        largest = [np.abs(np.roots(c)).max(initial=0.0) for c in coefficients]
        np.testing.assert_array_equal(all_within(list(coefficients.T), radius), largest < radius)
