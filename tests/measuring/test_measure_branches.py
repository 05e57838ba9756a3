"""A curve with two branches, predicted stuck and sliding and measured so; its least turn and the energy of a cycle."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapsim as package
from hapsim.errors import UsageError
from hapsim.measuring.branch import on_branch
from hapsim.prediction.turning import turnings_of
from tests.branch_scenes import BUTTON, Kernel, branch_scene, compared, on_way, random_curve


def regions_at(scene: Any, x: float) -> dict[str, Any]:
    """The regions of the hand at x, by branch."""
    ((_, regions),) = package.predict(scene, with_margins=False).regions.items()
    return {one.piece.branch: one for one in regions if one.piece.low < x < one.piece.high}


def test_a_button_feels_stuck_and_sliding_as_worked_out_by_hand() -> None:
    at = regions_at(branch_scene(BUTTON), 0.9e-3)
    expected = {"": 2458.33, "steepest": 2750.0, "softest": 2166.67, "pressed": 250.0, "released": 166.67}
    assert {how: round(one.piece.stiffness, 2) for how, one in at.items()} == expected
    # M' - h' + 2 h/turn at 0.6 mm, M' + h' + 2 h/turn at 1.2 mm, with h 0.1 and 0.125 N


def test_any_hand_is_safe_from_the_friction_on_that_its_steepest_slope_asks() -> None:
    """The passivity condition of the theory and the closed one for the least turn are the same."""
    every = [
        one for at in (0.3e-3, 0.9e-3, 1.4e-3, 2e-3, 2.7e-3) for one in regions_at(branch_scene(BUTTON), at).values()
    ]
    assert max(one.felt.needed_friction for one in every) == pytest.approx(9.0, rel=1e-9)
    found = turnings_of(branch_scene(BUTTON))["curve"]
    assert (found.steepest, found.needed_friction, found.least) == pytest.approx((6000.0, 9.0, 1e-4), rel=1e-9)
    assert found.cycle == pytest.approx((0.0, 3e-3))


@pytest.mark.parametrize(
    ("values", "more"),
    [
        ({"friction": 5.0}, 1e-9),
        ({"rate": 4000.0, "delay": 2}, 1e-9),
        ({"delay": 0.05}, 0.01),
        ({"delay": 0.3}, 0.06),
        ({"delay": 2.5, "friction": 20.0}, 0.04),
        ({"hold": "ramp"}, 0.02),
        ({"hold": "ramp", "delay": 0}, 0.002),
    ],
)
def test_at_its_least_turn_the_friction_is_enough_for_any_hand_and_little_more(values: Any, more: float) -> None:
    least = turnings_of(branch_scene(BUTTON, **values))["curve"].least
    scene = branch_scene(BUTTON | {"turn": least}, **values)
    ((_, regions),) = package.predict(scene, with_margins=False).regions.items()
    friction = scene.device.frictions(1)[0]
    needed = max(one.felt.needed_friction for one in regions)
    assert friction * (1.0 - more) <= needed <= friction * (1.0 + 1e-9)


def test_with_less_friction_it_buzzes_where_it_is_steepest() -> None:
    scene = branch_scene(BUTTON, friction=5.0)
    assert package.predict(scene).verdict == "unstable"
    unstable = {how for how, one in regions_at(scene, 2.7e-3).items() if not one.is_stable}
    assert unstable == {"", "steepest", "softest"}
    assert all(one.is_stable for one in regions_at(branch_scene(BUTTON), 2.7e-3).values())


def test_check_prints_slopes_least_turn_and_the_energy_of_a_cycle(hapsim: Any) -> None:
    out = hapsim("check", "button_recorded").out
    assert "0.6 to 1.2 2167 to 2750 250 166.7 stable" in " ".join(out.split())
    assert "its steepest slope, 6000 N/m, asks 9 N·s/m of friction" in out.replace("\n", " ")
    assert "any hand is safe with a turn of 0.1 mm or more. From 0 to 3 mm and back it takes 0.5358 mJ" in out.replace(
        "\n", " "
    )
    branches = hapsim("check", "button_recorded", "--json").document["branches"]
    assert branches["button"]["cycle_energy_j"] == pytest.approx(0.535777778e-3, rel=1e-8)


@pytest.mark.parametrize(
    ("at", "branch", "within"), [(0.9e-3, None, 1e-3), (0.9e-3, "press", 6e-3), (2.7e-3, "release", 2e-4)]
)
def test_it_is_measured_stuck_and_sliding_as_predicted(at: float, branch: str | None, within: float) -> None:
    scene = branch_scene(BUTTON)
    found = package.measure(scene, at=at, **({} if branch is None else {"branch": branch}))
    seen = scene if branch is None else on_branch(scene, 0, branch)
    (felt,) = package.predict(seen, with_margins=False, at=at).felt
    assert found.k == pytest.approx(felt.k, rel=within)
    assert abs(found.k - felt.k) < 4.0 * found.k_uncertainty
    assert abs(found.b - felt.b) < within * 2.0 * math.sqrt(felt.k * 0.2)


def test_on_random_curves_too() -> None:
    """tools/bench/branches has 50."""
    for number in range(2):
        for one in compared(np.random.default_rng([7, number])):
            assert one.off < 4.0, one


def test_a_hand_without_two_branches_has_none_to_slide_on() -> None:
    with pytest.raises(UsageError, match="branch: found press, but hand has no curve with two branches to a ground"):
        package.measure(branch_scene(BUTTON["press"]), at=0.9e-3, branch="press")
    with pytest.raises(UsageError, match="branch: found 'up', expected press or release"):
        package.measure(branch_scene(BUTTON), at=0.9e-3, branch="up")


@pytest.mark.parametrize("z", [-1.0, 0.0, 1.0])
def test_between_the_branches_the_kernel_has_a_predicted_slope(z: float) -> None:
    rng = np.random.default_rng(11)
    for _ in range(5):
        curve = random_curve(rng)
        scene, turn = branch_scene(curve), curve["turn"]
        low, high = sorted(rng.uniform(curve["release"][0][0], curve["release"][-1][0], 2))
        x = 0.5 * (low + high)
        come = [0.0, x + np.sign(z) * -9e-2, x] if z else [0.0, x + 9e-2, x + 9e-2 - turn / 2.0, x]
        at = {how: one.piece.stiffness for how, one in regions_at(scene, x).items()}
        step = 1e-9 * (-z or 1.0)
        way = on_way(curve, [*come, x + step]) if z else on_way(curve, [0.0, x - 9e-2, x + turn / 2.0, x, x + step])
        force = Kernel(scene).on(way.x)
        slope = (force[-1] - force[-3]) / (way.x[-1] - way.x[-3])
        assert at["softest"] * (1.0 - 1e-4) - 1e-3 <= slope <= at["steepest"] * (1.0 + 1e-4) + 1e-3


def test_the_comment_of_the_shipped_button_has_the_predicted_values() -> None:
    path = Path(__file__).resolve().parents[2] / "configs" / "button_recorded.yaml"
    scene, comment = package.load_scene(path), path.read_text()
    felt = [
        package.predict(one, with_margins=False, at=0.9e-3).felt[0].k
        for one in (scene, *(on_branch(scene, 0, branch) for branch in ("press", "release")))
    ]
    assert [round(k, digits) for k, digits in zip(felt, (0, 2, 2), strict=True)] == [2423, 249.63, 166.5]
    assert all(words in comment for words in ("2423 N/m", "k = 249.63 N/m", "166.5 N/m", "0.536 mJ"))
    assert package.predict(scene).verdict == "stable"
