"""What the hand would feel with other values, and the K,B plane around them; nothing is applied."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from hapsim.errors import UsageError
from hapsim.prediction import Felt, predict
from hapsim.running.changes import changed
from hapsim.running.parameters import Parameter, changes_from
from hapsim.scene import Scene
from hapsim.theory import Configuration

_POINTS = 120  # of the boundary
_LITTLE = 1e-6  # of m/T²: a hand without a spring is at the boundary itself
_FIELDS = ("name", "channel", "k", "b", "frequency_hz", "damping_ratio", "stable", "dominant", "passive")


def predicted(
    scene: Scene, parameters: Mapping[str, Parameter], values: Mapping[str, Any], hand: int, with_plane: bool
) -> dict[str, Any]:
    """Returns the fields of `predicted` for the scene with these values of its parameters. `hand`: whose plane. Raises
    UsageError where a value is wrong."""
    wanted = changed(scene, changes_from(values, parameters)) if values else scene
    prediction = predict(wanted, with_margins=False)
    felt = prediction.felt
    found: dict[str, Any] = {
        "stable": prediction.stable,
        "spectral_radius": prediction.spectral_radius,
        "hands": [_of_hand(one) for one in felt],
        "why": dict(prediction.coupled),
        "wire_delay": prediction.wire_delay,
    }
    if with_plane and felt:
        if not 0 <= hand < len(felt):
            raise UsageError(f"hand: found {hand}, expected 0 to {len(felt) - 1}")
        found["plane"] = None if felt[hand].predictor is not None else _boundary(felt[hand].configuration)
    return found


def _of_hand(felt: Felt) -> dict[str, Any]:
    least, most = felt.stable_damping
    margins = {"stiffness_factor": felt.stiffness_factor, "stable_damping": (least, most)}
    return {name: getattr(felt, name) for name in _FIELDS} | {"K": felt.stiffness, "B": felt.damping} | margins


@lru_cache(maxsize=64)
def _boundary(configuration: Configuration) -> dict[str, Any]:
    """Returns the stable interval of K over B, which depends on the hand and the device alone: B (n,) in N·s/m, from 0
    to where no K above 0 is stable; `least` and `most` (n,) in N/m."""
    most_damping = float(configuration.stable_damping(_LITTLE * configuration.stiffness_unit)[1])
    if not (math.isfinite(most_damping) and most_damping > 0.0):
        return {"B": [], "least": [], "most": []}
    damping = np.linspace(0.0, most_damping, _POINTS)
    least, most = configuration.stable_stiffness(damping)
    return {"B": damping.tolist(), "least": np.asarray(least).tolist(), "most": np.asarray(most).tolist()}
