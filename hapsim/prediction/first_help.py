"""Changes that make an unstable scene of several points stable, each by itself: what would help first."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hapsim.number_format import rounded_down, rounded_up
from hapsim.prediction.correction.kind import with_modules
from hapsim.prediction.prediction import Prediction
from hapsim.prediction.swings import NetworkVerdict
from hapsim.scene import Scene
from hapsim.theory import Network
from hapsim.theory.network import is_large

_FACTORS = (1.25, 1.6, 2.5, 4.0, 8.0, 20.0, 100.0)
_OF_ALL = 5  # of these factors, for a mass or a rate
_BISECTIONS = 6  # to some per cent
_MOST_LINKS = 6  # that are tried
_MOST_STATES = 150  # numbers in a state: each change takes some tens of eigenvalue problems


class Help(NamedTuple):
    """One quantity, and the factor from which on the scene is stable: below 1 with less of it, above 1 with more."""

    what: str
    """Quantity: stiffness or damping of a link, mass of all hands, or rate."""
    name: str
    """Link; "" for hands and rate."""
    factor: float


def first_help(prediction: Prediction) -> list[Help]:
    """Returns for each quantity the smallest change that helps; empty if the scene is stable, planar or large, or if
    none does. The delay keeps its number of samples."""
    network = prediction.network
    if (
        network.rows is not None
        or is_large(network)
        or len(network.stiffness) + len(network.channel_mass) > _MOST_STATES
    ):
        return []
    if _is_stable(prediction, Help("rate", "", 1.0)):  # or unstable in a region of a hand alone
        return []
    found: dict[str, Help] = {}
    for one in _candidates(prediction):
        best = found.get(one.what)
        most = math.inf if best is None else abs(math.log(best.factor))
        if (factor := _least(prediction, one, most)) is not None:
            found[one.what] = one._replace(factor=factor)
    return [*found.values()]


def ways_to_stability(prediction: Prediction) -> str:
    """Returns them as a sentence in the scene's units, without a full stop; "" if there are none."""
    scene, ways = prediction.scene, list[str]()
    simulated = " simulated" if prediction.rendering is not None and not prediction.is_lone else ""
    for one in first_help(prediction):
        factor = (rounded_up if one.factor > 1.0 else rounded_down)(one.factor)
        if one.what == "rate":
            ways.append(f"a rate of {rounded_up(one.factor * scene.rate)} Hz")
        elif one.what == "mass":
            ways.append(f"{factor} times the mass of each hand")
        else:
            written = 0.0 if simulated else getattr(scene.links[one.name], one.what, None) or 0.0
            unit = "N/m" if one.what == "stiffness" else "N·s/m"
            value = f" ({scene.units_at(one.name)(float(factor) * written, unit, '.4g')})" if written else ""
            ways.append(f"{factor} times the{simulated} {one.what} of {one.name}{value}")
    return f"It becomes stable with {', or with '.join(ways)}" if ways else ""


def _candidates(prediction: Prediction) -> Iterator[Help]:
    """Yields quantities with the direction of their change, the stiffest links first."""
    links, parts = prediction._linear.links, prediction.states.parts
    contacts = {name for states in parts for name in (states[0] if states else ())}
    every = sorted(links, key=lambda name: (name not in contacts, -abs(links[name].stiffness), -links[name].damping))
    for name in every[:_MOST_LINKS]:
        if not _is_made_anew(prediction) or hasattr(prediction.scene.links[name], "damping"):
            yield Help("stiffness", name, 0.5)
            yield Help("damping", name, 2.0)
            yield Help("damping", name, 0.5)
    if not _is_made_anew(prediction):
        yield Help("mass", "", 2.0)
    yield Help("rate", "", 2.0)


def _least(prediction: Prediction, one: Help, most: float) -> float | None:
    """Returns the smallest factor that helps, of a logarithm below `most`; None if there is none."""
    way, bad = (1.0 if one.factor > 1.0 else -1.0), 1.0
    for size in _FACTORS if one.name else _FACTORS[:_OF_ALL]:
        good = size**way
        if math.log(size) * 0.8 > most:
            return None
        if _is_stable(prediction, one._replace(factor=good)):
            break
        bad = good
    else:
        return None
    for _ in range(_BISECTIONS):
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if _is_stable(prediction, one._replace(factor=middle)) else (good, middle)
    return good if abs(math.log(good)) < most else None


def _is_stable(prediction: Prediction, change: Help) -> bool:
    if _is_made_anew(prediction):
        return Prediction(_changed_scene(prediction.scene, change), with_margins=False).stable
    network, states = _changed(prediction, change), prediction.states
    factors = {"stiffness": (change.factor, 1.0), "damping": (1.0, change.factor)}.get(change.what, (1.0, 1.0))
    grows = NetworkVerdict(network, prediction.points).may_grow()
    return not grows and not states.grows_with(network, {change.name: factors})


def _is_made_anew(prediction: Prediction) -> bool:
    """Returns whether the correction is made anew for each change: that of hands alone, where it takes no search."""
    return prediction.rendering is not None and prediction.is_lone


def _changed_scene(scene: Scene, change: Help) -> Scene:
    if change.what == "rate":
        return scene.model_copy(update={"rate": change.factor * scene.rate})
    link = scene.links[change.name]
    value = change.factor * getattr(link, change.what, math.nan)
    return with_modules(scene, {change.name: link.model_copy(update={change.what: value})})


def _changed(prediction: Prediction, change: Help) -> Network:
    network, of = prediction.network, change.factor
    if change.what == "rate":
        return replace(network, rate=of * network.rate)
    if change.what == "mass":
        return replace(network, channel_mass=of * network.mass_matrix)
    values = np.where(np.array([*prediction._linear.links]) == change.name, of, 1.0)
    values = np.append(values, np.ones(network.stiffness.size - values.size))
    return replace(network, **{change.what: values * getattr(network, change.what)})
