"""A mock whose force has few bits: what is asked for arrives in whole steps, and those are what moves the mass."""

from __future__ import annotations

import numpy as np

from hapsim import run
from hapsim.device.mock.assemble import describe_mock
from hapsim.scene import Device, DevicePoint, Ground, Initial, Mock, Scene, ViscoElastic

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
