"""A guide leads a hand to a place, measures by itself what holds it there, and leaves it to that force."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hapsim.running import Excitation, run
from hapsim.running.session_options import Guide
from hapsim.scene import Scene
from tests.one_hand import scene_of, touch

RATE, PUSHED = 1000.0, 256
GUIDE = Guide(target=-0.003, stiffness=800.0)
TICKS = sum(GUIDE.ticks(RATE))


def wall(**mock: Any) -> Scene:
    return scene_of({"stop": touch(1500.0, 4.0, "buffer")}, mock={"initial": {"position": 0.002}} | mock)


def guided(scene: Scene, force: float = 0.0, **options: object) -> tuple[np.ndarray, np.ndarray]:
    """(position in m, force beside the scene's in N) of a run."""
    excitation = Excitation(0, force, 8, PUSHED, start=0, first=False, guide=GUIDE)
    trace = run(scene, duration=(TICKS + PUSHED) / scene.rate, excitation=excitation, **options)
    return trace.position[:, 0], (trace.force - trace.asked_force)[:, 0]


@pytest.mark.parametrize(
    "mock", [{}, {"hand": {"force": -2.0}}, {"coulomb": 0.3}, {"quantum": 1e-5, "noise": 1e-5}], ids=str
)
def test_the_hand_comes_to_rest_at_the_target_whatever_else_pulls(mock: dict[str, Any]) -> None:
    position, beside = guided(wall(**mock))
    assert np.abs(position[TICKS:] - GUIDE.target).max() < 6e-5
    assert np.ptp(beside[TICKS:]) < 1e-6
    carried = beside[-1] + 1500.0 * 0.003 - (2.0 if "hand" in mock else 0.0)
    assert abs(carried) < (0.3 if "coulomb" in mock else 0.02)


def test_the_way_is_slow_and_the_pushes_follow_it() -> None:
    scene = wall()
    position, _ = guided(scene)
    assert np.abs(np.diff(position)).max() * RATE < 0.01
    pushed, beside = guided(scene, force=0.5)
    assert np.array_equal(pushed[:TICKS], position[:TICKS])
    assert beside[TICKS : TICKS + 8] - beside[-1] == pytest.approx(0.5, abs=1e-6)
    assert np.ptp(beside[TICKS + 8 :]) < 1e-6


def test_no_guard_ends_a_slow_way_through_a_snap() -> None:
    """The guide spends the energy that the snap returns, over the peak and down to the other rest."""
    curve = [[-0.01, -4], [-0.005, 0], [-0.002, 2], [0.002, -2], [0.005, 0], [0.01, 4]]
    links = {
        "rub": {"type": "damper", "between": ["hand", "wall"], "damping": 2},
        "snap": {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": curve},
    }
    scene = scene_of(links, device={"force_limit": 5}, mock={"initial": {"position": 0.005}})
    position, _ = guided(scene, judges_energy=True, judges_sign=True)
    assert abs(position[-1] - GUIDE.target) < 1e-5
