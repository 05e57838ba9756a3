"""`hapsim chart force`: its numbers are the scene's force, its loop the friction and damping."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Chart = Callable[..., Any]

SCENE = """\
version: 1
rate: 2000
device: {mass: 0.08, friction: 0.6}
modules:
  hand: {type: device, channel: 0}
  frame: {type: ground}
  rest: {type: viscoelastic, between: [hand, frame], stiffness: 200, damping: 1}
  dome: {type: nonlinear, between: [hand, frame], force_over_distance: [[-0.0025, -1.5], [-0.002, -2.6], [0, 0]]}
  stop: {type: buffer, between: [hand, frame], stiffness: 2500, damping: 40, distance: -0.005}
  rub: {type: friction, between: [hand, frame], force: 0.1, stiffness: 500}
"""


@pytest.fixture
def columns(chart: Chart, columns_of: Callable[[str], Any]) -> dict[str, np.ndarray]:
    Path("button.yaml").write_text(SCENE)
    words = ["--data", "f.csv", "--picture", "f.svg", "--speed", "0.02", "--json"]
    document = chart("force", "button.yaml", *words).document
    assert [one["kind"] for one in document["regions"] if not one["slide"]] == ["held", "held", "snap", "held", "held"]
    assert "snap" in Path("f.svg").read_text()
    return columns_of("f.csv")


def test_the_force_is_that_of_the_links_and_the_loop_that_of_friction_and_damping(
    columns: dict[str, np.ndarray],
) -> None:
    x = columns["position_m"]
    pressed = 2500.0 * np.minimum(x + 0.005, 0.0)
    static = 200.0 * x + np.interp(x, [-0.0025, -0.002, 0.0], [-1.5, -2.6, 0.0])
    np.testing.assert_allclose(columns["force_N"], static + pressed, atol=1e-6)
    for name, way in (("pushing", 1.0), ("releasing", -1.0)):
        # The stop never pulls, however fast the hand leaves it.
        stop = np.minimum(pressed + way * 0.02 * 40.0 * (x < -0.005), 0.0)
        expected = static + stop + way * (0.1 + 0.02 * 1.0)
        np.testing.assert_allclose(columns[f"force_{name}_N"], expected, atol=1e-6)
    held = ~np.isnan(columns["k"])
    assert not held[(x > -0.0024999) & (x < -0.0020001)].any()
    assert columns["stable"].all()


def test_a_hand_that_moves_a_mass_has_no_such_picture(chart: Chart) -> None:
    answer = chart("force", "two_hands", "--picture", "f.svg")
    assert answer.status == 2
    assert "left also moves a mass of the scene (body, by to-left): its force depends on" in answer.err
    assert not Path("f.svg").exists()
