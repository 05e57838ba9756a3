"""The pieces that keep the digits: the exponential integrals, and functions on a pair of poles."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from hapsim.theory.pair import oscillator_of_quadratic, pair_of_quadratic
from hapsim.theory.phi import phi
from hapsim.theory.poles import all_within


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_the_exponential_integrals_are_good_to_rounding(order: int) -> None:
    u = np.concatenate([[0.0], np.geomspace(1e-15, 500.0, 300), [1.0, np.nextafter(1.0, 0.0)]])
    with mp.workdps(120):
        exact = []
        for value in map(mp.mpf, u):
            result = mp.exp(-value)
            for n in range(1, order + 1):
                result = (1 / mp.factorial(n - 1) - result) / value if value else 1 / mp.factorial(n)
            exact.append(float(result))
    np.testing.assert_allclose(phi(order, u), exact, rtol=1e-15)


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
        w = pair_of_quadratic(self.P, self.Q)
        for power, over in ((0, 5.0), (1, 5.0), (3, 2.0), (7, 4.0)):
            f = w.plus(3.0).power(power).over(w.plus(over))
            for index in range(len(self.P)):
                exact = float(self.slope(index, power, over))
                assert f.slope[index].real == pytest.approx(exact, rel=1e-12)
                assert f.slope[index].imag == pytest.approx(0.0, abs=1e-12 * abs(exact))

    def test_a_polynomial_is_the_sum_of_its_powers(self) -> None:
        w = pair_of_quadratic(self.P, self.Q)
        direct = w.polynomial(np.array([2.0, -1.0, 0.5, 3.0]))
        square, cube = w.power(2), w.power(3)
        np.testing.assert_allclose(direct.near, 2 * cube.near - square.near + 0.5 * w.near + 3)
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
        np.testing.assert_array_equal(all_within(coefficients, radius), largest < radius)
