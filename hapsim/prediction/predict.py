"""Prediction: the stiffness and damping that a scene's hand will feel, from mathematics alone, without a run and
without compilation."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from functools import lru_cache

import numpy as np

from hapsim.errors import UsageError
from hapsim.prediction.felt_alone import Felt, swing
from hapsim.prediction.predict_plane import PlanePrediction
from hapsim.prediction.predict_ports import PortsPrediction
from hapsim.prediction.prediction import Places, Prediction
from hapsim.prediction.swings import Shaking
from hapsim.prediction.timing import PACED, wire_of, wire_time_of, with_wire_delay
from hapsim.scene import Buffer, Click, Friction, Link, Plectrum, Scene
from hapsim.scene.load import SceneSource, as_scene
from hapsim.scene.section import Table

_EXCITERS = (Buffer, Plectrum, Click, Friction)  # links that excite a sound and release its source
_LOWEST_HZ = 20.0  # of a partial
_MOST_DAMPED = 0.1  # of critical; with more damping it is a thud
_LEAST_SHARE = 1e-4  # of the largest energy that a motion has at the pick-up's point


def predict(scene: SceneSource, *, with_margins: bool = True, at: Places = None) -> Prediction:
    """Returns the prediction for `scene`: the felt stiffness and damping, the stability of the whole, and the time on
    the wire. `scene`: a Scene, or the path of a scene file. `with_margins`: also each link's gain margin, which for a
    large scene takes longer than the rest. `at`: the position of the hands in m [default: where they rest, or are held
    nearest to position 0]; with space: 2, x and y of the first hand, or those of hands by name [default: where they
    start]. UsageError if that is beyond the travel. Of a scene of several devices it is a `PortsPrediction`."""
    prediction = prediction_of(as_scene(scene), at, with_margins=with_margins)
    for one in prediction.every:
        _ = one.judge.is_stable_in_states, one.poles  # so that their errors are raised by this call
    return prediction


def prediction_of(scene: Scene, at: Places = None, **options: bool) -> Prediction:
    """Returns the prediction, not yet computed; arguments as of `Prediction`. In the scene at a port, points of other
    devices are held still. Raises UsageError where `at` is no place in the scene's space."""
    scene = scene.held
    is_line = scene.space == 1
    if at is not None and isinstance(at, float | int) is not is_line:
        expected = "a position in a scene with one coordinate" if is_line else "x, y in a scene with space: 2"
        raise UsageError(f"at: found {at}, expected {expected}")
    if scene.ports:
        return PortsPrediction(scene, at, **options)
    return Prediction(scene, at, **options) if is_line else PlanePrediction(scene, at, **options)


def predict_on_wire(scene: Scene) -> Prediction | None:
    """Returns the prediction for a UART, with `WireTime.delay_samples` in place of one, if the scene has no wire of its
    own or one of unknown pace. None if a UART costs one sample or is saturated."""
    samples = 1 if wire_of(scene) in PACED else wire_time_of(scene).delay_samples
    return None if samples in (None, 1) else predict(with_wire_delay(scene, samples), with_margins=False)


def surely_shaken_by(scene: Scene) -> Shaking | None:
    """Returns the motion that will surely shake the hand in `scene`, at any position; None if there is none. At the
    limit it is not certain, nor if the poles cannot be computed for the scene's scheme. A running loop needs this
    before it takes a scene."""
    return _wherever(scene).shaking


@lru_cache(maxsize=2)  # of the scene that runs and the one that it is to be
def _wherever(scene: Scene) -> Prediction:
    return prediction_of(scene, with_margins=False, wherever=True)


def is_soon_stable(scene: Scene, most_states: int) -> bool:
    """Returns True if `surely_shaken_by` finds no motion and this is quickly found; False proves nothing. Hands without
    masses are judged one by one, and only those that changed. `most_states`: as in `Judge.is_soon_stable`."""
    hands = scene.device_points.keys()
    is_lone = not (scene.structures or scene.material_points or scene.plane_links) and len(hands) > 1
    if not is_lone or scene.device.correction != "none" or any(hands >= {*one.between} for one in scene.links.values()):
        return _wherever(scene).is_soon_stable(most_states)
    for name in hands:  # with the links of this hand alone, and without the modules of other hands
        own = {at: one for at, one in scene.modules.items() if not isinstance(one, Link) or name in one.between}
        if not _is_stable_alone(scene.model_copy(update={"modules": Table(own), "sound": Table({})})):
            return False
    return True


@lru_cache(maxsize=64)
def _is_stable_alone(scene: Scene) -> bool:
    return Prediction(scene, with_margins=False, wherever=True).is_soon_stable(0)


def is_surely_unstable(prediction: Prediction) -> bool:
    """Returns whether a motion will surely shake the hand, with finite numbers."""
    shaking = prediction.shaking
    return shaking is not None and math.isfinite(shaking.growth)


def with_mass(prediction: Prediction, channel: int, mass: float) -> Prediction:
    """Returns the prediction for a hand of this mass (kg) on a channel, after an adaptive correction estimated it."""
    rendering = prediction.rendering
    port = None if rendering is None else next((one for one in rendering.ports if one.channel == channel), None)
    if rendering is None or port is None or port.schedule is None:
        return prediction
    settled, device = port.settled(mass), replace(port.declared, mass=mass)
    found, of_hand = copy(prediction), Felt("", channel, device, *settled.rendered, rendering.predictor_of(settled))
    found.felt = tuple(replace(of_hand, name=one.name) if one.channel == channel else one for one in prediction.felt)
    desired = list(prediction.desired)
    for i, one in enumerate(desired):
        if one.channel == channel:
            frequency, ratio = swing(mass, one.k, one.b)
            desired[i] = one._replace(frequency_hz=frequency, damping_ratio=ratio)
    found.desired = tuple(desired)
    found.__dict__.pop("parts", None)  # they are made of these
    return found


def partials_of(scene: Scene, prediction: Prediction | None = None) -> dict[str, tuple[float, ...]]:
    """Partials of each pick-up in Hz, ascending: the frequencies of its source once contacts, plectra and friction have
    released it; of a large scene the lowest ones. `prediction`: that of the scene, if known."""
    held = {name: one for name, one in scene.modules.items() if not isinstance(one, _EXCITERS)}
    taken = [] if prediction is None else [prediction._linear.links[at] for at in scene.modules.keys() - held.keys()]
    is_released = all(one.stiffness == one.damping == 0.0 for one in taken)  # at the assumed positions of the hands
    if prediction is None or prediction.rendering is not None or not is_released:
        prediction = predict(scene.model_copy(update={"modules": Table(held)}), with_margins=False)
    rings = [one for one in prediction.modes if one.damping_ratio < _MOST_DAMPED and one.frequency_hz > _LOWEST_HZ]
    number = {name: i for i, name in enumerate(prediction.points)}
    found = {}
    for name, pick_up in scene.sound.items():
        shares = np.array([one.participation[number[pick_up.point]] for one in rings])
        audible = shares > _LEAST_SHARE * shares.max(initial=0.0)
        found[name] = tuple(
            sorted(one.frequency_hz for one, is_audible in zip(rings, audible, strict=True) if is_audible)
        )
    return found
