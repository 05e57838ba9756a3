"""Scenes of many points: against a THS derived another way, and by what symmetry says."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.theory import Network
from hapsim.theory.interface import damper_named
from hapsim.theory.network import solve
from tests.networks import network_of

RATE = 1000.0


def scene(**changed: object) -> Network:
    """A hand on a chain of two masses, tied to the ground."""
    links = {"ends": [[0, 1], [1, 2], [2, -1]], "stiffness": [1000.0, 2000.0, 3000.0], "damping": [1.0, 0.5, 0.1]}
    return network_of(**links | {"point_mass": [0.01, 0.02]} | changed)


def unmatched(poles: np.ndarray, expected: np.ndarray, atol: float) -> np.ndarray:
    """Returns the rest of ``poles`` after each expected one has been found among them."""
    left = list(poles)
    for pole in expected:
        nearest = int(np.argmin(np.abs(np.array(left) - pole)))
        assert abs(left.pop(nearest) - pole) < atol * max(1.0, abs(pole))
    return np.array(left)


class TestModes:
    def test_each_pair_is_one_mode_and_the_slowest_comes_first(self) -> None:
        network = scene()
        solution = solve(network)
        modes = solution.modes
        moduli = [abs(mode.pole) for mode in modes]
        assert moduli == sorted(moduli, reverse=True)
        assert moduli[0] == pytest.approx(solution.spectral_radius, rel=1e-12)
        assert all(mode.pole.imag >= 0.0 for mode in modes)
        both = [p for mode in modes for p in {mode.pole, mode.pole.conjugate()}]
        assert np.abs(unmatched(solution.poles, np.array(both), 1e-10)).max(initial=0.0) < 1e-10

    def test_frequency_and_damping_are_those_of_the_pole(self) -> None:
        for mode in solve(scene()).modes:
            s = np.log(mode.pole) * RATE
            assert mode.frequency_hz == pytest.approx(abs(s) / (2.0 * np.pi))
            assert mode.damping_ratio == pytest.approx(-s.real / abs(s))
            assert mode.participation.shape == (3,)
            assert (mode.participation >= 0.0).all()
            assert mode.participation.sum() == pytest.approx(1.0)

    def test_a_hand_that_nothing_holds_rests_wherever_it_is(self) -> None:
        rest, stop = solve(scene(point_mass=[], ends=[], stiffness=[], damping=[])).modes
        assert rest.pole == 1.0
        assert rest.frequency_hz == 0.0
        assert np.isnan(rest.damping_ratio)
        assert stop.pole == pytest.approx(np.exp(-1.0 / 0.2 / RATE))
        assert stop.damping_ratio == 1.0

    def test_a_scene_without_points_has_none(self) -> None:
        empty = scene(channel_mass=[], channel_friction=[], point_mass=[], ends=[], stiffness=[], damping=[])
        solution = solve(empty)
        assert solution.modes == []
        assert solution.poles.size == 0
        assert solution.spectral_radius == 0.0


def test_what_overflows_gives_nan_and_no_warning() -> None:
    absurd = scene(stiffness=[1e308, 1e308, 1e308])
    solution = solve(absurd)
    assert np.isnan(solution.poles).all()
    assert np.isnan(solution.spectral_radius)
    assert solution.modes == []


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"rate": 0.0}, "rate is 0"),
        ({"delay": -1.0}, "delay is -1"),
        ({"hold": "linear"}, "one of: zoh, impulse"),
        ({"sampling": "linear"}, "one of: ideal, average"),
        ({"channel_mass": [0.0]}, r"channel_mass\[0\] is 0"),
        ({"channel_friction": [-1.0]}, r"channel_friction\[0\] is -1"),
        ({"channel_friction": [1.0, 2.0]}, r"channel_friction has shape \(2,\)"),
        ({"point_mass": [0.01, np.nan]}, r"point_mass\[1\] is nan"),
        ({"ends": [[0, 1], [1, 2], [2, 3]]}, "ends names point 3"),
        ({"ends": [[0, 1], [1, 2], [2, -2]]}, "ends names point -2"),
        ({"ends": [0, 1, 2]}, "ends has to be an integer array"),
        ({"ends": [[0.5, 1], [1, 2], [2, -1]]}, "ends has to be an integer array"),
        ({"channel_stiffness": [-1.0]}, r"channel_stiffness\[0\] is -1"),
        ({"channel_stiffness": [1.0, 2.0]}, r"channel_stiffness has shape \(2,\)"),
        ({"damper": [damper_named("backward", None, RATE)]}, "damper has 1 elements, but there are 3"),
        ({"stiffness": [1.0]}, r"stiffness has shape \(1,\), but it has to have shape \(3,\)"),
        ({"damping": [1.0, "much", 2.0]}, "damping has to be an array of numbers"),
    ],
)
def test_a_wrong_argument_is_refused_with_a_sentence(changed: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        scene(**changed)
