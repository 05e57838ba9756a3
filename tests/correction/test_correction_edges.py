"""Corrections at the edges: what moves freely, what has no stiffness, contacts alone, delays that are long."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hapsim import predict
from hapsim.prediction.correction import CORRECTIONS, rendered
from hapsim.prediction.correction.element import element_for
from hapsim.prediction.felt_alone import SHARES, Tolerances
from hapsim.scene import Scene
from hapsim.theory import Configuration
from tests import one_hand

SPAN = {"from": 0.1, "to": 0.4}


def scene_of(modules: dict[str, Any], correction: str, **device: Any) -> Scene:
    return one_hand.scene_of(modules, device={"correction": correction} | device)


@pytest.mark.parametrize("correction", ["poles", "predictor"])
@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_two_hands_that_hold_only_each_other_swing_as_in_the_scene(correction: str, friction: float) -> None:
    """Their common motion comes back from nowhere: it is no mode of the link."""
    modules = {
        "other": {"type": "device", "channel": 1},
        "tie": {"type": "viscoelastic", "between": ["hand", "other"], "stiffness": 2000.0, "damping": 2.0},
    }
    prediction = predict(scene_of(modules, correction, friction=friction), with_margins=False)
    stiffness, damping, reduced = 2000.0, 2.0 + friction / 2.0, 0.1
    decay = damping / (2.0 * reduced)
    swing = np.sqrt(stiffness / reduced - decay**2)
    expected = np.exp(complex(-decay, swing) / 1000.0)
    assert min(abs(pole - expected) for pole in prediction.poles) < 1e-7


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("correction", ["poles", "predictor"])
def test_a_damper_alone_keeps_its_damping_over_a_span(correction: str) -> None:
    damper = {"touch": {"type": "damper", "between": ["hand", "wall"], "damping": 5.0}}
    (port,) = rendered(scene_of(damper, correction, mass=SPAN)).ports
    assert port.made_for == (SPAN["from"] if correction == "predictor" else pytest.approx(0.2))
    kind = CORRECTIONS[correction]
    model = replace(port.declared, mass=port.made_for)
    for mass in np.geomspace(0.1, 0.4, 7):
        loop = kind.closed(replace(port.declared, mass=float(mass)), model, port.element.observer)
        k, b = loop.equivalent(*port.rendered)
        assert k == pytest.approx(0.0, abs=1e-3)
        assert b == pytest.approx(6.0, rel=0.05)


def test_a_contact_alone_has_the_predictor_that_it_was_searched_for() -> None:
    """The predictor is made for the least mass. The prediction is that of the touching hand, and the scene is stable
    without touch."""
    contact = {"touch": {"type": "buffer", "between": ["hand", "wall"], "stiffness": 9000.0, "damping": 30.0}}
    scene = scene_of(contact, "predictor", mass=SPAN, friction=0.0)
    (port,) = rendered(scene).ports
    assert port.made_for == SPAN["from"]
    prediction = predict(scene, with_margins=False)
    assert prediction.stable
    assert [(one.kind, one.is_stable) for one in prediction.regions["hand"]] == [("held", True), ("free", True)]
    assert (prediction.desired[0].k, prediction.desired[0].b) == (9000.0, 30.0)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("correction", ["poles", "predictor"])
def test_a_long_delay_is_searched_for_more_coarsely(correction: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The search's work, the cube of the number of poles in all, stays bounded."""
    work = 0
    eigenvalues = np.linalg.eigvals

    def counted(matrices: Any) -> Any:
        nonlocal work
        work += matrices[..., 0, 0].size * matrices.shape[-1] ** 3
        return eigenvalues(matrices)

    monkeypatch.setattr(np.linalg, "eigvals", counted)
    declared = Configuration(mass=0.2, rate=1000.0, friction=1.0, delay=20.0)
    element_for(CORRECTIONS[correction], declared, (0.1, 0.4), (3000.0, 10.0))
    assert 0 < work < 6e8


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("correction", ["poles", "predictor", "sensed"])
@pytest.mark.parametrize("friction", [0.42, 0.69, 0.72, 1e-12, 1e-9])
def test_a_tolerance_that_reaches_no_friction_at_all_is_one(correction: str, friction: float) -> None:
    """With these, b0 - b (b0/b) is below 0 by rounding."""
    touch = {"touch": {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 1000.0, "damping": 10.0}}
    sensors = ["velocity", "acceleration"] if correction == "sensed" else []
    part = predict(scene_of(touch, correction, friction=friction, sensors=sensors), with_margins=False).parts[0]
    assert part.alone is not None
    for share in SHARES:
        least, most = Tolerances(part.alone, *part.asked).of("friction", share) or (math.nan, math.nan)
        assert 0.0 <= least <= friction <= most
