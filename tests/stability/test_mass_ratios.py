"""Masses a million times apart in one scene: the predicted limit is that of the lightest."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from hapsim import predict
from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))
from hands import hand_scene


def link(first: str, second: str, stiffness: float, damping: float = 0.0) -> dict[str, Any]:
    return {"type": "viscoelastic", "between": [first, second], "stiffness": stiffness, "damping": damping}


def scene_of(ratio: float, factor: float, damping: float) -> Scene:
    """A hand of 0.2 kg on a mass of 1/ratio kg, that one on a mass of 1 kg, and all on the wall."""
    light = 1.0 / ratio
    unit = light * 1e6  # m/T² of the lightest
    modules = {
        "mote": {"type": "mass", "mass": light},
        "rock": {"type": "mass", "mass": 1.0, "velocity": 0.01},
        "touch": link("hand", "mote", 0.3 * unit, damping * unit * 1e-3),
        "held": link("mote", "rock", factor * unit, damping * unit * 1e-3),
        "stand": link("rock", "wall", 1000.0, 0.5),
    }
    return hand_scene(modules, device={"mass": 0.2, "friction": 0.5, "delay": 1.0, "force_limit": 1000.0})


@pytest.mark.parametrize("damping", [0.02, 0.3])
def test_the_limit_is_the_motes_own_whatever_it_stands_between(damping: float) -> None:
    """K + 2 B/T < 4 m/T², of all that is tied to the mote: the hand and the rock stand still to it."""
    (margin,) = (one for one in predict(scene_of(1e6, 1.0, damping)).margins if one.name == "held")
    assert 0.3 + margin.stiffness_factor + 2.0 * (2.0 * damping) == pytest.approx(4.0, rel=3e-6)
