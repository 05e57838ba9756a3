"""The matrices of a closed loop, beside poles, what rests, and a program that reads them."""

from __future__ import annotations

import numpy as np
import pytest

import hapsim
from hapsim.errors import UsageError
from hapsim.prediction.predict import prediction_of

control = pytest.importorskip("control")


@pytest.mark.parametrize("name", ["first_touch", "two_hands", "plucked_string", "disc", "sensed_velocity"])
def test_a_control_program_finds_the_poles_of_the_scene(name: str) -> None:
    prediction = hapsim.predict(name, with_margins=False)
    system = control.ss(*prediction.state_space(), dt=1.0 / prediction.rate)
    assert system.dt == 1.0 / prediction.rate
    poles, of_all = np.array(system.poles()), np.array(prediction.poles)
    assert np.abs(poles[:, None] - of_all[None, :]).min(axis=0).max() < 1e-6
    assert np.abs(poles).max() == pytest.approx(prediction.spectral_radius_here, abs=1e-9)


def test_a_force_of_the_host_moves_the_hand_as_its_spring_and_its_delay_have_it() -> None:
    prediction = hapsim.predict("first_touch", with_margins=False)
    a, b, c, d = prediction.state_space()
    assert c @ np.linalg.solve(np.eye(len(a)) - a, b) + d == pytest.approx(np.array([[1.0 / 2000.0]]), rel=1e-9)
    T, mass = 1e-3, 0.2
    pushed = [(c @ np.linalg.matrix_power(a, n) @ b)[0, 0] for n in range(3)]  # y[n + 1] after 1 N at sample 0
    assert pushed[0] == 0.0  # one sample of delay
    assert pushed[1] == pytest.approx(T**2 / (2.0 * mass), rel=0.01)


def test_a_large_scene_has_no_matrices() -> None:
    scene = hapsim.load_scene("plucked_string")
    name = next(iter(scene.structures))
    large = scene.changed({f"{name}.masses": 800})
    with pytest.raises(UsageError, match="too many for matrices"):
        prediction_of(large).state_space()
