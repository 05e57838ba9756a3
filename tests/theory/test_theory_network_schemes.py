"""Large scenes under every scheme: what is sparse there is the whole transition of a small scene, in other words."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hapsim.theory import Network, NotWorkedOutError, margins_of, sample, solve
from hapsim.theory.interface import damper_named
from hapsim.theory.network import is_large, large_modes
from hapsim.theory.network.large_loop import sparse_transition
from hapsim.theory.schemes import SCHEMES, Scheme, between_samples, in_a_matrix
from tests.transitions import apart, transition

RATE = 1000.0


def heun(rates: Any, z: Any, held: Any) -> Any:
    rate = rates @ z + held
    return rate + rates @ rate / 2.0


#: Schemes that hapsim does not ship, of what a scheme can say of itself.
OTHERS = {"implicit Euler": Scheme(1.0, in_a_matrix), "Heun": Scheme(heun, between_samples)}


@pytest.fixture(autouse=True)
def _others_too(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, scheme in OTHERS.items():
        monkeypatch.setitem(SCHEMES, name, scheme)


def string(scheme: str, masses: int, sampling: str = "ideal", damping: float = 0.02, friction: float = 0.01) -> Network:
    """A string between two grounds, a hand on it by links of every damper, a buffer on it, and a mass that is free."""
    row = [-1, *range(1, 1 + masses), -1]
    pairs = [*pairwise(row), *((i, -1) for i in range(1, 1 + masses))]
    stiffness = [100.0] * (masses + 1) + [0.0] * masses
    dampings = [damping] * (masses + 1) + [friction] * masses
    kinds: list[tuple[str, float | None]] = [("backward", None)] * len(pairs)
    others = [("backward", None), ("centred", None), ("filtered", 90.0), ("sensed", None), ("backward", None)]
    ends = [(0, 3), (0, 5), (7, 0), (0, 9), (4, -1)]
    return Network(
        RATE,
        [0.2],
        [1.0],
        1.37,
        "zoh",
        sampling,
        np.full(masses + 1, 0.001),
        np.array(pairs + ends),
        [*stiffness, 60.0, 20.0, 10.0, 15.0, 40.0],
        [*dampings, 0.01, 0.02, 0.01, 0.02, 0.01],
        damper=tuple(damper_named(name, cutoff, RATE) for name, cutoff in kinds + others),
        scheme=scheme,
        outside=(False,) * (len(pairs) + 4) + (True,),
    )


@pytest.mark.parametrize("sampling", ["ideal", "average"])
@pytest.mark.parametrize("scheme", SCHEMES | OTHERS)
def test_an_operator_is_the_transition(scheme: str, sampling: str) -> None:
    network = string(scheme, 12, sampling)
    operator, expected = sparse_transition(network), transition(network)
    found = operator @ np.eye(operator.size)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-14 * np.abs(expected).max())
    # The free mass has a double pole, which rounding moves by its root.
    poles = [matrix[np.abs(matrix - 1.0) > 1e-6] for matrix in map(np.linalg.eigvals, (found, expected))]
    assert apart(*poles) < 1e-11
    shift = 0.9 + 0.3j
    inverse = operator.inverse(shift)
    assert inverse is not None
    motion = np.random.default_rng(3).standard_normal(operator.size) + 0j
    back = operator @ inverse(motion) - shift * inverse(motion)
    assert np.abs(back - motion).max() < 1e-9


@pytest.mark.parametrize("scheme", [name for name, model in (SCHEMES | OTHERS).items() if model])
def test_so_it_is_where_steps_have_a_unit_of_their_own(scheme: str) -> None:
    """Springs that turn a mass by more than a radian in a sample."""
    soft = string(scheme, 12)
    network = Network(**{**vars(soft), "stiffness": 100.0 * soft.stiffness})
    operator, expected = sparse_transition(network), transition(network)
    found = operator @ np.eye(operator.size)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_large_scene_has_the_poles_of_its_whole_transition(scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sample, "LARGE", 220)
    monkeypatch.setattr(large_modes, "MOST_STEPS", 10_000)
    network = string(scheme, 115)
    assert is_large(network)
    solution = solve(network)
    every, motions = np.linalg.eig(transition(network))
    moving = solution.poles[np.abs(solution.poles - 1.0) > 1e-6]
    assert moving.size > 40
    assert np.abs(moving[:, None] - every).min(axis=1).max() < 1e-8
    resting = [mode for mode in solution.modes if mode.pole == 1.0]
    assert [mode.participation.argmax() for mode in resting] == [116, 116]  # the free mass
    hands = next(mode for mode in solution.modes if mode.participation[0] > 0.5)
    motion = motions[:117, np.argmin(np.abs(every - hands.pole))]
    energy = np.concatenate([network.channel_mass, network.point_mass]) * np.abs(motion) ** 2
    np.testing.assert_allclose(hands.participation, energy / energy.sum(), rtol=0.0, atol=1e-6)


def test_what_is_too_fast_for_a_sparse_matrix_is_not_worked_out() -> None:
    network = string("exact", 520)
    with pytest.raises(NotWorkedOutError, match="too fast for the rate"):
        solve(Network(**{**vars(network), "stiffness": 1e12 * network.stiffness}))


@pytest.mark.parametrize("scheme", [name for name, model in SCHEMES.items() if model])
def test_margins_that_take_too_long_are_reported_as_missing(scheme: str) -> None:
    every = margins_of(string(scheme, 520), np.zeros(1))
    assert "none was worked out" in every.method
    assert all(np.isnan(margin.stiffness_factor) for margin in every.links)


@pytest.mark.parametrize("scheme", [name for name, model in SCHEMES.items() if model])
def test_what_a_network_is_given_is_checked(scheme: str) -> None:
    known = vars(string(scheme, 3 + 9))
    with pytest.raises(ValueError, match="scheme"):
        Network(**{**known, "scheme": "euler"})
    with pytest.raises(ValueError, match="outside has 1 elements"):
        Network(**{**known, "outside": (True,)})


def stiff_chain(stiffness: float, masses: int, damping: float = 0.0) -> Network:
    """A wall, masses on very stiff springs, and a hand on the last by a soft link, under midpoint."""
    ends = [(1, -1), *((i + 1, i) for i in range(1, masses)), (0, masses)]
    springs, dampers = [stiffness] * masses + [100.0], [damping] * masses + [1.0]
    return Network(
        RATE, [0.2], [1.0], 1.0, "zoh", "ideal", np.full(masses, 0.1), np.array(ends), springs, dampers,
        scheme="midpoint",
    )  # fmt: skip


@pytest.mark.parametrize("masses", [1, 3, 12, 40])
@pytest.mark.parametrize("stiffness", 10.0 ** np.arange(16, 31, 2))
def test_rounding_of_the_double_pole_of_very_stiff_springs_is_no_growth(masses: int, stiffness: float) -> None:
    """All of it decays, by less than a digit: under midpoint its poles are -1 to rounding."""
    for damping in (0.0, 1.0):
        solution = solve(stiff_chain(stiffness, masses, damping))
        assert abs(solution.spectral_radius - 1.0) < 1e-12


@pytest.mark.parametrize(("stiffness", "damping"), [(1e12, -1e3), (1e14, -1e3), (1e16, -1e4)])
def test_next_to_a_double_pole_what_grows_is_still_seen(stiffness: float, damping: float) -> None:
    """A damper that feeds: |z|² of z = (1 + s/2)/(1 - s/2) with s² + b s + k = 0."""
    k, b = stiffness / (0.1 * RATE**2), damping / (0.1 * RATE)
    growth = ((1.0 - b / 4.0) ** 2 + (k - b * b / 4.0) / 4.0) / ((1.0 + b / 4.0) ** 2 + (k - b * b / 4.0) / 4.0)
    found = solve(stiff_chain(stiffness, 1, damping)).spectral_radius
    assert found - 1.0 == pytest.approx(np.sqrt(growth) - 1.0, rel=0.01)
    assert found > 1.0 + 1e-9
