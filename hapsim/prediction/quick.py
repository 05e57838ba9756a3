"""A quick judgement for streams of changes: a scene that it accepts is one in which `surely_shaken_by` finds nothing.

Of a hand on grounds it asks whether all poles lie well within the unit circle, by Jury's test, and it remembers hands:
a change of one of four keys is judged by that key alone. With masses it squares the transition of the whole scene
until nothing is left of any motion, in a fifth of the time that eigenvalues take. What is close to the limit it leaves
to `surely_shaken_by`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hapsim.prediction.characteristic import hand_at, scene_at
from hapsim.prediction.correction import rendered
from hapsim.prediction.linear import configuration_of, late_by_mean, network_of
from hapsim.prediction.regions import modulus_without
from hapsim.scene import DevicePoint, Ground, Link, Scene, ViscoElastic
from hapsim.scene.part import Table
from hapsim.theory import Configuration, NotWorkedOutError
from hapsim.theory.arrays import Floats
from hapsim.theory.hand.poles import all_within
from hapsim.theory.network import LARGE, state_size, transition

_WITHIN = 1.0 - 1e-6  # a pole of smaller modulus is within the circle, whatever rounding does to it
_SQUARED = 24  # times at most: a motion that takes longer than 2^24 samples to die out is close to the limit
_GONE = 0.1  # of a power's norm: below 1 all moduli are
_MOST = 1e5  # of the norms before: the squares' rounding, 1e-16 of their own, is far below that


def is_surely_stable(scene: Scene, most_states: int = LARGE) -> bool:
    """Whether nothing shakes the hand in `scene`, where that is quick to find out: with masses, if the whole scene's
    state has at most `most_states` numbers. False says nothing."""
    seen = rendered(scene).seen
    around: dict[str, dict[str, Link]] = {name: {} for name in seen.device_points}
    is_lone = not seen.structures and not seen.material_points
    for name, link in seen.links.items():
        for end in around.keys() & {*link.between}:
            around[end][name] = link
    grounds = seen.grounds
    for name, links in around.items():
        ends = {end for link in links.values() for end in link.between} - {name}
        if not ends <= grounds.keys():
            is_lone = False
        elif not _holds(_alone(seen, name, links, {end: grounds[end] for end in sorted(ends)})):
            return False
    return is_lone or _decays(seen, most_states)


def _alone(scene: Scene, name: str, links: dict[str, Link], grounds: dict[str, Ground]) -> Scene:
    """The scene with this hand and nothing else, and without what does not concern it."""
    modules: Table[DevicePoint | Ground | Link] = Table({name: scene.device_points[name], **grounds, **links})
    return scene.model_copy(update={"modules": modules, "mock": None, "sound": Table({})})


@lru_cache(maxsize=64)
def _holds(alone: Scene) -> bool:
    """Whether a scene of one hand on grounds is stable wherever the hand is."""
    ((name, point),) = alone.device_points.items()
    links = alone.links.values()
    dampers = {(one.damper, one.cutoff) if isinstance(one, ViscoElastic) else ("backward", None) for one in links}
    if len(dampers) > 1 or (late_by_mean(alone) and dampers != {("backward", None)}):
        return False
    configuration = _known(configuration_of(alone, point.channel, *next(iter(dampers), ())))
    hand, own = hand_at(alone, name, wherever=True), configuration.stiffness
    if hand.is_regional:
        pieces = hand.pieces()
        found = [(one.stiffness, one.damping) for one in pieces]
        if not any(one.stiffness + own > 0.0 and not one.sliding for one in pieces) and min(found)[0] + own < 0.0:
            return False  # the whole scene is judged where nothing holds it
    else:
        linear = [link.law().linear() for link in links]
        found = [(sum(one.stiffness for one in linear), sum(one.damping for one in linear))]
    held = np.array([one for one in found if one[0] + own > 0.0]).reshape(-1, 2)
    others = {one for one in found if not one[0] + own > 0.0}
    return all(_grows(configuration, *one) <= 1.0 for one in others) and _are_within(configuration, *held.T)


@lru_cache(maxsize=64)
def _known(configuration: Configuration) -> Configuration:
    """An equal one, which keeps what it has worked out."""
    return configuration


@np.errstate(all="ignore")  # what is out of range is not within
def _are_within(configuration: Configuration, stiffness: Floats, damping: Floats) -> bool:
    coefficients = configuration.characteristic(stiffness, damping)
    return bool(np.all(all_within([*coefficients.T], np.full(stiffness.shape, _WITHIN))))


@lru_cache(maxsize=256)
def _grows(configuration: Configuration, stiffness: float, damping: float) -> float:
    """By how much a hand without a spring, or on one that pushes it away, is shaken in a sample."""
    # "free" for a "snap" too: both leave out the pole that a hand has by itself.
    return modulus_without(configuration.poles(stiffness, damping).tolist(), "free")


@np.errstate(all="ignore")
def _decays(seen: Scene, most_states: int) -> bool:
    """Whether every motion of the whole scene, as the theory sees it, dies out."""
    network, _ = network_of(seen, scene_at(seen))
    if state_size(network) > most_states:
        return False
    try:
        power = transition(network)
    except NotWorkedOutError:
        return False
    for _ in range(_SQUARED):
        norm = np.abs(power).sum(axis=0).max(initial=0.0)
        if not _GONE <= norm < _MOST:
            return bool(norm < _GONE)
        power = power @ power
    return False
