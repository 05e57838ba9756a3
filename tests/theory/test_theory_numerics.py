"""The pieces that keep the digits: responses, factors, and functions on a pair of poles."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from hapsim.theory.hand.factors import quadratic_factors, roots_of_factors
from hapsim.theory.hand.pole_pair import PolePair, oscillator_of_quadratic
from hapsim.theory.hand.poles import all_within
from hapsim.theory.hand.sampled_plant import response_to_a_blow


@pytest.mark.parametrize("damping", [0.0, 1e-15, 1e-6, 0.3, 2.0, 40.0, 500.0])
@pytest.mark.parametrize("stiffness", [0.0, 1e-12, 0.0225, 1.0, 1.0000001, 9.0])
def test_the_response_to_a_blow_is_good_to_rounding(damping: float, stiffness: float) -> None:
    with mp.workdps(60):
        chain = mp.matrix([[-mp.mpf(damping), -mp.mpf(stiffness), 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])
        for time in (1e-9, 0.1, 0.63, 1.0, 3.0):
            exact = mp.expm(chain * mp.mpf(time), method="taylor")[:, 0]
            found = response_to_a_blow(damping, stiffness, time)
            scale = [1.0, time, time**2, time**3]  # a swing passes through zero; no digit is lost beyond that
            for i in range(4):
                assert abs(found[i] - float(exact[i])) < 1e-13 * max(abs(float(exact[i])), 1e-2 * scale[i])


class TestFactors:
    """The roots of many polynomials at once."""

    def coefficients(self, roots: np.ndarray) -> list[np.ndarray]:
        """(n, N) roots w to monic polynomials, lowest power first."""
        return list(np.array([np.poly(row)[::-1].real for row in roots]).T)

    @pytest.mark.parametrize("degree", [2, 3, 4, 5, 6, 7, 8])
    def test_where_they_were_found_they_are_the_roots(self, degree: int) -> None:
        rng = np.random.default_rng(degree)
        pairs = rng.uniform(0.3, 1.0, (300, degree // 2)) * np.exp(1j * rng.uniform(0.0, 3.0, (300, degree // 2))) - 1.0
        roots = np.concatenate([pairs, pairs.conj(), rng.uniform(-1.9, 0.0, (300, degree % 2))], axis=1)
        with np.errstate(all="ignore"):
            factors = quadratic_factors(self.coefficients(roots))
        assert factors.found.mean() > 0.5  # the others are left to the eigenvalues
        real, imaginary = roots_of_factors(factors)
        found = (real + 1j * imaginary).T
        off = np.abs(found[:, :, None] - roots[:, None, :]).min(axis=1)[factors.found]
        assert np.median(off) < 1e-12
        assert np.quantile(off, 0.99) < 1e-7

    def test_slow_roots_keep_their_digits(self) -> None:
        slow = np.geomspace(1e-12, 1e-2, 11)
        roots = np.stack([slow * (-1.0 + 2.0j), slow * (-1.0 - 2.0j), slow * 0 - 0.7, slow * 0 - 0.9], axis=1)
        with mp.workdps(40):
            exact = [[mp.mpf(1)] for _ in slow]
            for i, row in enumerate(roots):
                for root in row:
                    w = mp.mpc(root)
                    shifted, same = [mp.mpf(0), *exact[i]], [*exact[i], mp.mpf(0)]
                    exact[i] = [a - w * b for a, b in zip(shifted, same, strict=True)]
            coefficients = list(np.array([[float(mp.re(c)) for c in row] for row in exact]).T)
        factors = quadratic_factors(coefficients)
        assert factors.found.all()
        np.testing.assert_allclose(factors.p[0], 2.0 * slow, rtol=1e-12)
        np.testing.assert_allclose(factors.q[0], 5.0 * slow**2, rtol=1e-12)

    def test_what_is_not_finite_is_not_found(self) -> None:
        bad = [np.array([np.nan, 1.0, np.inf]), np.array([1.0, np.nan, 1.0]), *[np.ones(3)] * 3]
        with np.errstate(all="ignore"):
            assert not quadratic_factors(bad).found.any()


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
