"""(k, b) to (K, B) and back, and where there is no answer."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapsim.holds import HOLDS
from hapsim.theory import Configuration
from tests import thorough

MASS, RATE = 0.2, 1000.0
UNIT = MASS * RATE**2
SAMPLINGS = ("ideal", "average")
DELAYS = (0.0, 0.37, 1.0, 1.5, 2.0)


CONFIGURATIONS = st.builds(
    Configuration,
    mass=st.floats(1e-3, 10.0),
    rate=st.floats(100.0, 50e3),
    friction=st.one_of(st.just(0.0), st.floats(1e-6, 10.0)),
    delay=st.one_of(st.integers(0, 4), st.floats(0.0, 6.0)),
    hold=st.sampled_from(list(HOLDS)),
    sampling=st.sampled_from(SAMPLINGS),
)
DAMPERS = {"backward": None, "centred": None, "filtered": 90.0, "sensed": None}
# In each of 576 configurations; HAPSIM_POINTS=1000 makes it nearly half a million that have an answer.
POINTS_EACH = thorough.points(6, 8)


def there_and_back(c: Configuration, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the error of (k, b) after inversion, over thirteen decades, some nearly critical, and the distance to a
    fold."""
    nearly = count // 4
    kappa = 10.0 ** rng.uniform(-12.0, 0.8, count)
    ratio = np.concatenate([10.0 ** rng.uniform(-3.0, 0.5, count - nearly), 1.0 + rng.uniform(-1e-6, 1e-6, nearly)])
    k = c.stiffness + kappa * c.stiffness_unit
    b = 2.0 * ratio * np.sqrt(k * c.mass)
    K, B = c.simulated(k, b)
    had = np.isfinite(K)
    again_k, again_b = c.equivalent(K[had], B[had])
    # b is what B and b0 leave of each other: its last digits are theirs.
    off = np.maximum(np.abs(again_k / k[had] - 1.0), np.abs(again_b - b[had]) / (b[had] + 1e-6 * c.friction))
    # Close to a fold, where a further pole meets the pair, the inverse itself is ill-conditioned.
    distance = fold_distance(c, K[had], B[had])
    assert (off[distance > 1e-3] < 1e-8).all()
    return off, distance


def test_it_does_in_every_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    loops = itertools.product(HOLDS, SAMPLINGS, (0.0, 0.37, 1.0, 1.5, 2.0, 3.3), DAMPERS, (0.0, 1e-3, 0.3), (0.0, 2.0))
    came = []
    for hold, sampling, delay, damper, spring, friction in loops:
        c = Configuration(MASS, RATE, friction, delay, hold, sampling, spring * UNIT, damper, DAMPERS[damper])
        came.append(there_and_back(c, rng, POINTS_EACH))
    off, distance = (np.concatenate(column) for column in zip(*came, strict=True))
    far = off > 1e-8
    with capsys.disabled():
        print(f"\n{off.size} points, {far.sum()} off by more than 1e-8, at most {off.max():.1e},", end=" ")
        print(f"all closer than {distance[far].max(initial=0.0):.1e} to a fold")
    assert far.mean() < 1e-3


def fold_distance(c: Configuration, K: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Returns the distance of the nearest other pole to one of the pair. Powers of 1/z have one at 0, with which a pole
    that dies within a sample meets."""
    poles = c.poles(K, B)
    others = np.append(poles[:, 2:], np.zeros((len(poles), 1)), axis=1)
    return np.abs(poles[:, :2, None] - others[:, None, :]).min(axis=(1, 2))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(c=CONFIGURATIONS, seed=st.integers(0, 2**32 - 1))
def test_simulated_has_no_answer_exactly_where_further_poles_are_as_slow(c: Configuration, seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = 10.0 ** rng.uniform(-4.0, 0.9, 300) * c.stiffness_unit
    b = rng.uniform(-0.5, 3.0, 300) * np.sqrt(k * c.mass)
    K, B = c.simulated(k, b, dominant=False)
    possible = np.isfinite(K)
    k, b, K, B = (values[possible] for values in (k, b, K, B))

    s = np.sqrt((0.5 * b / c.mass) ** 2 - k / c.mass + 0j)
    slowest = np.exp((-0.5 * b / c.mass + np.stack([s, -s])) * c.period)
    moduli = np.sort(np.abs(c.poles(K, B)), axis=-1)[:, ::-1]
    if moduli.shape[1] == 2:
        expected = np.ones(k.shape, dtype=bool)
        clear = expected
    else:
        lower = np.abs(slowest).min(axis=0)
        expected = (np.abs(moduli[:, 1] - lower) < 1e-6) & (moduli[:, 2] < lower)
        clear = np.abs(moduli[:, 2] - lower) > 1e-6
    answered = np.isfinite(c.simulated(k, b)[0])
    assert (answered == expected)[clear].all()


class TestWhereThereIsNoAnswer:
    c = Configuration(mass=MASS, rate=RATE, friction=1.0)

    def test_with_delay_some_k_b_cannot_be_had(self) -> None:
        k, b = 1.0 * UNIT, 1.0
        assert np.isnan(self.c.simulated(k, b)).all()
        K, B = self.c.simulated(k, b, dominant=False)
        assert np.isfinite([K, B]).all()
        assert not np.isclose(self.c.equivalent(K, B)[0], k, rtol=1e-3)

    def test_a_pole_on_the_negative_axis_is_no_oscillators(self) -> None:
        c = Configuration(mass=MASS, rate=RATE, delay=0.0, hold="impulse")
        K, B = 0.5 * UNIT, 1.5 * MASS * RATE  # poles of opposite signs
        assert np.prod(c.poles(K, B)) < 0.0
        assert not c.dominant(K, B)
        assert np.isnan(c.equivalent(K, B)).all()
        assert np.isnan(c.dominant_poles(K, B)).all()

    def test_a_loop_whose_slowest_pole_is_real_and_the_next_a_pair_has_no_equivalent(self) -> None:
        c = Configuration(mass=MASS, rate=RATE, delay=0.0)
        K, B = 0.01 * UNIT, 1.8 * MASS * RATE
        slowest, next_to_it, _ = c.poles(K, B)
        assert slowest.imag == 0.0
        assert next_to_it.imag > 0.0
        assert not c.dominant(K, B)
        assert np.isnan(c.equivalent(K, B)).all()
        assert c.is_stable(K, B)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_what_is_not_finite_gives_nan_and_no_warning(self, bad: float) -> None:
        for hold, sampling, delay in itertools.product(HOLDS, SAMPLINGS, DELAYS):
            c = Configuration(mass=1e-3, rate=RATE, delay=delay, hold=hold, sampling=sampling)
            for K, B in ((bad, 1.0), (1.0, bad), (bad, bad)):
                assert np.isnan(c.simulated(K, B)).all()
                assert np.isnan(c.equivalent(K, B)).all()
                assert not c.dominant(K, B)
                assert not c.is_stable(K, B)
                c.poles(K, B), c.spectral_radius(K, B), c.characteristic(K, B)

    @pytest.mark.parametrize("huge", [1e100, -1e200, 1e308])
    def test_what_is_absurd_gives_no_warning(self, huge: float) -> None:
        for hold, sampling, delay in itertools.product(HOLDS, SAMPLINGS, DELAYS):
            c = Configuration(mass=1e-3, rate=RATE, friction=1e9, delay=delay, hold=hold, sampling=sampling)
            for K, B in ((huge, 1.0), (1.0, huge), (huge, huge), (1.0 / huge, 1.0 / huge)):
                assert not np.isinf([*c.simulated(K, B), *c.equivalent(K, B)]).any()
                c.is_stable(K, B), c.poles(K, B), c.spectral_radius(K, B), c.characteristic(K, B)

    def test_one_bad_element_does_not_touch_the_others(self) -> None:
        k, b = self.c.equivalent([100.0, np.nan, 200.0], 1.0)
        assert np.isfinite(k).tolist() == np.isfinite(b).tolist() == [True, False, True]


class TestPoles:
    c = Configuration(mass=MASS, rate=RATE, friction=1.0, delay=1.5)

    def test_they_are_the_characteristic_polynomials_roots_by_decreasing_modulus(self) -> None:
        K, B = np.geomspace(1.0, 1e6, 30)[:, None], np.linspace(-50.0, 300.0, 20)
        poles, coefficients = self.c.poles(K, B), self.c.characteristic(K, B)
        assert poles.shape == (30, 20, 5)
        assert coefficients.shape == (30, 20, 6)
        assert (np.diff(np.abs(poles), axis=-1) <= 1e-15).all()
        assert np.array_equal(self.c.spectral_radius(K, B), np.abs(poles[..., 0]))
        for index in np.ndindex(30, 20):
            np.testing.assert_allclose(np.poly(poles[index]), coefficients[index], atol=1e-9)

    def test_a_very_slow_motion_is_still_known_to_be_stable(self) -> None:
        k = 10.0 ** np.arange(-20.0, 0.0)
        assert self.c.is_stable(k, 0.0).all()
        assert not self.c.is_stable(-k, 0.0).any()
        np.testing.assert_allclose(self.c.equivalent(k, 0.0)[0], k, rtol=0.02)


class TestArguments:
    def test_scalars_give_scalars_and_arrays_broadcast(self) -> None:
        c = Configuration(mass=MASS, rate=RATE)
        assert all(np.ndim(value) == 0 for value in (*c.simulated(1.0, 1.0), *c.equivalent(1.0, 1.0)))
        assert np.ndim(c.is_stable(1.0, 1.0)) == np.ndim(c.dominant(1.0, 1.0)) == 0
        K, B = c.simulated(np.ones((3, 1)), np.ones(4))
        assert K.shape == B.shape == (3, 4)
        assert c.poles(np.ones((3, 1)), np.ones(4)).shape == (3, 4, 4)
        assert c.equivalent([], [])[0].shape == (0,)

    def test_the_papers_units_are_those_of_mass_and_period(self) -> None:
        c = Configuration(mass=MASS, rate=RATE)
        assert c.period == pytest.approx(1e-3)
        assert c.normalised(c.stiffness_unit, c.damping_unit) == pytest.approx((1.0, 1.0))

    @pytest.mark.parametrize(
        ("changed", "says"),
        [
            ({"mass": 0.0}, "mass is 0"),
            ({"mass": np.nan}, "mass is nan"),
            ({"mass": "heavy"}, "mass is 'heavy'"),
            ({"rate": -1.0}, "rate is -1"),
            ({"friction": -0.1}, "friction is -0.1"),
            ({"delay": -1.0}, "delay is -1"),
            ({"delay": np.inf}, "delay is inf"),
            ({"hold": "first-order"}, "one of: zoh, impulse"),
            ({"sampling": None}, "one of: ideal, average"),
        ],
    )
    def test_a_wrong_one_is_refused_with_a_sentence(self, changed: dict[str, object], says: str) -> None:
        with pytest.raises(ValueError, match=says):
            Configuration(**({"mass": MASS, "rate": RATE} | changed))


@pytest.mark.parametrize("seed", range(6))
def test_the_deformation_is_the_derivative_of_the_poles(seed: int) -> None:
    """Derivatives of the characteristic polynomial, which is linear in K and B."""
    drawn = np.random.default_rng(seed)
    hold, delay = str(drawn.choice(["zoh", "impulse"])), float(drawn.choice([0.0, 0.5, 1.0, 2.0]))
    c = Configuration(10.0 ** drawn.uniform(-2.0, 1.0), 1000.0, drawn.uniform(0.0, 3.0), delay, hold)
    K, B = c.stiffness_unit * 10.0 ** drawn.uniform(-5.0, -1.0), c.damping_unit * 10.0 ** drawn.uniform(-4.0, -1.0)
    z = c.dominant_poles(K, B)
    s, slope = np.log(z.astype(complex)) * c.rate, np.polyval(np.polyder(c.characteristic(K, B)), z)
    changes = [c.characteristic(*at) - c.characteristic(0.0, 0.0) for at in ((1.0, 0.0), (0.0, 1.0))]
    (by_K, by_B) = (-np.polyval(change, z) / slope / z * c.rate for change in changes)
    k = [(c.mass * (by[0] * s[1] + s[0] * by[1])).real for by in (by_K, by_B)]
    b = [(-c.mass * by.sum()).real for by in (by_K, by_B)]
    found = c.deformation(K, B)
    np.testing.assert_allclose(found[:4], [*k, *b], rtol=1e-6, atol=1e-9 * c.rate)
    # Angle between the gradients, in the paper's units.
    T = c.period
    of_k, of_b = np.array([k[0], k[1] * T]), np.array([b[0] / T, b[1]])
    cosine = abs(of_k @ of_b) / np.linalg.norm(of_k) / np.linalg.norm(of_b)
    assert found.crossing_deg == pytest.approx(math.degrees(math.acos(cosine)), abs=1e-4)


def test_nothing_is_deformed_where_samples_are_fast() -> None:
    found = Configuration(0.2, 1e6, delay=0.0, hold="impulse").deformation(2000.0, 5.0)
    assert found == pytest.approx((1.0, 0.0, 0.0, 1.0, 90.0), abs=0.01)
    assert np.isnan(Configuration(0.2, 1000.0, delay=0.0).deformation(3000.0, 120.0)).all()
