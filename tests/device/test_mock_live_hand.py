"""The hand that holds the mock, moved while it runs: its ramp sample by sample, and the mock in the new hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.device.mock.stand_ins import LiveHand
from hapsim.scene import Hand, Scene

New = Callable[..., Any]
DEVICE = {"clock": "lockstep", "mass": [0.2, 0.3], "friction": 20.0, "stiffness": 500.0}
GLIDING = DEVICE | {"stiffness": 0.0}
HELD = {"stiffness": 400.0, "damping": [2.0, 3.0], "position": [0.01, -0.005]}
PUSHED = {"force": [1.0, -2.0], "damping": 1.5}
N = 20  # samples of a ramp


def with_hand(scene: Scene, **fields: Any) -> Scene:
    assert scene.mock is not None
    return scene.model_copy(update={"mock": scene.mock.model_copy(update={"hand": Hand.model_validate(fields)})})


def forces(n: int) -> list[int]:
    return [(n % 7 - 3) * 2**27, (n % 5 - 2) * 2**27]


def of_bodies(bodies: Any) -> np.ndarray:
    return np.array([bodies["friction"], bodies["stiffness"], bodies["push"]])


@pytest.mark.parametrize(
    ("device", "first", "then"),
    [(DEVICE, {}, HELD), (DEVICE, HELD, PUSHED), (GLIDING, {}, HELD), (GLIDING, {}, PUSHED), (GLIDING, HELD, PUSHED)],
)
def test_after_a_straight_ramp_the_mock_is_one_in_the_new_hand(
    new_scene: New, new_host: New, device: Any, first: Any, then: Any
) -> None:
    scene = new_scene(2, device=device, mock={"hand": first})
    host = new_host(2, device=device, mock={"hand": first})
    built = new_host(2, device=device, mock={"hand": then})
    host.arm()
    built.arm()
    moving = LiveHand(host.mock, scene)
    begun, wanted = of_bodies(host.bodies), of_bodies(built.bodies)
    moving.retarget(with_hand(scene, **then), N)
    for n in range(N):
        host.force(n, forces(n))
        built.force(n, forces(n))
        led = begun + (n + 1) / N * (wanted - begun)
        assert np.allclose(of_bodies(host.bodies), led, rtol=1e-14, atol=0.0)
    assert np.array_equal(of_bodies(host.bodies), wanted)
    built.bodies[:] = host.bodies  # from here on they are one
    assert np.abs(host.bodies["position"]).min() > 1e-6
    for n in range(N, 3 * N):
        assert host.force(n, forces(n)) == built.force(n, forces(n))
    assert host.bodies.tobytes() == built.bodies.tobytes()


def test_each_change_goes_on_from_where_the_hand_is_and_takes_four_ms_at_least(new_scene: New, new_host: New) -> None:
    scene, host = new_scene(2, device=DEVICE), new_host(2, device=DEVICE)
    host.arm()
    moving, seen = LiveHand(host.mock, scene), []
    for step in range(1, 15):  # twice 4 ms apart, then 2 ms apart
        moving.retarget(with_hand(scene, stiffness=100.0, position=0.001 * step), 1)
        for _ in range(4 if step < 3 else 2):
            host.force(int(host.mock.board.n))
            seen.append(float(host.bodies["push"][0]))
    assert np.allclose(seen[:8], np.arange(1, 9) * 0.025, rtol=1e-14)
    steps = np.diff(seen[8:])
    assert steps.min() > 0.0
    assert steps[-4:] == pytest.approx([0.05] * 4, rel=0.001)  # the speed of what it follows, without a ripple


def test_a_device_that_is_armed_anew_stays_in_the_hand(new_scene: New, new_host: New) -> None:
    scene, host = new_scene(2, device=DEVICE), new_host(2, device=DEVICE)
    host.arm()
    moving = LiveHand(host.mock, scene)
    moving.retarget(with_hand(scene, **HELD), 1)
    for n in range(5):
        host.force(n)
    held = of_bodies(host.bodies)
    host.disarm()
    host.arm()
    host.force(0)
    assert np.array_equal(of_bodies(host.bodies), held)
    assert held[1].tolist() == [900.0, 900.0]


def test_a_mock_whose_hand_stays_knows_of_none(new_host: New) -> None:
    host = new_host(1)
    before = int(host.mock.called.take_sample)
    host.arm()
    host.force(0)
    assert (int(host.mock.hand), int(host.mock.called.take_sample)) == (0, before)


@pytest.mark.parametrize("transport", ["loopback", "terminal"])
def test_a_session_moves_the_hand_of_its_mock(new_scene: New, transport: Any) -> None:
    """`on_arming` comes before the first sample: the whole motion is known."""
    scene = new_scene(2, device=DEVICE)

    def grasp(session: Any) -> None:
        session.set({"mock.hand": {"stiffness": 400, "damping": 2, "position": [0.01, -0.005]}}, over=0.02)

    with hapsim.start(scene, duration=0.5, transport=transport, on_arming=grasp) as session:
        session.wait()
    moved = session.trace.position
    assert np.abs(moved[:2]).max() < 1e-6
    assert moved[-1] == pytest.approx([400.0 / 900.0 * 0.01, 400.0 / 900.0 * -0.005], rel=1e-3)
