"""The lines of links with a memory or a law of the velocity, and of proxies: beside their formulas, and moved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from board_device import BoardDevice, Rig, board_line, scene_with

from hapsim.cordis.program import compile_scene
from hapsim.errors import UsageError
from hapsim.measuring.measure import measure
from hapsim.prediction import predict

LEVEL, BREAKS, BRISTLE = 1.0, 1.5, 5000.0
FRICTION = {"type": "friction", "force": LEVEL, "static": BREAKS, "stiffness": BRISTLE, "damping": 3}
SPRING = {"type": "viscoelastic", "stiffness": 1000, "damping": 1}
CURVE = {"type": "nonlinear", "force_over_velocity": [[-1, -1], [-0.05, -2], [0.05, 2], [1, 1]]}


def moved(rig: Rig, law: str, speed: float, delay: int, samples: int = 1500) -> tuple[Any, float]:
    """Places, m, of a hand that is launched from 0, and the most work that it got, J."""
    rig.start(0.0)
    device, answer, places, most = BoardDevice(0.0, speed, delay=delay), board_line(rig, law), [], 0.0
    for _ in range(samples):
        places.append(device.sample(answer))
        most = max(most, device.work)
    return np.array(places), most


def test_a_bristle_is_a_spring_between_the_forces_at_which_it_slides() -> None:
    rig = Rig(scene_with({"touch": FRICTION}))
    rig.start(0.01)
    assert rig.line(0.01, 0.0) == pytest.approx((0.0, BRISTLE, 3.0, -BREAKS, BREAKS), abs=1e-3)
    assert rig.line(0.0102, 0.0)[0] == pytest.approx(-1.0, abs=1e-3)
    for _ in range(5):
        rig.line(0.012, 0.4)
    edge = 0.012  # it slides, and would stick where the hand turned
    force, k, b, low, high = rig.line(edge, 0.4)
    assert (force, k, b) == pytest.approx((-LEVEL, BRISTLE, 3.0), rel=1e-5)
    assert (low, high) == pytest.approx((-LEVEL, BREAKS), rel=1e-5)
    assert rig.line(edge - 1e-4, -0.1)[:2] == pytest.approx((-LEVEL + 0.5, BRISTLE), rel=1e-5)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_with_a_spring_a_sliding_bristle_adds_its_level_and_no_stiffness(side: float) -> None:
    rig = Rig(scene_with({"touch": FRICTION | {"between": ["wall", "hand"]}, "spring": SPRING}))
    rig.start(0.0)
    for n in range(1, 12):
        x = side * 4e-4 * n
        line = rig.line(x, side * 0.4)
    assert line[:3] == pytest.approx((-side * LEVEL - 1000.0 * x, 1000.0, 1.0), rel=1e-6)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("delay", [1, 3])
@pytest.mark.parametrize("beside", [{}, {"spring": SPRING}])
def test_friction_brings_a_hand_to_rest_that_swings_on_by_the_host_s_law(delay: int, beside: dict[str, Any]) -> None:
    rig = Rig(scene_with({"touch": FRICTION} | beside), delay)
    for speed in (0.02, 0.4):
        (ours, gained), (theirs, _) = (moved(rig, law, speed, delay) for law in ("board", "host"))
        assert np.ptp(ours[-300:]) < 2e-6
        assert np.ptp(theirs[-300:]) > 3e-4
        assert gained < 4e-6  # of 40 and 16 000 µJ


def test_a_plectrum_that_released_has_no_force_until_its_ends_meet() -> None:
    rig = Rig(scene_with({"touch": {"type": "plectrum", "stiffness": 3000, "damping": 1, "release": 0.001}}))
    rig.start(0.0)
    assert rig.line(5e-4, 0.0) == pytest.approx((-1.5, 3000.0, 1.0, -3.0, 3.0), rel=1e-4)
    rig.line(1.2e-3, 0.0)
    assert rig.line(9e-4, 0.0) == (0.0, 0.0, 0.0, 0.0, 0.0)
    near = rig.line(1e-4, 0.0)  # it may grip again: its spring, clipped to 0 on this side
    assert near == pytest.approx((-0.3, 3000.0, 1.0, 0.0, 3.0), rel=1e-4)
    assert rig.line(-2e-4, 0.0)[:2] == pytest.approx((0.6, 3000.0), rel=1e-4)


def test_a_plucked_hand_gets_less_than_by_the_host_s_law() -> None:
    plectrum = {"type": "plectrum", "stiffness": 3000, "damping": 1, "release": 0.001}
    rig = Rig(scene_with({"touch": plectrum, "spring": {"type": "spring", "stiffness": 200}}))
    (_, ours), (_, theirs) = (moved(rig, law, 0.1, 1) for law in ("board", "host"))
    assert ours < 1e-4
    assert theirs > 5e-4


def test_a_curve_over_velocity_is_a_damper_by_its_slope_at_the_present_speed() -> None:
    rig = Rig(scene_with({"touch": CURVE | {"between": ["wall", "hand"]}}))
    for speed in (0.0, 0.01, -0.03, 0.3, -0.7):
        rig.start(0.0)
        force, k, b, low, high = rig.line(1e-3 * speed, speed)
        assert k == 0.0
        assert force - b * speed == pytest.approx(-np.interp(speed, [-1, -0.05, 0.05, 1], [-1, -2, 2, 1]), abs=1e-9)
        assert b == pytest.approx(40.0 if abs(speed) < 0.05 else 0.0)
        assert low - force == pytest.approx(-(high - force))
    ours, _ = moved(rig, "board", 0.4, 1)
    theirs, _ = moved(rig, "host", 0.4, 1)
    assert np.ptp(ours[-300:]) < 1e-8
    assert ours[-1] < theirs[-1]


PROXY = {"type": "proxy", "hand": "hand", "mass": 0.02, "stiffness": 4000, "damping": 5}
BEHIND = {"type": "viscoelastic", "stiffness": 3000, "damping": 2, "between": ["body", "wall"]}


@pytest.mark.parametrize(
    ("links", "modules", "device"),
    [({"behind": BEHIND}, {"body": PROXY}, {"delay": 2}), ({"touch": FRICTION}, {}, {"delay": 3, "board_window": 1})],
    ids=["proxy", "friction"],
)
def test_a_proxy_and_a_bristle_that_sticks_are_felt_as_predicted(
    links: dict[str, Any], modules: dict[str, Any], device: dict[str, Any]
) -> None:
    scene = scene_with(links, modules=modules, device={"friction": 1.0} | device)
    measured, (row, *_) = measure(scene), predict(scene).parts[0].rows
    assert (measured.k, measured.b) == pytest.approx((row.k, row.b), rel=1e-5)


def test_what_no_line_describes_is_refused_in_words() -> None:
    proxy = {"type": "proxy", "hand": "other", "mass": 0.02, "stiffness": 4000}
    other = {"type": "device", "channel": 1}
    touch = {"type": "buffer", "stiffness": 1000, "between": ["hand", "body"]}
    scene = scene_with({"touch": touch}, modules={"other": other, "body": proxy})
    with pytest.raises(UsageError, match=r"device[.]law: found board, but touch .*proxies"):
        compile_scene(scene)
