"""k and b of a hand whose sensor has coarse counts: a sample moves it by few of them."""

from __future__ import annotations

import pytest

import hapsim
from hapsim.errors import UsageError


def scene_with(quantum: float, **mock: object) -> hapsim.Scene:
    """The first touch of a Hapkit, with other counts."""
    touch = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 300, "damping": 1}
    return hapsim.Scene.model_validate(
        {
            "version": 1,
            "rate": 1000,
            "device": {"clock": "lockstep", "mass": 0.1, "friction": 0.5, "force_limit": 4.0},
            "mock": {"quantum": quantum, "initial": {"velocity": 0.1}} | mock,
            "modules": {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "touch": touch},
        }
    )


@pytest.mark.parametrize("quantum", [2e-6, 13e-6, 17.2e-6, 50e-6])
def test_k_and_b_are_read_from_coarse_counts(quantum: float) -> None:
    scene = scene_with(quantum)
    predicted, measured = hapsim.predict(scene), hapsim.measure(scene)
    assert measured.k == pytest.approx(predicted.k, rel=0.003, abs=4 * measured.k_uncertainty)
    assert measured.b == pytest.approx(predicted.b, rel=0.01, abs=4 * measured.b_uncertainty)
    assert measured.k_uncertainty < 0.003 * predicted.k


def test_a_hand_that_hardly_moves_by_a_count_is_too_little() -> None:
    with pytest.raises(UsageError, match="too little motion"):
        hapsim.measure(scene_with(1e-3))
