"""The schemes, where the kernel has no part in them; and that a prediction is for the scene's own."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from hapsim.prediction import predict, surely_shaken_by, warnings_about
from hapsim.scene import Scene, parse_scene
from hapsim.theory.schemes import SCHEMES

sys.path.insert(0, str(Path(__file__).parents[1]))
from scheme_formulas import spectral_radius, step_matrix, stiffness_limit

T = 1e-3


def scene(scheme: str, modules: str) -> Scene:
    return parse_scene(
        f"version: 1\nrate: 1000\nscheme: {scheme}\ndevice: {{mass: 0.2}}\nmodules:\n"
        f"  hand: {{type: device, channel: 0}}\n  wall: {{type: ground}}\n{modules}"
    )


SPRING = "  l: {type: viscoelastic, between: [m, wall], stiffness: 1e6, damping: 1}\n"
MASS = "  m: {type: mass, mass: 0.1}\n" + SPRING
CELL = "  m: {type: cell, mass: 0.1, stiffness: 1e6, damping: 1}\n"
STRING = "  m: {type: string, masses: 2, mass: 0.1, stiffness: 1e6, damping: 1}\n"
TOUCH = "  touch: {type: viscoelastic, between: [hand, wall], stiffness: 100, damping: 1}\n"


@pytest.mark.parametrize("moved", [MASS, CELL, STRING], ids=["mass", "cell", "string"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_prediction_is_for_the_scheme_by_which_the_scene_runs(scheme: str, moved: str) -> None:
    """1e6 N/m are beyond what explicit schemes stand, and no others."""
    stiff = scene(scheme, moved + TOUCH)
    predicted = predict(stiff)
    warnings = warnings_about(stiff, predicted)
    assert predicted.assumptions == ()
    assert predicted.by_its_scheme
    if scheme in ("midpoint", "exact"):
        assert predicted.stable
        assert warnings == []
    else:
        assert not predicted.stable
        assert any(one.startswith("the scene is predicted unstable") for one in warnings)
    hands = predict(scene(scheme, TOUCH)).poles
    of_the_object = max(abs(pole) for pole in predicted.poles if all(abs(pole - hand) > 1e-9 for hand in hands))
    assert of_the_object == pytest.approx(radius_of(scheme, moved), abs=1e-12)


def radius_of(scheme: str, moved: str) -> float:
    """Returns the spectral radius of the object alone, by the scheme's matrix."""
    rows = np.array([[2.0, -1.0], [-1.0, 2.0]]) if moved == STRING else np.eye(1)
    return spectral_radius(step_matrix(scheme, np.full(len(rows), 0.1), 1e6 * rows, rows, T))


@pytest.mark.parametrize("scheme", ["cordis", "semi_implicit", "rk4"])
def test_a_spring_s_margin_is_its_scheme_s_limit(scheme: str) -> None:
    soft = scene(scheme, MASS.replace("1e6", "1e4") + TOUCH)
    factors = {margin.name: margin.stiffness_factor for margin in predict(soft).margins}
    assert factors["l"] == pytest.approx(stiffness_limit(scheme, 0.1, 1.0, T) / 1e4, rel=1e-8)


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
def test_a_spring_inside_has_no_limit(scheme: str) -> None:
    soft = scene(scheme, MASS.replace("1e6", "1e4") + TOUCH)
    factors = {margin.name: margin for margin in predict(soft).margins}
    assert (factors["l"].stiffness_factor, factors["l"].damping_factor) == (np.inf, np.inf)
    assert 1.0 < factors["touch"].stiffness_factor < np.inf


def test_what_is_not_computed_is_reported() -> None:
    """Springs so stiff that each of 600 masses moves all others within one sample."""
    string = "  s: {type: string, masses: 600, mass: 0.001, stiffness: 1e12}\n"
    stiff = scene("exact", string + TOUCH)
    predicted = predict(stiff, with_margins=False)
    assert not predicted.by_its_scheme
    assert "under exact" in predicted.assumptions[0]
    assert "too fast for the rate" in predicted.assumptions[0]
    assert "the scene runs with scheme: exact" in warnings_about(stiff, predicted)[-1]
    assert surely_shaken_by(stiff) is None
