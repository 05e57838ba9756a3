"""Changes that make an unstable scene of several points, or a corrected one, stable: what would help first."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hapsim.number_format import rounded_down, rounded_up
from hapsim.one_thread import one_thread
from hapsim.prediction.correction.kind import with_modules
from hapsim.prediction.linear import with_device
from hapsim.prediction.prediction import Prediction
from hapsim.prediction.swings import NetworkVerdict
from hapsim.scene import Scene
from hapsim.theory.network import state_size

_FACTORS = (1.25, 1.6, 2.5, 4.0, 8.0, 20.0, 100.0)
_OF_ALL = 5  # of these factors, for a mass or a rate
_BISECTIONS = 6  # to some per mille
_MOST_LINKS = 6  # that are tried
_MOST_STATES = 150  # numbers in a state: each change takes some tens of eigenvalue problems


class Help(NamedTuple):
    """One quantity, and the factor from which on the scene is stable: below 1 with less of it, above 1 with more."""

    what: str
    """Quantity: stiffness or damping of a link, mass of all hands, or rate."""
    name: str
    """Link; "" for hands and rate."""
    factor: float


INSTALLED = "with the correction as installed; an edited file gets another one, with other limits"
"""Words for the loop of a corrected scene's margin or change: a search for each edit would take seconds."""

_AS_IT_IS = Help("rate", "", 1.0)


def first_help(prediction: Prediction) -> list[Help]:
    """Returns for each quantity the smallest change that is enough by itself; empty if the scene is large, if it is
    stable but for regions of hands alone, or if no change is enough. The delay keeps its number of samples, and a
    correction its simulated values and its predictor."""
    if state_size(prediction.network) > _MOST_STATES:
        return []
    found: dict[str, Help] = {}
    with one_thread():
        for one, sizes in () if _is_stable(prediction, _AS_IT_IS) else _candidates(prediction):
            most = abs(math.log(found[one.what].factor)) if one.what in found else math.inf
            if factor := _least(prediction, one, [size for size in sizes if abs(math.log(size)) < most]):
                found[one.what] = one._replace(factor=factor)
    return [*found.values()]


def ways_to_stability(prediction: Prediction) -> str:
    """Returns them as a sentence in the scene's units, without a full stop; "" if there are none."""
    scene, ways, corrected = prediction.scene, list[str](), prediction.changes_values
    is_simulated = scene.device.is_admittance
    for what, name, exact in first_help(prediction):
        factor = (rounded_up if exact > 1.0 else rounded_down)(exact)
        if what == "rate":
            ways.append(f"a rate of {rounded_up(exact * scene.rate)} Hz")
        elif what == "mass":
            ways.append(f"{factor} times the {'simulated mass' if is_simulated else 'mass of each hand'}")
        else:
            link = prediction._linear.links[name] if corrected else scene.modules[name]
            unit, written = {"stiffness": "N/m"}.get(what, "N·s/m"), getattr(link, what, None)
            value = f" ({scene.units_at(name)(float(factor) * written, unit, '.4g')})" if written else ""
            ways.append(f"{factor} times the {'simulated ' * corrected}{what} of {name}{value}")
    of = f" ({INSTALLED})" * corrected
    return f"It becomes stable with {', or with '.join(ways)}{of}" if ways else ""


def _candidates(prediction: Prediction) -> Iterator[tuple[Help, tuple[float, ...]]]:
    """Yields quantities, contacts and the stiffest links first, with the factors to try."""
    links, parts = prediction.scene.plane_links or prediction._linear.links, prediction.states.parts
    contacts = {name for states in parts for name in (states[0] if states else ())}

    def size(name: str, what: str) -> float:
        return abs(getattr(links[name], what, 0.0))

    every = sorted(links, key=lambda name: (name not in contacts, -size(name, "stiffness"), -size(name, "damping")))
    on_line = prediction.scene.space == 1
    if not on_line:
        every = [name for name in every if name in prediction.states.acting]  # type: ignore[attr-defined]
    less = tuple(1.0 / one for one in _FACTORS)
    for name in every[:_MOST_LINKS]:
        ways = (("stiffness", less), ("damping", _FACTORS), ("damping", less))
        yield from ((Help(what, name, 1.0), factors) for what, factors in ways if size(name, what) or on_line)
    if not prediction.changes_values:  # a predictor is made for a mass and a rate
        if on_line or prediction.network.mass_coupling is None:  # in the plane the file has no number for a matrix
            yield Help("mass", "", 1.0), _FACTORS[:_OF_ALL]
        if prediction.network.board is None:  # else a whole part of the board's
            yield Help("rate", "", 1.0), _FACTORS[:_OF_ALL]


def _least(prediction: Prediction, one: Help, sizes: Sequence[float]) -> float:
    """Returns the factor next to 1 that is enough; 0 if none of the sizes is."""
    good = next((size for size in sizes if _is_stable(prediction, one._replace(factor=size))), 0.0)
    bad = [1.0, *sizes][sizes.index(good)] if good else 0.0
    for _ in range(_BISECTIONS if good else 0):
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if _is_stable(prediction, one._replace(factor=middle)) else (good, middle)
    return good


def _edited(scene: Scene, change: Help) -> Scene:
    """Returns the scene with the change in its file."""
    what, name, of = change
    if what == "rate":
        return scene.model_copy(update={"rate": of * scene.rate})
    if what == "mass":
        return with_device(scene, mass=tuple(of * one for one in scene.device.masses(scene.channels)))
    module = scene.modules[name]
    return with_modules(scene, {name: module.model_copy(update={what: of * getattr(module, what)})})


def _is_stable(prediction: Prediction, change: Help) -> bool:
    if prediction.scene.space > 1:  # its links have several rows, and other places then
        edited = _edited(prediction.scene, change)
        return type(prediction)(edited, prediction._at, with_margins=False).judge.shaking is None
    network, (what, name, of) = prediction.network, change
    times = np.ones(network.stiffness.size)
    times[: len(prediction._linear.links)] += (of - 1.0) * (np.array([*prediction._linear.links]) == name)
    changed = {
        "stiffness": {"stiffness": times * network.stiffness},
        "damping": {"damping": times * network.damping},
        "mass": {"channel_mass": of * network.mass_matrix},
        "rate": {"rate": of * network.rate},
    }[what]
    network = replace(network, **changed)  # type: ignore[arg-type]
    factors = (of if what == "stiffness" else 1.0, of if what == "damping" else 1.0)
    grows = NetworkVerdict(network, prediction.points).may_grow()
    return not grows and not prediction.states.grows_with(network, {name: factors})
