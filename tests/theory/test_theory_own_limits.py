"""Modules beyond what CORDIS's scheme carries, against the poles of random scenes."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest

from hapsim.prediction import predict, warnings_about
from hapsim.prediction.warnings import own_limits
from hapsim.scene import Scene, parse_scene


def random_document(draw: np.random.Generator) -> dict[str, Any]:
    """A hand beside a string, a membrane and two masses on links and cells, each about as stiff as its masses carry."""
    rate, substeps = float(draw.choice([500.0, 1000.0, 3000.0])), int(draw.integers(1, 9))
    mass = float(10.0 ** draw.uniform(-4, -1))
    most = mass * (rate * substeps) ** 2

    def held(share: float) -> dict[str, float]:
        stiffness = most * share * float(10.0 ** draw.uniform(-1.0, 0.5))
        kind = int(draw.integers(3))
        damping = [0.01 * np.sqrt(stiffness * mass), 0.3 * most * share / (rate * substeps), 0.0][kind]
        return {"stiffness": [stiffness, 0.01 * stiffness, stiffness][kind], "damping": float(damping)}

    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    if draw.random() < 0.5:
        modules["gut"] = {"type": "string", "masses": int(draw.integers(2, 30)), "mass": mass} | held(0.6)
    if draw.random() < 0.3:
        modules["skin"] = {"type": "membrane", "rows": 4, "columns": 5, "mass": mass} | held(0.3)
    modules["a"], modules["b"] = ({"type": "mass", "mass": mass} for _ in "ab")
    modules["back"] = {"type": "viscoelastic", "between": ["wall", "a"]} | held(1.5)
    modules["tie"] = {"type": "viscoelastic", "between": ["a", "b"]} | held(0.9)
    if draw.random() < 0.5:
        modules["c"] = {"type": "cell", "mass": mass} | held(2.0)
        modules["on"] = {"type": "viscoelastic", "between": ["b", "c"]} | held(0.9)
    if "gut" in modules and draw.random() < 0.5:
        modules["bridge"] = {"type": "viscoelastic", "between": ["gut.1", "b"]} | held(0.5)
    device = {"clock": "lockstep", "mass": 0.2, "friction": 1.0}
    return {"version": 1, "rate": rate, "substeps": substeps, "device": device, "modules": modules}


def stable(document: dict[str, Any], **changed: Any) -> bool:
    scene: Scene = parse_scene(json.dumps(document | changed))
    return predict(scene, with_margins=False).spectral_radius <= 1.0 + 1e-7


@pytest.mark.thorough(keep=10)
@pytest.mark.parametrize("seed", range(40))
def test_a_limit_is_named_where_the_poles_pass_it_and_the_substeps_carry_the_scene(seed: int) -> None:
    document = random_document(np.random.default_rng(seed))
    scene = parse_scene(json.dumps(document))
    found = list(own_limits(scene))
    assert bool(found) is not stable(document)
    for sentence in found:
        name, value, unit = re.match(r"(\w+): (\S+) (N/m|N·s/m) is", sentence).groups()  # type: ignore[union-attr]
        key = "stiffness" if unit == "N/m" else "damping"
        assert float(value) == pytest.approx(document["modules"][name][key], rel=1e-5)
        (steps,) = re.findall(r"use (\d+) substeps", sentence)
        assert stable(document, substeps=int(steps))
        assert not stable(document, substeps=int(steps) - 1)
    if found:
        assert found[0] in warnings_about(scene, predict(scene, with_margins=False))


@pytest.mark.parametrize("damper", ["backward", "centred", "filtered"])
def test_a_mass_on_a_soft_spring_is_within_its_limit_by_whatever_damper(damper: str) -> None:
    back = {"type": "viscoelastic", "between": ["wall", "a"], "stiffness": 200.0, "damping": 1.0, "damper": damper}
    back |= {"cutoff": 50.0} if damper == "filtered" else {}
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "back": back}
    document = {"version": 1, "rate": 1000.0, "device": {"clock": "lockstep", "mass": 0.2, "friction": 1.0}}
    document |= {"modules": modules | {"a": {"type": "mass", "mass": 0.1}}}
    assert stable(document)
    assert list(own_limits(parse_scene(json.dumps(document)))) == []
