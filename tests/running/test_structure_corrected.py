"""Links that come and go before a device whose correction adapts."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from hapsim.scene import Scene
from tests.one_hand import scene_of

sys.path.insert(0, str(Path(__file__).parent))
from live_structures import running

TOUCH = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 5000.0, "damping": 4.0}


def scene_with(*links: str) -> Scene:
    device = {"mass": {"from": 0.1, "to": 0.4}, "correction": "adaptive"}
    return scene_of(dict.fromkeys(links, TOUCH), device=device, mock={"mass": 0.4, "initial": {"velocity": 0.1}})


def test_a_link_that_is_taken_away_leaves_no_force_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The force that the mass estimate added to a link goes with the link."""
    with running(scene_with("touch"), monkeypatch) as runner:
        for _ in range(6):  # as long as the estimate takes
            runner.go()
        (mass,) = runner.loop.correction.masses(1)["estimated_mass_kg"]
        assert mass > 0.2  # so that something was added
        runner.adopt(scene_with())
        for _ in range(3):
            runner.go()
    assert np.abs(runner.asked[330:390, 0]).max() > 0.1
    np.testing.assert_array_equal(runner.asked[-65:, 0], 0.0)
