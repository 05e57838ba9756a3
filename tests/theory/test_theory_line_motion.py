"""Motions of hands on a board's lines, simulated, beside the mock and the kernel's lines in virtual time."""

import numpy as np
import pytest

from hapsim.prediction import line_motion, predict, warnings_about
from hapsim.running.run import run_in_memory
from tests.verdict_scenes import Push, as_scene, verdict_scene


def last_swing(seed: int, push: Push) -> float:
    """Swing of the first hand in the last half second of three, m, on the mock."""
    position = run_in_memory(as_scene(verdict_scene("lines", seed), push), duration=3).position[-500:, 0]
    return float(np.ptp(position))


def test_a_swing_that_no_state_shows_is_predicted_with_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """A saw beside a stiff spring, which a hand finds after a flight of 30 mm: each state of them is stable."""
    monkeypatch.setattr(line_motion, "_TRIES", 200)
    monkeypatch.setattr(line_motion, "_LATER", 0)  # it does not come to rest within seconds
    seed = 83
    scene = as_scene(verdict_scene("lines", seed))
    prediction = predict(scene, with_margins=False)
    assert (prediction.verdict, prediction.stable, prediction.judge.shaking) == ("swings on", False, None)
    assert any("after a knock" in one for one in warnings_about(scene, prediction))
    (swing,) = prediction.judge.swings.values()
    assert swing is not None
    found = np.array([last_swing(seed, Push(speed, swing.push)) for speed in (-1.0, -0.4, -0.1, 0.1, 0.4, 1.0)])
    lasting = found[found > 1e-4]  # the others die away
    assert lasting.size
    assert 0.85 * swing.least < lasting.min()  # not periodic: no half second is as the other
    assert lasting.max() == pytest.approx(swing.most, rel=0.05)


@pytest.mark.thorough
def test_a_swing_that_dies_away_more_slowly_than_in_the_assumed_state_is_none() -> None:
    prediction = predict(as_scene(verdict_scene("lines", 178)), with_margins=False)
    assert (prediction.verdict, prediction.stable, prediction.judge.swings) == ("stable", True, {})
    position = run_in_memory(as_scene(verdict_scene("lines", 178), Push(-1.0, 0.0)), duration=3).position[:, 0]
    early, late = np.ptp(position[1000:1500]), np.ptp(position[2500:])
    assert 1e-4 < late < 0.95 * early
