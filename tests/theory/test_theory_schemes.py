"""What is known of the schemes, where the kernel has no part in it; and that a prediction says which it is for."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.prediction import predict, warnings_about
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


MASS = "  m: {type: mass, mass: 0.1}\n  l: {type: viscoelastic, between: [m, wall], stiffness: 1e6, damping: 1}\n"
CELL = "  m: {type: cell, mass: 0.1, stiffness: 1e6, damping: 1}\n"
STRING = "  m: {type: string, masses: 2, mass: 0.1, stiffness: 1e6, damping: 1}\n"
TOUCH = "  touch: {type: viscoelastic, between: [hand, wall], stiffness: 100, damping: 1}\n"


@pytest.mark.parametrize("moved", [MASS, CELL, STRING], ids=["mass", "cell", "string"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_prediction_says_where_it_is_for_another_scheme(scheme: str, moved: str) -> None:
    stiff = scene(scheme, moved + TOUCH)
    warnings, assumptions = warnings_about(stiff, predict(stiff)), predict(stiff).assumptions
    if scheme in ("cordis", "semi_implicit"):
        assert assumptions == ()
        assert warnings[0].startswith("the scene is predicted unstable")
    else:
        assert f"under {scheme}" in assumptions[0]
        assert f"not for {scheme}" in warnings[0]
    alone = scene(scheme, TOUCH)
    assert predict(alone).assumptions == ()
    assert warnings_about(alone, predict(alone)) == []
