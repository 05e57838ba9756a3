"""What is known of the schemes, where the kernel has no part in it; and that a prediction is for the scene's own."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.prediction import predict, surely_shaken_by, warnings_about
from hapsim.scene import Scene, parse_scene
from hapsim.theory.schemes import SCHEMES, spectral_radius

M, T = 0.3, 1e-3


def radius(scheme: str, stiffness: float, damping: float) -> float:
    step = SCHEMES[scheme].step(np.array([M]), np.array([[stiffness]]), np.array([[damping]]), T)
    return spectral_radius(step)


@pytest.mark.parametrize("share", [0.02, 0.5, 1.0, 1.8])
@pytest.mark.parametrize("scheme", ["cordis", "semi_implicit", "rk4"])
def test_the_limit_is_where_the_spectral_radius_is_one(scheme: str, share: float) -> None:
    """`share`: B T/m."""
    damping = share * M / T
    limit = SCHEMES[scheme].stiffness_limit(M, damping, T)
    assert radius(scheme, limit, damping) == pytest.approx(1.0, abs=1e-9)
    assert radius(scheme, 0.999 * limit, damping) < 1.0 < radius(scheme, 1.001 * limit, damping)
    assert all(radius(scheme, part * limit, damping) < 1.0 for part in np.linspace(0.01, 0.99, 50))


@pytest.mark.parametrize("share", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
def test_what_has_no_limit_is_stable_at_any_stiffness(scheme: str, share: float) -> None:
    damping = share * M / T
    assert SCHEMES[scheme].stiffness_limit(M, damping, T) == np.inf
    for stiffness in np.geomspace(1.0, 1e11, 12):
        assert radius(scheme, stiffness, damping) <= 1.0 + 1e-9


def test_closed_forms() -> None:
    assert SCHEMES["cordis"].stiffness_limit(M, 0.0, T) == pytest.approx(4.0 * M / T**2)
    assert SCHEMES["cordis"].stiffness_limit(M, 2.0 * M / T, T) == 0.0
    assert SCHEMES["rk4"].stiffness_limit(M, 0.0, T) == pytest.approx(8.0 * M / T**2)
    assert SCHEMES["rk4"].stiffness_limit(M, 5.58 * M / T, T) == 0.0
    just_below_twice_the_real_limit = SCHEMES["rk4"].stiffness_limit(M, 5.57 * M / T, T)
    assert just_below_twice_the_real_limit == pytest.approx(2.785293563405282**2 * M / T**2, rel=0.02)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_frequency_is_the_expansion_s(scheme: str) -> None:
    one = SCHEMES[scheme]
    for angle in (0.02, 0.04):
        step = one.step(np.array([M]), np.array([[M * (angle / T) ** 2]]), np.zeros((1, 1)), T)
        found = float(np.angle(np.linalg.eigvals(step)).max())
        assert found / angle - 1.0 == pytest.approx(one.error * angle**one.order, rel=2e-3, abs=1e-13)


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
        assert warnings[0].startswith("the scene is predicted unstable")
    hands = predict(scene(scheme, TOUCH)).poles
    of_the_object = max(abs(pole) for pole in predicted.poles if all(abs(pole - hand) > 1e-9 for hand in hands))
    assert of_the_object == pytest.approx(radius_of(scheme, moved), abs=1e-12)


def radius_of(scheme: str, moved: str) -> float:
    """Of the object alone, by the scheme's matrix."""
    if moved == STRING:
        rows = np.array([[2.0, -1.0], [-1.0, 2.0]])
        return spectral_radius(SCHEMES[scheme].step(np.full(2, 0.1), 1e6 * rows, rows, T))
    return spectral_radius(SCHEMES[scheme].step(np.array([0.1]), np.array([[1e6]]), np.array([[1.0]]), T))


@pytest.mark.parametrize("scheme", ["cordis", "semi_implicit", "rk4"])
def test_a_spring_s_margin_is_its_scheme_s_limit(scheme: str) -> None:
    soft = scene(scheme, MASS.replace("1e6", "1e4") + TOUCH)
    factors = {margin.name: margin.stiffness_factor for margin in predict(soft).margins}
    assert factors["l"] == pytest.approx(SCHEMES[scheme].stiffness_limit(0.1, 1.0, T) / 1e4, rel=1e-8)


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
def test_a_spring_inside_has_no_limit(scheme: str) -> None:
    soft = scene(scheme, MASS.replace("1e6", "1e4") + TOUCH)
    factors = {margin.name: margin for margin in predict(soft).margins}
    assert (factors["l"].stiffness_factor, factors["l"].damping_factor) == (np.inf, np.inf)
    assert 1.0 < factors["touch"].stiffness_factor < np.inf


def test_what_is_not_worked_out_is_said() -> None:
    """Damping on one of so many masses joins their modes."""
    long = "  s: {type: string, masses: 600, mass: 0.001, stiffness: 100}\n"
    brake = "  b: {type: damper, between: [s.3, wall], damping: 0.1}\n"
    joined = scene("exact", long + brake + TOUCH)
    predicted = predict(joined, with_margins=False)
    assert not predicted.by_its_scheme
    assert "under exact" in predicted.assumptions[0]
    assert "damping joins the modes of its 600 masses" in predicted.assumptions[0]
    assert "not for exact" in warnings_about(joined, predicted)[0]
    assert surely_shaken_by(joined) is None
