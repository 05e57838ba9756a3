"""Hands whose motion is over within a few samples: measured right, or said to be too fast to tell."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from rich.console import Console

import hapsim
from hapsim.cli.measure_command import show_measurement
from hapsim.errors import UsageError
from hapsim.measuring.diagnosis import diagnose
from hapsim.measuring.measure_trace import measure_trace
from hapsim.scene import Scene
from tests.measured_scenes import KAPPA, PREDICTOR, RATIO, SENSED, fast_scene

MOVING = {"initial": {"velocity": 1.16792}}
ALL = list(itertools.product(KAPPA, RATIO))
FAST = list(itertools.product(KAPPA[4:], RATIO[1:]))


def require_right_or_unknown(scene: Scene, found: Any) -> bool:
    """Returns whether k and b were measured. They are within 5 %, or it is said that they are not known so well."""
    prediction = hapsim.predict(scene, with_margins=False)
    (felt,) = prediction.felt
    assert diagnose(prediction, found).probable_mass is None
    if not found.dominant or found.too_fast:
        return False
    assert abs(found.k / felt.k - 1.0) < 0.05
    assert abs(found.b - felt.b) < 0.05 * max(felt.b, 0.1 * math.sqrt(felt.k * felt.configuration.mass))
    assert abs(found.k - felt.k) < 5.0 * found.k_uncertainty
    assert abs(found.b - felt.b) < 5.0 * found.b_uncertainty
    return True


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("mock", [{}, MOVING], ids=["pushed from rest", "moving"])
def test_a_predictor_s_hand_is_measured_all_over_the_plane(mock: dict[str, Any]) -> None:
    plane = [fast_scene(kappa, ratio, PREDICTOR, mock) for kappa, ratio in ALL]
    assert sum(require_right_or_unknown(scene, hapsim.measure(scene)) for scene in plane) >= len(ALL) - 1


@pytest.mark.parametrize("velocity", [1.16792, 1.167923456789, 0.0])
def test_a_hand_that_dies_in_thirty_samples_has_its_k_and_its_mass(velocity: float) -> None:
    scene = fast_scene(0.341010745, 1.1, PREDICTOR, {"initial": {"velocity": velocity}})
    found, (felt,) = hapsim.measure(scene), hapsim.predict(scene, with_margins=False).felt
    assert require_right_or_unknown(scene, found)
    assert found.k == pytest.approx(felt.k, rel=1e-3)


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    "device",
    [PREDICTOR | {"delay": 0}, PREDICTOR | {"delay": 1.6}, PREDICTOR | {"delay": 3}, PREDICTOR | {"hold": "ramp"}],
    ids=["at once", "late by a fraction", "late", "ramp"],
)
def test_with_other_delays_and_holds_no_k_is_false(device: dict[str, Any]) -> None:
    measured = [require_right_or_unknown(scene, hapsim.measure(scene)) for scene in scenes(FAST, device)]
    assert sum(measured) >= len(FAST) - 2


def scenes(points: list[tuple[float, float]], device: dict[str, Any]) -> list[Scene]:
    return [fast_scene(*point, device, MOVING) for point in points]


@pytest.mark.parametrize("device", [{}, {"correction": "poles"}, SENSED], ids=["none", "poles", "sensed"])
def test_without_a_predictor_no_k_is_false(device: dict[str, Any]) -> None:
    for scene in scenes(ALL[2::3], device):
        prediction = hapsim.predict(scene, with_margins=False)
        if prediction.stable and prediction.felt[0].dominant:
            require_right_or_unknown(scene, hapsim.measure(scene))


def test_a_flick_is_identified_without_any_push_or_refused() -> None:
    measured = 0
    for scene in scenes(ALL, PREDICTOR):
        try:
            found = measure_trace(hapsim.run(scene, duration=0.1), scene.device.masses(1)[0])
        except UsageError:
            continue
        measured += require_right_or_unknown(scene, found)
    assert measured >= 20


def test_positions_too_coarse_for_the_motion_are_reported() -> None:
    scene = fast_scene(KAPPA[5], 1.5, PREDICTOR, {"quantum": 1e-6})
    found, out = hapsim.measure(scene), Console(width=10_000)
    assert found.too_fast
    with out.capture() as said:
        show_measurement(out, scene, hapsim.predict(scene, with_margins=False), found)
    assert "Too fast to tell: the motion is over within" in said.get()
    assert "The mass is probably" not in said.get()
