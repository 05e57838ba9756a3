"""Contacts that are a hand's only links, under a predictor: what is said is what is felt and what a push meets."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.prediction import predict, robustness_of
from hapsim.scene import Scene, parse_scene
from tests.one_hand import document_of, touch


def random_contact(seed: int) -> dict[str, Any]:
    draw = np.random.default_rng(seed)
    rate, mass = float(draw.choice([500.0, 1000.0, 2000.0])), float(draw.uniform(0.1, 0.4))
    stiffness = mass * rate**2 * float(10.0 ** draw.uniform(-3.5, -1.0))
    contact = touch(stiffness, float(draw.uniform(0.3, 1.2)) * np.sqrt(stiffness * mass), "buffer")
    device = {
        "mass": mass,
        "friction": float(draw.uniform(0.2, 2.0)),
        "delay": float(draw.choice([0.0, 0.5, 1.0, 2.0])),
        "hold": str(draw.choice(["zoh", "ramp", "impulse"])),
        "sampling": str(draw.choice(["ideal", "average"])),
        "force_limit": 50.0,
        "correction": "predictor",
    }
    return document_of({"stop": contact}, rate=rate, device=device, mock={"quantum": 5e-11})


def scene_of(document: dict[str, Any], **mock: Any) -> Scene:
    return parse_scene(json.dumps(document | {"mock": document["mock"] | mock}))


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("seed", range(8))
def test_a_contact_feels_as_predicted(seed: int) -> None:
    document = random_contact(seed)
    prediction = predict(scene_of(document), with_margins=False)
    (felt,), (desired,) = prediction.felt, prediction.desired
    assert prediction.stable
    static = robustness_of(felt).steady_stiffness
    if desired.reached:
        wanted = document["modules"]["stop"]
        assert (felt.k, static) == pytest.approx((wanted["stiffness"],) * 2, rel=1e-6)
        assert felt.b == pytest.approx(wanted["damping"] + document["device"]["friction"], rel=1e-6)
    pressed = hapsim.run(scene_of(document, hand={"force": -5.0}), duration=3.0)
    assert -5.0 / pressed.position[-100:, 0].mean() == pytest.approx(static, rel=1e-4)
    if felt.dominant:
        measured = hapsim.measure(scene_of(document), at=-5.0 / static)
        assert (measured.k, measured.b) == pytest.approx((felt.k, felt.b), rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_a_contact_trembles_with_a_mass_outside_of_the_stated_range(seed: int) -> None:
    document = random_contact(100 + seed)
    (felt,) = predict(scene_of(document), with_margins=False).felt
    static, _, (least, _), _ = robustness_of(felt)
    for factor, holds in ((0.94, False), (1.06, True)):
        if least > 0.0:  # it begins pressed: a hand that bounces off trembles at other masses too
            mock = {"mass": least * factor, "hand": {"force": -5.0}, "initial": {"position": -5.0 / static}}
            pressed = hapsim.run(scene_of(document, **mock), duration=3.0)
            assert bool(pressed.position[-100:, 0].std() < 1e-7) is holds
