"""Each link in the linear theory."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hapsim.laws import Law, curve_law
from hapsim.prediction import predict
from hapsim.scene import parse_scene
from hapsim.scene.modules import MODULE_TYPES, Link

CURVE = ((-0.03, 3.0), (-0.01, -2.0), (0.0, 0.0), (0.01, 5.0), (0.02, 4.0))

HEAD = """\
version: 1
rate: 1000
device: {mass: 0.2, friction: 2}
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground}
"""


def law_of(kind: str, **values: Any) -> Law:
    link = MODULE_TYPES[kind].model_validate({"type": kind, "between": ("hand", "wall")} | values)
    assert isinstance(link, Link)
    return link.law()


def test_the_sector_of_a_curve_has_its_steepest_slope_and_its_level_ends() -> None:
    assert curve_law(CURVE).sector == pytest.approx((-250.0, 500.0))
    assert curve_law(((-1.0, -5.0), (1.0, 5.0))).sector == (0.0, 5.0)
    assert curve_law(None).sector == (0.0, 0.0)


@pytest.mark.parametrize(
    ("x", "slope"),
    [(-0.04, 0.0), (-0.03, -125.0), (-0.02, -250.0), (-0.005, 200.0), (0.0, 350.0), (0.015, -100.0), (0.02, -50.0)],
)
def test_the_slope_at_a_corner_is_the_mean_of_its_neighbours(x: float, slope: float) -> None:
    assert law_of("nonlinear", force_over_distance=CURVE).slope(x) == pytest.approx(slope)


def test_a_swing_about_a_corner_feels_the_mean_of_both_slopes() -> None:
    swing = 0.004 * np.cos(2.0 * np.pi * np.arange(4000) / 4000)
    felt = 2.0 * np.mean(np.interp(swing, *zip(*CURVE, strict=True)) * swing) / 0.004**2
    assert felt == pytest.approx(law_of("nonlinear", force_over_distance=CURVE).slope(0.0), rel=1e-6)


def _triangle(d: float, peak_at: float) -> float:
    """Rises to 1 at peak_at, back to 0 at 1/2, odd, of period 1."""
    u = d - np.floor(d + 0.5)
    return float(np.sign(u) * np.interp(abs(u), [0.0, peak_at, 0.5], [0.0, 1.0, 0.0]))


DETENT = {"depth": 0.3, "pitch": 0.009, "damping": 0.1}
LAWS = {
    "link": (law_of("viscoelastic", stiffness=300.0, damping=2.0), lambda d: 300.0 * d),
    "buffer": (law_of("buffer", stiffness=900.0, damping=1.0, distance=0.003), lambda d: 900.0 * min(d - 0.003, 0.0)),
    "table": (law_of("nonlinear", force_over_distance=CURVE), lambda d: float(np.interp(d, *zip(*CURVE, strict=True)))),
    "plectrum": (law_of("plectrum", stiffness=400.0, release=0.013), lambda d: 400.0 * d * (abs(d) < 0.013)),
    "sine": (law_of("detent", **DETENT, shape="sine"), lambda d: 0.3 * np.sin(2.0 * np.pi * d / 0.009)),
    "snap": (law_of("detent", **DETENT, shape="snap", sharpness=3.0), lambda d: 0.3 * _triangle(d / 0.009, 0.375)),
    "notch": (
        law_of("detent", **DETENT, shape="notch", sharpness=2.0),
        lambda d: 0.3 * np.sign(u := np.remainder(d + 0.0045, 0.009) - 0.0045)
        * np.interp(abs(u), [0.0, 0.001125, 0.00225], [0.0, 1.0, 0.0]),
    ),
    "click": (
        law_of("click", travel=0.004, peak=0.6, drop=0.35, bottom=5000.0, damping=0.2),
        lambda d: -float(np.interp(-d, [0.0, 0.002, 0.003, 0.004, 1.004], [0.0, 0.6, 0.25, 0.55, 5000.55])),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LAWS)
def test_a_law_has_the_tension_of_its_formula_and_the_slope_of_its_tension(name: str) -> None:
    law, formula = LAWS[name]
    for d in np.random.default_rng(3).uniform(-0.03, 0.03, 200):
        assert float(law.tension(d)) == pytest.approx(formula(d), abs=1e-12)
        if all(abs(d - edge) > 2e-7 for edge in law.edges_between(-0.04, 0.04)):
            slope = float(law.tension(d + 1e-7) - law.tension(d - 1e-7)) / 2e-7
            assert law.slope(d) == pytest.approx(slope, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("name", LAWS)
def test_between_its_edges_a_law_is_in_one_state_with_one_slope(name: str) -> None:
    law: Law = LAWS[name][0]
    edges = [-0.021, *law.edges_between(-0.021, 0.021), 0.021]
    assert edges == sorted(set(edges))
    for low, high in pairwise(edges):
        within = np.linspace(low, high, 7)[1:-1]
        assert len({(law.state(d), law.damping(d)) for d in within}) == 1
        slopes = [law.slope(d) for d in within]
        assert max(slopes) * min(slopes) >= 0.0 if law.is_curved else max(slopes) == min(slopes)


def test_a_bristle_has_its_reach_and_no_force_where_it_rests() -> None:
    law = law_of("friction", stiffness=3000.0, damping=1.0, force=0.8, static=1.2)
    assert (law.reach, law.slides_at, float(law.tension(0.01))) == (pytest.approx(4e-4), 0.8, 0.0)


def test_what_was_taken_for_a_curve_is_stated_with_how_steep_it_is_elsewhere() -> None:
    taken = law_of("nonlinear", force_over_distance=CURVE).linear()
    assert taken[:2] == pytest.approx((350.0, 0.0))
    assert taken.assumption == (
        "is taken with its slopes where its ends meet and stand; elsewhere they lie between ‹-250 and 500 N/m›"
    )


@pytest.mark.parametrize(
    ("link", "stable"),
    [
        # It rests where the table is level, beyond its points.
        ("{type: nonlinear, between: [hand, m], force_over_distance: [[-0.01, 2], [0.01, -2]]}", True),
        ("{type: nonlinear, between: [hand, m], force_over_velocity: [[-0.1, 2], [0.1, -2]]}", False),
        ("{type: friction, between: [hand, m], force: 1, stiffness: 500, damping: 1}", True),
        ("{type: plectrum, between: [hand, m], stiffness: 500, damping: 1, release: 0.01}", True),
    ],
)
def test_a_link_to_a_mass_is_predicted_for_small_motions_and_what_was_assumed_is_stated(
    link: str, stable: bool
) -> None:
    cell = "  m: {type: cell, mass: 0.05, stiffness: 50, damping: 0.5}\n"
    prediction = predict(
        parse_scene(f"{HEAD}{cell}  it: {link}\n  hold: {{type: spring, between: [hand, wall], stiffness: 9}}\n")
    )
    (sentence,) = prediction.assumptions
    assert sentence.startswith("it ")
    assert prediction.stable == stable
