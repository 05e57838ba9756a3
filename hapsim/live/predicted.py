"""Felt values of a hand with other values of a run's parameters: the answer to `predict`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from hapsim.documents import pick
from hapsim.errors import UsageError
from hapsim.live.messages import Predict
from hapsim.live.views import Near, curve_of, near
from hapsim.prediction import Felt, Part, Prediction, predict
from hapsim.prediction.felt_mass import felt_sentence
from hapsim.running.changed_scene import changed
from hapsim.running.live_parameters import Parameter, by_part, changes_from
from hapsim.scene import Scene
from hapsim.scene.input_states import off_words, used_inputs
from hapsim.theory import Configuration

_POINTS = 120  # of the boundary
_LITTLE = 1e-6  # of m/T²: a hand without a spring is at the boundary itself
_FIELDS = ("name", "channel", "k", "b", "frequency_hz", "damping_ratio", "stable", "dominant", "passive")


def predicted(
    scene: Scene, parameters: Mapping[str, Parameter], asked: Predict, words: Mapping[str, int] | None = None
) -> dict[str, Any]:
    """Returns the fields of `predicted`. `words`: values of the inputs now, by "inputs.touch" [default: each is on].
    Raises UsageError where a value is wrong."""
    wanted = changed(scene, by_part(changes_from(asked.values, parameters), scene)) if asked.values else scene
    on = frozenset(name for name in wanted.inputs if (words or {}).get(f"inputs.{name}", 1))
    off = [name for name in used_inputs(wanted) if name not in on]
    wanted = wanted.with_inputs(on) if off else wanted
    found = _in_plane(wanted, asked.at) if wanted.space > 1 else _on_a_line(wanted, asked)
    return found | {"inputs": off_words(off)}


def _on_a_line(wanted: Scene, asked: Predict) -> dict[str, Any]:
    prediction = _predicted(wanted)
    at = {name: asked.at[one.channel] for name, one in wanted.device_points.items() if one.channel < len(asked.at)}
    parts = [(part, part.alone) for part in prediction.parts if part.alone]
    hands = [(part.asked, alone, near(prediction, part, at)) for part, alone in parts]
    felt = [one if about is None else about.regions[about.number].felt for _, one, about in hands]
    found: dict[str, Any] = {
        "stable": prediction.stable,
        "states": prediction.states.words if prediction.stable_as_taken else "",
        "contacts": prediction.contacts_at(dict.fromkeys(wanted.device_points, 0.0) | at),
        "spectral_radius": prediction.spectral_radius,
        "hands": [_of_hand(one, asked, about) for one, (asked, _, about) in zip(felt, hands, strict=True)],
        "felt": [one for part in prediction.parts if part.alone is None for one in _felt(part)],
        "why": prediction.coupled | _masses(prediction),
        "wire_delay": prediction.wire_delay,
    }
    if (asked.plane or asked.curve) and felt:
        if asked.hand >= len(felt):
            raise UsageError(f"hand: found {asked.hand}, expected 0 to {len(felt) - 1}")
        chosen = felt[asked.hand]
        if asked.plane:
            found["plane"] = None if chosen.predictor is not None else _boundary(chosen.configuration)
        if asked.curve:
            found["curve"] = curve_of(wanted, chosen.name, hands[asked.hand][2])
    return found


def _masses(prediction: Prediction) -> dict[str, str]:
    """Returns what each hand feels of its simulated mass in admittance, in words; empty in impedance."""
    units_of = prediction.scene.units_of
    return {one.name: felt_sentence(one, units_of(one.channel)) for one in prediction.felt_masses}


@lru_cache(maxsize=4)
def _predicted(scene: Scene) -> Prediction:
    return predict(scene, with_margins=False)


def _in_plane(scene: Scene, at: Sequence[float]) -> dict[str, Any]:
    """Returns the fields of `predicted` in the plane, with the first hand at these positions of the channels. Whether
    the scene is stable elsewhere does not depend on them."""
    from hapsim.prediction.predict_plane import PlanePrediction

    x, y = scene.channel_groups[0]
    here = PlanePrediction(scene, (at[x], at[y]) if len(at) > max(x, y) else None, with_margins=False)
    return {
        "stable": (whole := _predicted(scene)).stable,
        "verdict": here.verdict_here,
        "states": whole.states.words if whole.states.growing else "",
        "contacts": ", ".join(f"{one.name} is {one.state}" for one in here.links if one.acts and one.state),
        "spectral_radius": here.spectral_radius_here,
        "hands": [],
        "felt": [one for part in here.parts for one in _felt(part)],
        "slides": [one._asdict() for one in here.slides],
        "wire_delay": here.wire_delay,
    }


def _of_hand(felt: Felt, asked: tuple[float, float], about: Near | None) -> dict[str, Any]:
    own, place = (felt.configuration.stiffness, felt.configuration.friction), None
    if about is not None:
        region = about.regions[about.number]
        piece, shift = region.piece, about.shift
        asked = piece.stiffness + own[0], piece.damping + own[1]
        place = {
            "low_m": piece.low + shift,
            "high_m": piece.high + shift,
            "kind": region.kind,
            "stable": region.is_stable,
        }
        place["snap_energy_j"] = region.snap_energy
    margins = {"stiffness_factor": felt.stiffness_factor, "stable_damping": felt.stable_damping}
    scene = {"K": felt.stiffness, "B": felt.damping, "asked": asked, "own": own, "region": place}
    return {name: getattr(felt, name) for name in _FIELDS} | scene | margins


def _felt(part: Part) -> Iterator[dict[str, Any]]:
    """Yields k and b of each hand along its coordinate, or along its principal directions, with other hands held."""
    for one in part.rows:
        if not one.of:
            yield pick(one, "hand angle_deg k b") | {"is_held": len(part.hands) > 1}


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
