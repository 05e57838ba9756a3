"""What the linear theory takes each link for."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.prediction import predict
from hapsim.prediction.linear import linear_scene
from hapsim.scene import parse_scene
from hapsim.theory.links import nonlinear, sector, slope_at

CURVE = ((-0.03, 3.0), (-0.01, -2.0), (0.0, 0.0), (0.01, 5.0), (0.02, 4.0))

HEAD = """\
version: 1
rate: 1000
device: {mass: 0.2, friction: 2}
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground}
"""


def test_the_sector_of_a_curve_has_its_steepest_slope_and_its_level_ends() -> None:
    assert sector(CURVE) == pytest.approx((-250.0, 500.0))
    assert sector(((-1.0, -5.0), (1.0, 5.0))) == (0.0, 5.0)
    assert sector(None) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("x", "slope"),
    [(-0.04, 0.0), (-0.03, -125.0), (-0.02, -250.0), (-0.005, 200.0), (0.0, 350.0), (0.015, -100.0), (0.02, -50.0)],
)
def test_the_slope_at_a_corner_is_the_mean_of_those_beside_it(x: float, slope: float) -> None:
    assert slope_at(CURVE, x) == pytest.approx(slope)


def test_a_swing_about_a_corner_feels_the_mean_of_both_slopes() -> None:
    swing = 0.004 * np.cos(2.0 * np.pi * np.arange(4000) / 4000)
    felt = 2.0 * np.mean(np.interp(swing, *zip(*CURVE, strict=True)) * swing) / 0.004**2
    assert felt == pytest.approx(slope_at(CURVE, 0.0), rel=1e-6)


def test_what_was_taken_for_a_curve_is_said_with_how_steep_it_is_elsewhere() -> None:
    taken = nonlinear(CURVE, None)
    assert taken[:2] == pytest.approx((350.0, 0.0))
    assert taken.assumption == (
        "is taken with its slopes where its ends meet and stand; elsewhere they lie between -250 and 500 N/m"
    )


def test_a_cell_is_predicted_as_the_mass_the_link_and_the_ground_that_it_stands_for() -> None:
    touch = "  touch: {type: spring, between: [hand, c], stiffness: 200}\n"
    cell = "  c: {type: cell, mass: 0.02, stiffness: 300, damping: 0.5}\n"
    taken_apart = (
        "  c: {type: mass, mass: 0.02}\n  own: {type: viscoelastic, between: [c, wall], stiffness: 300, damping: 0.5}\n"
    )
    one, other = (predict(parse_scene(HEAD + text + touch)) for text in (cell, taken_apart))
    np.testing.assert_allclose(np.sort_complex(one.poles), np.sort_complex(other.poles), rtol=1e-9)
    assert one.coupled == {"hand": "moves a mass of the scene too (c, by touch)"}
    assert one.margins[0].stiffness_factor == pytest.approx(other.margins[-1].stiffness_factor, rel=1e-6)


def test_a_spring_and_a_damper_are_predicted_as_the_link_that_is_both() -> None:
    both = "  touch: {type: viscoelastic, between: [hand, wall], stiffness: 800, damping: 3}\n"
    each = (
        "  k: {type: spring, between: [hand, wall], stiffness: 800}\n"
        "  z: {type: damper, between: [wall, hand], damping: 3}\n"
    )
    one, other = (predict(parse_scene(HEAD + text)) for text in (both, each))
    assert (one.k, one.b) == pytest.approx((other.k, other.b), rel=1e-12)


@pytest.mark.parametrize(
    "link",
    [
        "{type: nonlinear, between: [hand, wall], force_over_distance: [[-0.01, 2], [0.01, -2]]}",
        "{type: nonlinear, between: [hand, wall], force_over_velocity: [[-0.1, 2], [0.1, -2]]}",
        "{type: friction, between: [hand, wall], force: 1, stiffness: 500, damping: 1}",
        "{type: plectrum, between: [hand, wall], stiffness: 500, damping: 1, release: 0.01}",
    ],
)
def test_whatever_a_link_is_for_small_motions_is_predicted_and_what_was_assumed_is_said(link: str) -> None:
    scene = parse_scene(f"{HEAD}  it: {link}\n")
    prediction = predict(scene)
    (sentence,) = prediction.assumptions
    assert sentence.startswith("it is taken ")
    taken = linear_scene(scene).links["it"]
    # What pulls the hand back to where it was is stable, and what drives it away is not.
    assert prediction.stable == (taken.stiffness >= 0.0 and taken.damping >= 0.0)
