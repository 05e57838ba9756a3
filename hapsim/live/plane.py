"""What the hand would feel with other values, and the K,B plane around them; nothing is applied."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from hapsim.errors import UsageError
from hapsim.live.messages import Predict
from hapsim.prediction import Felt, FeltTogether, Prediction, Region, predict
from hapsim.running.changes import changed
from hapsim.running.parameters import Parameter, changes_from
from hapsim.scene import Scene
from hapsim.theory import Configuration

_POINTS = 120  # of the boundary
_LITTLE = 1e-6  # of m/T²: a hand without a spring is at the boundary itself
_FIELDS = ("name", "channel", "k", "b", "frequency_hz", "damping_ratio", "stable", "dominant", "passive")


def predicted(scene: Scene, parameters: Mapping[str, Parameter], asked: Predict) -> dict[str, Any]:
    """Returns the fields of `predicted`. Raises UsageError where a value is wrong."""
    wanted = changed(scene, changes_from(asked.values, parameters)) if asked.values else scene
    prediction = _predicted(wanted)
    at = {name: asked.at[one.channel] for name, one in wanted.device_points.items() if one.channel < len(asked.at)}
    here = prediction.region_here
    here |= {name: _region_at(prediction, name, at[name]) for name in here.keys() & at.keys()}
    felt = [here[one.name].felt if one.name in here else one for one in prediction.felt]
    found: dict[str, Any] = {
        "stable": prediction.stable,
        "states": prediction.states.words if prediction.stable_as_taken else "",
        "contacts": prediction.contacts_at(dict.fromkeys(wanted.device_points, 0.0) | at),
        "spectral_radius": prediction.spectral_radius,
        "hands": [_of_hand(one, prediction.asked_for(one), here.get(one.name)) for one in felt],
        "together": [_of_hands(one) for one in prediction.together if not one.felt.reason],
        "why": dict(prediction.coupled),
        "wire_delay": prediction.wire_delay,
    }
    if asked.plane and felt:
        if asked.hand >= len(felt):
            raise UsageError(f"hand: found {asked.hand}, expected 0 to {len(felt) - 1}")
        chosen = felt[asked.hand]
        found["plane"] = None if chosen.predictor is not None else _boundary(chosen.configuration)
    return found


@lru_cache(maxsize=4)
def _predicted(scene: Scene) -> Prediction:
    return predict(scene, with_margins=False)


def _region_at(prediction: Prediction, name: str, x: float) -> Region:
    """The region of this hand at x m, friction stuck; on an edge the stiffer one, beyond the travel the last."""
    regions = [one for one in prediction.regions_of(name, x) if not one.piece.sliding]
    x = min(max(x, regions[0].piece.low), regions[-1].piece.high)
    return max((one for one in regions if one.piece.low <= x <= one.piece.high), key=lambda one: one.piece.stiffness)


def _of_hand(felt: Felt, asked: tuple[float, float], region: Region | None) -> dict[str, Any]:
    own, place = (felt.configuration.stiffness, felt.configuration.friction), None
    if region is not None:
        piece = region.piece
        asked = piece.stiffness + own[0], piece.damping + own[1]
        place = {"low_m": piece.low, "high_m": piece.high, "kind": region.kind, "stable": region.is_stable}
    margins = {"stiffness_factor": felt.stiffness_factor, "stable_damping": felt.stable_damping}
    scene = {"K": felt.stiffness, "B": felt.damping, "asked": asked, "own": own, "region": place}
    return {name: getattr(felt, name) for name in _FIELDS} | scene | margins


def _of_hands(one: FeltTogether) -> dict[str, Any]:
    """k and b of each of these hands, the others held."""
    return {"names": one.names, "k": np.diag(one.felt.k).tolist(), "b": np.diag(one.felt.b).tolist()}


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
