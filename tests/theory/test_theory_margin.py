"""Margins to instability: against bisection on the formula of one hand, and on the poles of many scenes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hapsim.theory import Network
from hapsim.theory.interface import damper_named
from hapsim.theory.network import margins, margins_of, solve
from hapsim.theory.network.modes import snap_to_rest
from tests.transitions import transition

RATE = 1000.0
LIMIT = 1.0 + 1e-9
DAMPERS = [("backward", None), ("centred", None), ("filtered", 80.0), ("sensed", None)]


def bisected(stable: Callable[[float], bool]) -> float:
    """The factor between stable and not, found by steps from 1 on and then halving."""
    as_it_is = stable(1.0)
    step, factor = (1.05, 1.0) if as_it_is else (1.0 / 1.05, 1.0)
    while stable(factor * step) == as_it_is:
        factor *= step
        if not 1e-4 < factor < 1e4:
            return math.inf if as_it_is else 0.0
    near, far = factor, factor * step
    while abs(near / far - 1.0) > 1e-6:
        middle = math.sqrt(near * far)
        near, far = (middle, far) if stable(middle) == as_it_is else (near, middle)
    return near


def agree(found: float, expected: float, rtol: float) -> bool:
    """Equal, or both as good as never, or as nothing."""
    if not 1e-4 < expected < 1e4:
        return found > 1e4 if expected > 1.0 else found < 1e-4
    return abs(found / expected - 1.0) < rtol


def random_scene(seed: int) -> Network:
    rng = np.random.default_rng(seed)
    channels, masses = rng.integers(1, 3), rng.integers(0, 5)
    links = rng.integers(1, channels + masses + 3)
    return Network(
        rate=RATE,
        channel_mass=rng.uniform(0.1, 1.0, channels),
        channel_friction=rng.choice([0.0, 1.0, 5.0], channels),
        delay=float(rng.choice([0.0, 0.3, 1.0, 2.5])),
        hold=str(rng.choice(["zoh", "impulse"])),
        sampling=str(rng.choice(["ideal", "average"])),
        point_mass=rng.uniform(0.01, 0.1, masses),
        ends=rng.integers(-1, channels + masses, (links, 2)),
        stiffness=10.0 ** rng.uniform(1.0, 4.0, links),
        damping=10.0 ** rng.uniform(-1.0, 1.0, links),
        channel_stiffness=rng.choice([0.0, 0.0, 500.0], channels),
        damper=[damper_named(*DAMPERS[i], RATE) for i in rng.integers(0, 4, links)],
    )


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("seed", range(4))
def test_random_scenes_have_the_margins_of_their_poles(seed: int) -> None:
    scene = random_scene(seed)
    for link, margin in enumerate(margins_of(scene).links):
        for name, found in (("stiffness", margin.stiffness_factor), ("damping", margin.damping_factor)):

            def stable(factor: float, link: int = link, name: str = name) -> bool:
                return is_stable_with(scene, link, name, factor)

            expected = bisected(stable)
            assert agree(found, expected, 1e-5), (link, name, found, expected)


def unstable_scenes() -> list[int]:
    return [seed for seed in range(24) if solve(random_scene(seed)).spectral_radius > LIMIT]


@pytest.mark.parametrize("seed", unstable_scenes())
def test_an_unstable_scene_becomes_stable_in_the_ranges_of_its_poles(seed: int) -> None:
    """The scene is stable in all of each range, and unstable just outside it and up to 1."""
    scene = random_scene(seed)
    for link, of_link in enumerate(margins_of(scene).stabilizing):
        for name, ranges in zip(("stiffness", "damping"), of_link, strict=True):
            assert ranges is not None
            below = next((one for one in ranges if one[1] <= 1.0), (0.0, 1e-3))
            above = next((one for one in ranges if one[0] >= 1.0), (1e3, math.inf))
            outside = [*np.geomspace(below[1], 1.0, 9)[1:-1], *np.geomspace(1.0, above[0], 9)[1:-1]]
            outside += [least * 0.999 for least, _ in ranges if least > 1e-3]
            outside += [most * 1.001 for _, most in ranges if most < math.inf]
            within = [
                factor
                for least, most in ranges
                for factor in np.geomspace(least or most * 1e-3, most if most < math.inf else least * 1e3, 7)[1:-1]
            ]
            for stable, factors in ((False, outside), (True, within)):
                for factor in factors:
                    assert is_stable_with(scene, link, name, factor) == stable, (link, name, ranges, factor)


def is_stable_with(scene: Network, link: int, name: str, factor: float) -> bool:
    value = getattr(scene, name).copy()
    value[link] *= factor
    changed = replace(scene, **{name: value})
    poles = np.linalg.eigvals(transition(changed)).astype(complex)
    return bool(np.abs(snap_to_rest(changed, poles)).max() <= LIMIT)


def test_a_stable_scene_has_no_range_that_makes_it_stable() -> None:
    assert margins_of(chain(3, 0.1, 1)).stabilizing == []


def test_a_scheme_of_its_own_has_the_ranges_that_are_found_by_the_poles() -> None:
    """One mass on one link under the midpoint rule is stable with any stiffness; with a hand it is not."""
    centred = Network(RATE, [0.2], [1.0], 1.0, "zoh", "ideal", [0.01], [[0, 1], [1, -1]], [9e3, 9e3], [1.0, 1.0])
    (of_hand, _) = margins_of(replace(centred, scheme="midpoint")).stabilizing
    for name, ranges in zip(("stiffness", "damping"), of_hand, strict=True):
        assert ranges or name == "damping"
        for least, most in ranges:
            scheme = replace(centred, scheme="midpoint")
            ends = [(most * 0.999, True), (most * 1.001, False)] * math.isfinite(most)
            ends += [(least * 1.001, True), (least * 0.999, False)] * (least > 0.0)
            for factor, stable in ends:
                assert is_stable_with(scheme, 0, name, factor) == stable, (name, ranges, factor)


def chain(masses: int, B: float, held: int) -> Network:
    """A string between two grounds, a hand tied to one of its masses; the hand's link is the last."""
    ends = [[-1, 1], *([i, i + 1] for i in range(1, masses)), [masses, -1], [0, held]]
    stiffness, damping = np.append(np.full(masses + 1, 1000.0), 500.0), np.append(np.full(masses + 1, B), 1.0)
    return Network(RATE, [0.2], [1.0], 1.0, "zoh", "ideal", np.full(masses, 0.01), ends, stiffness, damping)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(("B", "masses"), [(0.1, 30), (0.0, 40)])
def test_a_strings_many_narrow_resonances_are_not_stepped_over(B: float, masses: int) -> None:
    """Just below every margin of the hand's link and of some others the poles are inside, just above they are not."""
    scene = chain(masses, B, masses // 3)
    margins = margins_of(scene).links
    for link in (0, masses // 3 - 1, masses, masses + 1):
        for name, factor in zip(("stiffness", "damping"), margins[link], strict=True):
            for beside, stable in ((0.1 * factor + 0.9, True), (factor - 1e-3, True), (factor * 1.01, False)):
                if math.isfinite(factor):
                    assert is_stable_with(scene, link, name, beside) == stable, (link, name, factor)


def test_what_cannot_become_unstable_has_no_margin() -> None:
    scene = chain(3, 0.1, 1)
    idle = replace(
        scene,
        ends=np.vstack([scene.ends, [[2, 2], [-1, -1]]]),
        stiffness=np.append(scene.stiffness, [9.0, 9.0]),
        damping=np.append(scene.damping, [9.0, 9.0]),
        damper=(),
    )
    assert margins_of(idle).links[-2:] == [(math.inf, math.inf)] * 2
    np.testing.assert_allclose(margins_of(idle).links[:-2], margins_of(scene).links, rtol=1e-9)
    assert margins_of(Network(RATE, [], [], 0.0, "zoh", "ideal", [], [], [], [])).links == []


def test_where_something_else_is_unstable_no_factor_of_a_link_helps() -> None:
    unit = 0.01 * RATE**2
    scene = Network(
        RATE, [], [], 0.0, "zoh", "ideal", [0.01, 0.01], [[0, -1], [1, -1]], [5.0 * unit, 0.1 * unit], [1.0, 1.0]
    )
    wild, tame = margins_of(scene).links
    # z² - (2 - kappa - beta) z + 1 - beta is zero at -1 where kappa = 4 - 2 beta
    assert wild.stiffness_factor == pytest.approx((4.0 - 2.0 * 0.1) / 5.0, rel=1e-9)
    assert wild.damping_factor == 0.0
    assert tame == (0.0, 0.0)


def test_what_drifts_is_at_the_limit_and_its_margin_is_that_of_the_rest() -> None:
    """Two equal masses on one link: their distance moves like one of half the mass on a spring to the ground."""
    free = Network(RATE, [], [], 0.0, "zoh", "ideal", [0.02, 0.02], [[0, 1]], [300.0], [2.0])
    tied = Network(RATE, [], [], 0.0, "zoh", "ideal", [0.01], [[0, -1]], [300.0], [2.0])
    assert solve(free).spectral_radius == 1.0
    np.testing.assert_allclose(margins_of(free).links, margins_of(tied).links, rtol=1e-9)
    np.testing.assert_allclose(margins_of(tied).links, [((4.0 - 2.0 * 0.2) / 0.03, (4.0 - 0.03) / 0.4)], rtol=1e-9)


def test_crossings_and_samples_of_the_circle_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    """The two ways to the margins of CORDIS's scheme, of links with every damper; and what costs too much is NaN."""
    for held in (7, 20):
        damper = [damper_named(*DAMPERS[i % 4], RATE) for i in range(32)]
        scene = replace(chain(30, 0.1, held), damper=damper, margin_links=None)
        by_crossings = margins_of(scene)
        monkeypatch.setattr(margins, "MOST_STATES", 0)
        along_circle = margins_of(scene)
        monkeypatch.setattr(margins, "MOST_STATES", 300)
        np.testing.assert_allclose(along_circle.links[-1], by_crossings.links[-1], rtol=1e-7)
        assert np.isnan(along_circle.links[:-1]).all()
        assert "touch a hand; the circle was sampled" in along_circle.method
        assert by_crossings.method == ""
    monkeypatch.setattr(margins, "WORK", 0.0)
    found = margins_of(scene)
    assert "1 of 32 links" in found.method
    np.testing.assert_array_equal(np.isnan(found.links)[:, 0], [True] * 31 + [False])


def test_what_overflows_has_margins_that_are_not_known() -> None:
    absurd = Network(RATE, [0.2], [0.0], 1.0, "zoh", "ideal", [], [[0, -1], [0, -1]], [1e308, 1e308], [0.0, 0.0])
    assert np.isnan(margins_of(absurd).links).all()
    assert margins_of(absurd).method != ""
