"""The hand that holds the mock (`mock.hand`), and a mock whose force has few bits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim import run
from hapsim.device.mock.assemble_mock import describe_mock
from hapsim.scene import Device, DevicePoint, Ground, Initial, Mock, Scene, ViscoElastic

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


MASS, RATE, STEP = 0.2, 1000.0, 10.0 / 2048.0  # 12 bits


def hand(force_quantum: float | None) -> Scene:
    return Scene(
        version=1,
        rate=RATE,
        device=Device(clock="lockstep", mass=MASS, delay=1.0, force_limit=10.0),
        mock=Mock(initial=Initial(velocity=0.1), quantum=1e-12, force_quantum=force_quantum),
        modules={
            "hand": DevicePoint(channel=0),
            "wall": Ground(),
            "touch": ViscoElastic(between=("hand", "wall"), stiffness=500.0, damping=2.0),
        },
    )


def test_the_mass_is_moved_by_whole_steps_of_the_force() -> None:
    trace = run(hand(STEP), duration=0.2)
    asked, given = trace.asked_force[:, 0], np.rint(trace.asked_force[:, 0] / STEP) * STEP
    assert 0.4 * STEP < np.abs(asked - given).max() <= 0.5 * STEP
    # Behind one sample of delay the force of sample n acts from n + 1 to n + 2.
    pushed = 0.5 * (given[:-3] + given[1:-2]) / (MASS * RATE**2)
    moved = np.diff(trace.position[1:, 0], 2)
    np.testing.assert_allclose(moved, pushed, rtol=0.0, atol=5e-12)


def test_it_is_never_finer_than_its_32_bits() -> None:
    assert describe_mock(hand(STEP)).force_scale == (STEP,)
    assert describe_mock(hand(1e-15)).force_scale == describe_mock(hand(None)).force_scale == (10.0 / 2.0**31,)
