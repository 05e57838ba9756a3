"""Motions of hands on a board's lines, simulated, beside the mock and the kernel's lines in virtual time."""

import numpy as np
import pytest

from hapsim.prediction import predict
from hapsim.running.run import run_in_memory
from tests.verdict_scenes import Push, as_scene, verdict_scene


def last_swing(seed: int, push: Push) -> float:
    """Swing of the first hand in the last half second of three, m, on the mock."""
    position = run_in_memory(as_scene(verdict_scene("lines", seed), push), duration=3).position[-500:, 0]
    return float(np.ptp(position))


@pytest.mark.parametrize("seed", [352, 368])
def test_a_swing_that_no_state_shows_is_predicted_with_its_size(seed: int) -> None:
    """Teeth crossed behind a long wire, and a stiff contact beside a soft piece: each state of them is stable."""
    prediction = predict(as_scene(verdict_scene("lines", seed)), with_margins=False)
    assert (prediction.verdict, prediction.stable, prediction.judge.shaking) == ("swings on", False, None)
    (swing,) = prediction.judge.swings.values()
    assert swing is not None
    found = np.array([last_swing(seed, Push(speed, swing.push)) for speed in (-1.0, -0.4, -0.1, 0.1, 0.4, 1.0)])
    lasting = found[found > 1e-4]  # the others die away
    assert lasting.size
    assert 0.85 * swing.least < lasting.min()  # not periodic: no half second is as the other
    assert lasting.max() == pytest.approx(swing.most, rel=0.05)


def test_a_scene_without_swings_stays_stable() -> None:
    prediction = predict(as_scene(verdict_scene("lines", 2)), with_margins=False)
    assert (prediction.verdict, prediction.stable, prediction.judge.swings) == ("stable", True, {})
    assert last_swing(2, Push(-1.0, 10.0)) < 2e-6
