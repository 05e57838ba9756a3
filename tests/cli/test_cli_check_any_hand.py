"""`check` and `sweep` of hands other than the declared ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim import load_scene, predict
from hapsim.sweeping.quantities import Task

WALL = """
version: 1
rate: 1000
device: {{mass: 0.2, friction: {friction}, clock: lockstep{more}}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  ball: {{type: mass, mass: 1.0}}
  touch: {{type: viscoelastic, between: [hand, ball], stiffness: 2000, damping: {damping}}}
  hold: {{type: viscoelastic, between: [ball, wall], stiffness: 500, damping: {damping}}}
"""
Hapsim = Callable[..., Any]


@pytest.fixture
def scene(tmp_path: Path) -> Callable[..., str]:
    def write(friction: float = 1.0, damping: float = 5.0, more: str = "") -> str:
        path = tmp_path / "scene.yaml"
        path.write_text(WALL.format(friction=friction, damping=damping, more=more))
        return str(path)

    return write


def test_the_friction_needed_and_the_hand_that_oscillates_are_reported(
    hapsim: Hapsim, scene: Callable[..., str]
) -> None:
    path = scene()
    one = predict(load_scene(path), with_margins=False).parts[0].any_hand
    told = hapsim("check", path, "--explain").words
    assert (
        f"hand: not passive: stability in any hands needs {one.needed[0]:.4g} N·s/m of friction (declared: 1)" in told
    )
    hand = one.shaking
    assert hand is not None
    clamp = f"{float(f'{hand.stiffness:.3g}'):.0f} N/m"
    grows = f"with a clamp of {clamp} the oscillation grows {hand.growth:.7g}-fold per sample"
    assert f"a mass or a spring makes it oscillate; {grows}" in told
    (document,) = [one["any_hand"] for one in hapsim("check", path, "--json").document["parts"]]
    assert document["needed_friction"] == one.needed.tolist()
    assert document["needed_friction_of_single_hands"] == one.needed_for_one
    assert document["shaking_hand"] == hand._asdict()
    assert document["worst_hand"] is None


def test_of_a_passive_scene_no_hand_is_named(hapsim: Hapsim, scene: Callable[..., str]) -> None:
    path = scene(friction=30.0)
    assert "hand: passive: stable in any hands" in hapsim("check", path, "--explain").words
    (document,) = [one["any_hand"] for one in hapsim("check", path, "--json").document["parts"]]
    assert (document["passive"], document["shaking_hand"]) == (True, None)


def test_what_swings_for_ever_is_named(hapsim: Hapsim, scene: Callable[..., str]) -> None:
    path = scene(damping=0.0, friction=30.0)
    told = hapsim("check", path, "--explain").words
    assert "not passive at any friction: while the hand is held, a motion of ball at 7.9" in told
    (document,) = [one["any_hand"] for one in hapsim("check", path, "--json").document["parts"]]
    assert (document["needed_friction"], document["lasting"]) == ([None], "ball")


def test_passivity_is_not_reported_where_it_is_not_derived(hapsim: Hapsim, scene: Callable[..., str]) -> None:
    told = hapsim("check", scene(more=", hold: impulse"), "--explain").words
    assert "hand: passivity is unknown, because the condition is derived only for holds without impulses" in told


class TestARange:
    def test_is_judged(self, hapsim: Hapsim, scene: Callable[..., str]) -> None:
        path = scene()
        told = hapsim("check", path, "--hand-mass", "0.1:2", "--hand-stiffness", "0:3000").words
        assert "Hands that add 0.1 to 2 kg and 0 to 3000 N/m to hand: all tested are stable" in told
        shaken = hapsim("check", path, "--hand-stiffness", "3e5:5e5").words
        assert "Hands that add 0 kg and 300000 to 500000 N/m to hand: some are unstable. The worst adds 0 kg" in shaken
        (document,) = hapsim("check", path, "--hand-stiffness", "3e5:5e5", "--json").document["parts"]
        worst = document["any_hand"]["worst_hand"]
        assert worst["stable"] is False
        assert 3e5 <= worst["stiffnesses"][0] <= 5e5

    @pytest.mark.parametrize("text", ["2:1", "-1:1", "1:2:3", "a", "nan", "0:inf"])
    def test_that_is_none_is_refused(self, hapsim: Hapsim, scene: Callable[..., str], text: str) -> None:
        ended = hapsim("check", scene(), f"--hand-mass={text}").refusal
        assert f"--hand-mass: found {text}, expected LOW:HIGH or one number, from 0 on" in " ".join(ended.split())


def test_a_sweep_has_the_friction_that_is_needed(scene: Callable[..., str]) -> None:
    loaded = load_scene(scene())
    found, _ = Task(loaded.model_dump(mode="json"), ("predicted",)).at(loaded)
    one = predict(loaded, with_margins=False).parts[0].any_hand
    assert (found["needed_friction"], found["passive"]) == (one.needed[0], 0.0)
    alone = load_scene("configs/wall.yaml")
    found, _ = Task(alone.model_dump(mode="json"), ("predicted",)).at(alone)
    (one,) = predict(alone, with_margins=False).parts
    assert found["needed_friction"] == pytest.approx(one.any_hand.needed[0], rel=1e-8)


def test_ordinary_hands_are_judged_without_being_asked_for(hapsim: Hapsim, tmp_path: Path) -> None:
    """A light handle on a stiff spring: a heavier one swings so slowly that delay takes more than friction gives."""
    path = tmp_path / "scene.yaml"
    wall = "wall: {type: ground}\n  tie: {type: viscoelastic, between: [hand, wall], stiffness: %s, damping: %s}"
    text = WALL.format(friction=29.5, damping=0.0, more="").split("  wall:")[0]
    path.write_text(f"{text}  {wall % (20000, 0)}\n")
    one = predict(load_scene(path), with_margins=False).parts[0].any_hand
    worst = one.worst_hand((0.0, 2.0), (0.0, 3000.0))
    assert worst is not None
    told = hapsim("check", path, "--explain").words
    assert ("It is stable with hands that add up to 2 kg and 3000 N/m" in told) == worst.is_stable
    assert not worst.is_stable
    assert f"An ordinary hand makes it unstable: one that adds {worst.masses[0]:.3g} kg, 0 N/m" in told
    path.write_text(f"{text}  {wall % (500, 2)}\n".replace("friction: 29.5", "friction: 1.0"))
    assert "It is stable with hands that add up to 2 kg and 3000 N/m" in hapsim("check", path, "--explain").words


@pytest.mark.parametrize(
    ("kind", "curve"),
    [
        ("velocity", [[-0.1, 1.0], [0.0, 1.0], [1e-10, -1.0], [0.1, -1.0]]),
        ("distance", [[0.0, 0.0], [0.004, 0.0], [0.0040000001, 0.5], [0.03, 30.0]]),
    ],
)
def test_a_friction_with_which_a_device_stands_still_is_none(
    hapsim: Hapsim, tmp_path: Path, kind: str, curve: list[list[float]]
) -> None:
    """A jump of the force would need 1e10 N·s/m."""
    path = tmp_path / "jump.yaml"
    text = WALL.format(friction=1.0, damping=5.0, more="").partition("  ball")[0]
    path.write_text(f"{text}  jump: {{type: nonlinear, between: [hand, wall], force_over_{kind}: {curve}}}\n")
    told = hapsim("check", str(path), "--explain").words
    assert "hand: not passive (as assumed) at any friction that a device has" in told
    (part,) = hapsim("check", str(path), "--json").document["parts"]
    assert part["any_hand"]["needed_friction"] == [None]
