"""k and b of a hand whose sensor has coarse counts: a sample moves it by few of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.cli.measure_remarks import attempts
from hapsim.errors import UsageError
from hapsim.measuring.measure import measure
from hapsim.measuring.regression import shaken
from hapsim.running import run
from tests.one_hand import scene_of, touch


def scene_with(quantum: float, **mock: object) -> hapsim.Scene:
    """The first touch of a Hapkit, with other counts."""
    device = {"mass": 0.1, "friction": 0.5, "force_limit": 4.0}
    own = {"quantum": quantum, "initial": {"velocity": 0.1}} | mock
    return scene_of({"touch": touch(300, 1)}, device=device, mock=own)


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


def test_a_larger_push_is_clear_of_coarse_counts_and_never_larger_than_the_range_takes() -> None:
    document = hapsim.load_scene("paper_6_3_real_damping").model_dump(exclude_none=True)
    document["modules"]["touch"] |= {"stiffness": 24.5, "damping": 0.0855}
    document["mock"]["quantum"] = 1e-5
    scene = hapsim.Scene.model_validate(document)
    with pytest.raises(UsageError, match=r"push harder \(--push\), up to the force limit of 10 N; tried: 0.1 N and 0"):
        hapsim.measure(scene)
    felt, measured = hapsim.predict(scene).felt[0], hapsim.measure(scene, push=2.5)
    assert measured.push_n == 2.5
    assert abs(measured.k - felt.k) < 4.0 * measured.k_uncertainty < 0.02 * felt.k
    document["mock"]["quantum"] = 1e-9  # 2^31 counts are 2 m
    assert hapsim.measure(hapsim.Scene.model_validate(document), push=2.5).push_n == pytest.approx(0.105, rel=0.01)


@pytest.mark.parametrize("push", [None, 1.0])
def test_a_hand_that_moves_too_little_is_pushed_harder_once_if_no_push_was_asked_for(push: float | None) -> None:
    scene, runs = scene_with(1e-4, initial={}), []

    def counted(scene: hapsim.Scene, **options: Any) -> hapsim.Trace:
        runs.append(run(scene, **options))
        return runs[-1]

    if push is not None:
        with pytest.raises(UsageError, match=r"push harder \(--push\)$"):
            measure(scene, push=push, run=counted)
        assert len(runs) == 1
        return
    measured = measure(scene, run=counted)
    first, second = measured.attempts
    assert len(runs) == 2
    assert (first.push_n, second.push_n) == (1.0, measured.push_n)
    assert 2.0 < second.push_n < scene.device.force_limit
    assert measured.k == pytest.approx(hapsim.predict(scene).k, abs=4 * measured.k_uncertainty)
    assert measured.k_uncertainty == pytest.approx(second.uncertainty * measured.k)
    assert second.uncertainty < 0.002
    assert "With pushes of 1 N, the hand moved too little; repeated with 2.5 N." in attempts(measured)


@pytest.mark.parametrize("ratio", [1e-4, 0.1, 3.0])
def test_a_white_force_and_a_white_error_have_the_spectrum_of_the_filter(ratio: float) -> None:
    p, q = shaken(ratio), np.exp(1j * np.linspace(0.1, 3.0, 9))
    found = np.abs((1.0 - p / q) * (1.0 - p.conjugate() / q)) ** 2
    expected = np.abs(1.0 - 1.0 / q) ** 4 + ratio**2 * np.abs((1.0 + 1.0 / q) / 2.0) ** 2
    np.testing.assert_allclose(found / found[0], expected / expected[0], rtol=1e-9)
    assert abs(p) < 1.0
