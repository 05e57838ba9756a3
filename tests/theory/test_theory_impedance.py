"""Driving-point impedances of whole scenes: beside a hand's own, beside the closed loop's state, and by hand."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hapsim.dampers import DAMPERS, DamperModel
from hapsim.holds import HOLDS
from hapsim.theory import Configuration, Network
from hapsim.theory.hand.configuration import stiffest_passive, stiffest_stable
from hapsim.theory.interface import SAMPLINGS, damper_named, delay_and_hold
from hapsim.theory.network.impedance import desired_impedance, loop_impedance
from hapsim.theory.sample import loop
from hapsim.theory.schemes import SCHEMES
from tests.device_answer import rendered_stiffness
from tests.networks import network_of

RATE = 1000.0
F = np.geomspace(1.0, 480.0, 25)
S = 2j * np.pi * F


def two_hands(**changed: object) -> Network:
    """Two device channels, and between them two masses, tied to the ground."""
    own = {"channel_mass": [0.2, 0.3], "channel_friction": [1.0, 0.2], "channel_stiffness": [100.0, 0.0], "delay": 1.3}
    links = {"ends": [[0, 2], [2, 3], [3, 1], [1, -1], [0, 0]], "point_mass": [0.01, 0.02]}
    links |= {"stiffness": [1000.0, 2000.0, 500.0, 100.0, 7.0], "damping": [1.0, 0.5, 0.1, 0.3, 7.0]}
    return network_of(**own | links | changed)


@pytest.mark.parametrize("damper", [name for name in DAMPERS if name != "sensed"])
def test_a_lone_hand_has_the_rendered_impedance_of_its_configuration(damper: str) -> None:
    cutoff = 60.0 if damper == "filtered" else None
    for hold, sampling, delay in itertools.product(HOLDS, SAMPLINGS, (0.0, 0.37, 1.0, 2.5)):
        c = Configuration(0.2, RATE, 1.0, delay, hold, sampling, stiffness=100.0, damper=damper, cutoff=cutoff)
        one = [damper_named(damper, cutoff, RATE)]
        network = Network(RATE, [0.2], [1.0], delay, hold, sampling, [], [[0, -1]], [2000.0], [5.0], [100.0], one)
        rendered = loop_impedance(network, F).rendered[:, 0, 0]
        np.testing.assert_allclose(rendered, c.impedance(2000.0, 5.0, F) - 1.0 - 100.0 / S, rtol=1e-12)


@pytest.mark.thorough(keep=8)
@pytest.mark.parametrize(("hold", "sampling"), list(itertools.product(HOLDS, SAMPLINGS)))
@pytest.mark.parametrize("damper", DAMPERS)
def test_the_closed_loop_is_what_the_transition_makes_of_an_added_force(damper: str, hold: str, sampling: str) -> None:
    """The masses eliminated at each frequency, and the state moved from sample to sample: two ways to one matrix."""
    own = [damper_named(damper, 60.0 if damper == "filtered" else None, RATE)] * 5
    network = two_hands(damper=own, hold=hold, sampling=sampling)
    theta = 2.0 * np.pi * F / RATE
    stiffness = np.array([rendered_stiffness(network, z) for z in np.exp(1j * theta)])
    expected = stiffness * (delay_and_hold(theta, 1.3, hold, sampling) / S)[:, None, None]
    np.testing.assert_allclose(loop_impedance(network, F).rendered, expected, rtol=1e-10)
    sparse = chain(30, own[0], hold, sampling)
    expected = np.array([rendered_stiffness(sparse, z) for z in np.exp(1j * theta)])[:, 0, 0]
    through = delay_and_hold(theta, 1.3, hold, sampling) / S
    np.testing.assert_allclose(loop_impedance(sparse, F).rendered[:, 0, 0], expected * through, rtol=1e-10)


def chain(masses: int, damper: DamperModel, hold: str, sampling: str) -> Network:
    """A hand at one end, a ground at the other."""
    ends = [[i, i + 1] for i in range(masses)] + [[masses, -1]]
    values = np.full(masses + 1, 900.0), np.full(masses + 1, 0.3)
    own = [damper] * (masses + 1)
    return Network(RATE, [0.2], [1.0], 1.3, hold, sampling, np.full(masses, 0.01), ends, *values, [50.0], own)


def test_a_force_that_is_added_enters_the_state_as_a_link_s_does() -> None:
    """A spring's column of the change, out of the one of the force that it is."""
    for hold, sampling in itertools.product(HOLDS, SAMPLINGS):
        free = two_hands(stiffness=[0.0] * 5, damping=[0.0] * 5, hold=hold, sampling=sampling)
        tied = two_hands(stiffness=[0.0, 0.0, 0.0, 40.0, 0.0], damping=[0.0] * 5, hold=hold, sampling=sampling)
        of_spring = loop(tied).change - loop(free).change
        np.testing.assert_allclose(of_spring[:, 1], -40.0 * loop(free, inputs=True).push[:, 1], atol=1e-18)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_far_below_the_rate_every_scheme_renders_what_is_desired(scheme: str) -> None:
    slow = np.array([0.1, 0.3])
    network = two_hands(scheme=scheme)
    np.testing.assert_allclose(loop_impedance(network, slow).rendered, desired_impedance(network, slow), rtol=1e-2)


def test_desired_is_the_scene_in_continuous_time() -> None:
    """A mass on a spring and a damper to the ground, held by another spring and damper; the device is not in it."""
    network = Network(RATE, [0.2], [1.0], 1.0, "zoh", "ideal", [0.05], [[0, 1], [1, -1]], [800.0, 300.0], [2.0, 0.5])
    near, beyond = 800.0 + 2.0 * S, 300.0 + 0.5 * S + 0.05 * S**2
    np.testing.assert_allclose(desired_impedance(network, F)[:, 0, 0], near * beyond / (near + beyond) / S, rtol=1e-12)


def test_from_the_nyquist_frequency_on_nothing_is_reported() -> None:
    closed = loop_impedance(two_hands(), [0.0, 100.0, 500.0]).closed_loop
    assert np.isnan(closed).all(axis=(1, 2)).tolist() == [True, False, True]


class TestStiffestWalls:
    def test_without_delay_the_passive_one_has_twice_the_friction_over_the_period(self) -> None:
        wall = stiffest_passive(Configuration(mass=0.2, rate=RATE, friction=1.5, delay=0.0))
        assert wall == pytest.approx((2.0 * 1.5 * RATE, 0.0), rel=1e-6, abs=1e-6)

    def test_behind_a_hold_the_stable_one_is_the_closed_form(self) -> None:
        """K T²/m = 12 - 8 sqrt(2) at B T/m = 2 (sqrt(2) - 1): no delay, no friction."""
        wall = stiffest_stable(Configuration(mass=0.2, rate=RATE, friction=0.0, delay=0.0))
        assert wall.stiffness == pytest.approx((12.0 - 8.0 * np.sqrt(2.0)) * 0.2 * RATE**2, rel=1e-9)
        assert wall.damping == pytest.approx(2.0 * (np.sqrt(2.0) - 1.0) * 0.2 * RATE, rel=1e-4)

    @pytest.mark.parametrize("delay", [0.5, 1.0, 2.0])
    def test_a_stiffer_one_is_neither_passive_nor_stable_whatever_its_damper(self, delay: float) -> None:
        c = Configuration(mass=0.2, rate=RATE, friction=1.0, delay=delay)
        passive, stable = stiffest_passive(c), stiffest_stable(c)
        assert c.is_passive(0.9999 * passive.stiffness, passive.damping)
        assert not c.is_passive(1.0001 * passive.stiffness, np.linspace(0.0, 5.0, 500)).any()
        assert c.is_stable(0.9999 * stable.stiffness, stable.damping)
        assert not c.is_stable(1.0001 * stable.stiffness, np.linspace(0.0, 400.0, 500)).any()

    def test_without_friction_no_spring_is_passive_and_with_impulses_it_is_not_derived(self) -> None:
        assert stiffest_passive(Configuration(mass=0.2, rate=RATE, friction=0.0)) == (0.0, 0.0)
        with pytest.raises(ValueError, match="passivity condition is derived for"):
            stiffest_passive(Configuration(mass=0.2, rate=RATE, friction=1.0, hold="impulse"))


@pytest.mark.filterwarnings("error")
def test_a_state_that_grows_beyond_all_digits_has_no_impedance() -> None:
    network = two_hands(substeps=20, stiffness=[1e9, 2000.0, 500.0, 100.0, 7.0], point_mass=[0.0008, 0.02])
    assert np.isnan(loop_impedance(network, F).rendered).all()
    assert np.isfinite(loop_impedance(two_hands(substeps=20), F)).all()
