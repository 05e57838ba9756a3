"""The pitches at which a scene's pick-ups ring, before it runs."""

from __future__ import annotations

import numpy as np

from hapsim.prediction.predict import Prediction, predict
from hapsim.scene import Buffer, Click, Friction, Plectrum, Scene
from hapsim.scene.part import Table

_LETS_GO = (Buffer, Plectrum, Click, Friction)  # what excites a sound, and lets it ring
_LOWEST_HZ = 20.0
_MOST_DAMPED = 0.1  # of critical: what is damped more is a thud
_LEAST_SHARE = 1e-4  # of the largest energy that a motion has at the pick-up's point


def partials_of(scene: Scene, prediction: Prediction | None = None) -> dict[str, tuple[float, ...]]:
    """Each pick-up's partials in Hz, rising: the frequencies at which what it listens to swings once contacts, plectra
    and friction have released it. Of a large scene the lowest ones. `prediction`: that of the scene, if it is made."""
    held = {name: one for name, one in scene.modules.items() if not isinstance(one, _LETS_GO)}
    if prediction is None or not prediction.is_released(scene.modules.keys() - held.keys()):
        prediction = predict(scene.model_copy(update={"modules": Table(held)}), with_margins=False)
    rings = [one for one in prediction.modes if one.damping_ratio < _MOST_DAMPED and one.frequency_hz > _LOWEST_HZ]
    number = {name: i for i, name in enumerate(prediction.points)}
    found = {}
    for name, pick_up in scene.sound.items():
        shares = np.array([one.participation[number[pick_up.point]] for one in rings])
        heard = shares > _LEAST_SHARE * shares.max(initial=0.0)
        found[name] = tuple(sorted(one.frequency_hz for one, is_heard in zip(rings, heard, strict=True) if is_heard))
    return found
