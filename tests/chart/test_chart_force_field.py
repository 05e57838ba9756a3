"""`hapsim chart force` in the plane: its numbers are the force of the links, its picture has what makes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Chart = Callable[..., Any]
Columns = Callable[[str], dict[str, np.ndarray]]

SCENE = """\
version: 1
rate: 1000
space: 2
device: {mass: 0.2, friction: 1.0, force_limit: 6, travel: {disc: 0.08}}
modules:
  hand:  {type: device, channels: [0, 1]}
  post:  {type: ground, position: [0.03, -0.01]}
  disc:  {type: shape, between: [hand, post], form: {disc: 0.02}, stiffness: 2000, friction_coefficient: 0.3}
  floor: {type: shape, between: [post, ball], form: {half_plane: [0, 1]}, side: inside, stiffness: 9}
  lane:  {type: guide, between: [hand, post], path: straight, through: [[-0.05, 0.04], [0.02, 0.04]], stiffness: 800,
          width: 0.004, reach: 0.008}
  ball:  {type: mass, mass: 0.05, position: [-0.02, 0.0]}
  hit:   {type: buffer, between: [ball, hand], distance: 0.01, stiffness: 1500}
  rope:  {type: spring, between: [hand, ball], length: 0.015, stiffness: 50}
"""


@pytest.fixture(autouse=True)
def _scene(chart: Chart) -> None:
    assert chart
    Path("plane.yaml").write_text(SCENE)


def pushed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The force on the hand, N: from the disc, from the ball and its rope, and towards the lane."""
    hand = np.array([x, y])
    force = np.zeros_like(hand)
    from_post, from_ball = hand - [[0.03], [-0.01]], hand - [[-0.02], [0.0]]
    r, d = np.hypot(*from_post), np.hypot(*from_ball)
    force += 2000.0 * np.maximum(0.02 - r, 0.0) * from_post / r
    force += (1500.0 * np.maximum(0.01 - d, 0.0) - 50.0 * (d - 0.015)) * from_ball / d
    foot = np.array([np.clip(from_post[0], -0.05, 0.02), np.full_like(x, 0.04)])
    aside = from_post - foot
    away = np.hypot(*aside)
    within = (away > 0.002) & (away < 0.008)
    return force - np.where(within, 800.0 * (away - 0.002), 0.0) * aside / away


def test_the_arrows_are_the_force_of_the_links(chart: Chart, columns_of: Columns) -> None:
    words = ["--area=-30mm,0.05:0.06,-0.02", "--data", "f.csv", "--picture", "f.svg", "--json"]
    document = chart("force", "plane.yaml", *words).document
    assert document["area_m"] == [[-0.03, -0.02], [0.06, 0.05]]
    found = columns_of("f.csv")
    x, y, force = found["x_m"], found["y_m"], np.array([found["force_x_N"], found["force_y_N"]])
    assert -0.03 < x.min() < -0.027
    assert 0.048 < y.max() < 0.05
    np.testing.assert_allclose(force, pushed(x, y), atol=1e-9)
    assert (np.abs(force).sum(axis=0) > 0.0).mean() > 0.5
    assert document["strongest_N"] == pytest.approx(np.hypot(*force).max())


def test_the_picture_is_about_all_that_the_scene_has(chart: Chart, columns_of: Columns) -> None:
    answer = chart("force", "plane.yaml", "--data", "f.csv", "--picture", "f.svg")
    assert answer.out.startswith("Strongest force on hand in the area: ")
    drawn = Path("f.svg").read_text()
    for words in ("shape", "guide", "travel", "of other points", "ball", "post", "x (mm)", "force (N)", "Force on"):
        assert f"<!-- {words}" in drawn
    found = columns_of("f.csv")
    assert -0.05 < found["x_m"].min() < -0.02  # the lane begins there, the travel farther out
    assert 0.05 < found["x_m"].max() < 0.08
    assert -0.05 < found["y_m"].min() < -0.03  # below the disc


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--area", "0,0:0,0.1"], "--area: found an area without a size, expected two opposite corners"),
        (["--area", "0,0"], "--area: found '0,0', expected X,Y:X,Y, such as 0,0:0.01,0 or 0,0:10mm,0"),
        (["--area", "0,0:0.1,nan"], "--area: found '0,0:0.1,nan', expected X,Y:X,Y"),
        (["--channel", "4"], "--channel 4: the scene has nothing there; its device points are on: 0, 1"),
    ],
)
def test_what_does_not_fit_the_plane_is_refused(chart: Chart, words: list[str], sentence: str) -> None:
    answer = chart("force", "plane.yaml", *words, "--picture", "f.svg")
    assert answer.status == 2
    assert sentence in answer.err
    assert not Path("f.svg").exists()
