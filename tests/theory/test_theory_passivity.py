"""The friction that a sampled wall needs to be passive."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.theory import Configuration

RATE = 1000.0
T = 1.0 / RATE
AROUND = np.array([1.0 - 1e-9, 1.0 + 1e-9])


def wall(friction: float, delay: float, mass: float = 0.2) -> Configuration:
    return Configuration(mass=mass, rate=RATE, friction=friction, delay=delay)


def needed(K: float, B: float, delay: float) -> float:
    """The condition as it is written, on a grid that only a test can afford."""
    w = np.linspace(0.0, np.pi / T, 100_001)[1:]
    z = np.exp(1j * w * T)
    h = K + B * (1.0 - 1.0 / z) / T
    demand = T / (2.0 * (1.0 - np.cos(w * T))) * ((1.0 - 1.0 / z) * h * np.exp(-1j * w * T * delay)).real
    return float(demand[w * T > 1e-3].max())


def test_without_delay_it_is_colgates_and_schenkels() -> None:
    K = np.array([0.0, 10.0, 1000.0])[:, None]
    B = np.array([-3.0, -0.1, 0.0, 0.1, 3.0])
    for i, j in np.ndindex(3, 5):
        enough = 0.5 * K[i, 0] * T + abs(B[j])
        assert wall(enough * AROUND[1] + 1e-12, 0.0).is_passive(K, B)[i, j]
        assert not wall(enough * AROUND[0], 0.0).is_passive(K, B)[i, j]


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.0, 7.0])
def test_a_spring_alone_needs_its_stiffness_times_the_delay_and_half_a_sample(delay: float) -> None:
    K = 1500.0
    limit = K * T * (0.5 + delay)
    assert [bool(wall(limit * near, delay).is_passive(K, 0.0)) for near in AROUND] == [False, True]
    np.testing.assert_array_equal(wall(limit, delay).is_passive(K * AROUND, 0.0), [True, False])


@pytest.mark.parametrize("delay", [1.0, 2.0, 4.0])
def test_it_is_the_condition_as_written_wherever_its_upper_bound_lies(delay: float) -> None:
    rng = np.random.default_rng(11)
    for _ in range(12):
        K, B = 10.0 ** rng.uniform(1.0, 4.0), rng.uniform(-6.0, 6.0)
        limit = needed(K, B, delay)
        assert not wall(limit * (1.0 - 1e-6), delay).is_passive(K, B)
        assert wall(limit * (1.0 + 2e-5), delay).is_passive(K, B)  # the grid misses a little at w = 0


class TestAFractionOfASample:
    """The images of a motion are each late by a phase of their own: more than the fundamental alone tells."""

    K, DELAY, SAMPLES, IMAGES = 1000.0, 0.5, 128, 60

    def given_away(self, friction: float) -> float:
        """Energy that wall and friction give a hand, over one period of a motion that it may choose, in units of K."""
        theta = 2.0 * np.pi / self.SAMPLES
        w = (theta + 2.0 * np.pi * np.arange(-self.IMAGES, self.IMAGES + 1)) / T
        # The motion that gains most: an eigenvector of the form that the images' power is.
        late = np.outer(np.exp(1j * w * self.DELAY * T) / w, 1.0 / w)
        form = self.K * (1.0 - np.exp(-1j * theta)) / T * late.conj()
        velocity = np.linalg.eigh(form + form.conj().T)[1][:, -1]

        def position(t: np.ndarray) -> np.ndarray:
            return ((velocity / (1j * w)) @ np.exp(1j * np.outer(w, t))).real

        samples = np.arange(self.SAMPLES) * T
        push = self.K * position(samples)  # acts from half a sample later on, for a sample
        starts = samples + self.DELAY * T
        to_the_wall = float(push @ (position(starts + T) - position(starts)))
        # Friction: the mean of the squared velocity, image by image.
        to_friction = friction * 0.5 * self.SAMPLES * T * float((np.abs(velocity) ** 2).sum())
        return -(to_the_wall + to_friction)

    def test_a_hand_can_draw_energy_where_the_stiffness_times_the_delay_would_be_friction_enough(self) -> None:
        rule = self.K * T * (self.DELAY + 0.5)
        assert self.given_away(1.03 * rule) > 0.0
        assert not wall(1.03 * rule, self.DELAY).is_passive(self.K, 0.0)

    def test_with_the_friction_that_is_stated_to_be_needed_it_cannot(self) -> None:
        needed = wall(0.0, self.DELAY).needed_friction(self.K, 0.0)
        assert needed == pytest.approx(0.5 * (1.0 + np.sqrt(1.25)) * self.K * T, rel=1e-9)
        assert self.given_away(1.0001 * needed) < 0.0
        assert self.given_away(0.99 * needed) > 0.0

    def test_it_goes_over_into_the_whole_delays_at_either_end(self) -> None:
        K, B = np.array([10.0, 1000.0]), np.array([0.5, -0.2])
        for delay in (1.0, 2.0):
            exact = wall(0.0, delay).needed_friction(K, B)
            for near in (delay - 1e-9, delay + 1e-9):
                np.testing.assert_allclose(wall(0.0, near).needed_friction(K, B), exact, rtol=1e-3)


@pytest.mark.parametrize(("damper", "cutoff"), [("centred", None), ("filtered", 60.0)])
def test_another_damper_has_its_own_demand(damper: str, cutoff: float | None) -> None:
    c = Configuration(mass=0.2, rate=RATE, delay=1.0, damper=damper, cutoff=cutoff)
    w = np.linspace(0.0, np.pi / T, 100_001)[1:]
    z = np.exp(1j * w * T)
    moving = (1.0 - z**-2) / (2.0 * T)
    if damper == "filtered":
        kept = np.exp(-2.0 * np.pi * 60.0 * T)
        moving = (1.0 - kept) * (1.0 - 1.0 / z) / T / (1.0 - kept / z)
    for K, B in ((1000.0, 2.0), (10.0, 3.0), (3000.0, 0.5)):
        demand = T / (2.0 * (1.0 - np.cos(w * T))) * ((1.0 - 1.0 / z) * (K + B * moving) / z).real
        assert c.needed_friction(K, B) == pytest.approx(demand[w * T > 1e-3].max(), rel=2e-5)


def test_a_sensed_velocity_has_no_such_condition() -> None:
    with pytest.raises(ValueError, match="the sensed damper"):
        Configuration(mass=0.2, rate=RATE, damper="sensed").is_passive(1.0, 1.0)


def test_between_the_ends_of_the_range_it_is_accurate() -> None:
    """One sample of delay: K T/2 (1 + 2 cos) - B cos 2, a parabola in cos with a summit in closed form."""
    K, B = 2000.0, 2.0
    summit = 0.5 * K * T + B + (K * T) ** 2 / (8.0 * B)
    assert [bool(wall(summit * near, 1.0).is_passive(K, B)) for near in AROUND] == [False, True]


def test_a_spring_that_pushes_away_is_never_passive_and_nothing_simulated_needs_just_some_friction() -> None:
    assert not wall(100.0, 0.0).is_passive(-1.0, 0.0)
    for delay in (0.0, 0.5, 1.0):
        assert wall(1e-9, delay).is_passive(0.0, 0.0)
        assert not wall(0.0, delay).is_passive(0.0, 0.0)


def test_what_is_not_finite_is_not_passive() -> None:
    for delay in (0.0, 1.0):
        found = wall(1.0, delay).is_passive([np.nan, np.inf, 1.0, 1.0], [0.0, 0.0, np.nan, 0.0])
        assert found.tolist() == [False, False, False, True]


@pytest.mark.parametrize(("hold", "sampling"), [("impulse", "ideal"), ("zoh", "average")])
def test_where_it_is_not_derived_it_reports_that(hold: str, sampling: str) -> None:
    c = Configuration(mass=0.2, rate=RATE, hold=hold, sampling=sampling)
    with pytest.raises(ValueError, match=f"not for hold '{hold}' with sampling '{sampling}'"):
        c.is_passive(1.0, 1.0)
