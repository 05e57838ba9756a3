"""The hand that holds the mock: `mock.hand`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hapsim

New = Callable[..., Any]
DEVICE = {"clock": "lockstep", "mass": 0.2, "friction": 20.0, "stiffness": 500.0}


def moved(new_scene: New, seconds: float = 0.05, **mock: Any) -> np.ndarray:
    """Positions (samples, 2) of two channels, which no scene moves."""
    scene = new_scene(2, device=DEVICE, mock=mock)
    return np.asarray(hapsim.run(scene, duration=seconds, transport="loopback").position)


def test_a_hand_pushes_each_channel_until_the_spring_balances_it(new_scene: New) -> None:
    x = moved(new_scene, 3.0, hand={"force": [2.0, -1.0]})
    assert x[0].tolist() == [0.0, 0.0]
    assert x[-1] == pytest.approx([2.0 / 500.0, -1.0 / 500.0], abs=1e-9)


def test_a_hand_is_a_spring_and_a_damper_to_where_it_is(new_scene: New) -> None:
    held = moved(new_scene, hand={"stiffness": 400.0, "damping": 2.0, "position": [0.01, -0.005]})
    as_device = moved(new_scene, stiffness=900.0, friction=22.0, hand={"force": [4.0, -2.0]})
    assert np.abs(held).max() > 1e-4
    assert held.tolist() == as_device.tolist()


def test_lists_of_another_length_are_errors_at_their_place(new_scene: New) -> None:
    with pytest.raises(ValueError, match=r"mock\.hand\.force: found 3 numbers, expected 2"):
        new_scene(2, mock={"hand": {"force": [1.0, 2.0, 3.0]}})
