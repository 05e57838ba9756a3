"""A hand that slides along one branch of a curve with two: the scene of that branch alone, and the samples on it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hapsim.branch_law import BranchLaw
from hapsim.errors import UsageError
from hapsim.measuring.converters import Floats
from hapsim.prediction.characteristic import HandLink, characteristic_of
from hapsim.scene import Nonlinear, Scene

BRANCHES = ("press", "release")


def on_branch(scene: Scene, channel: int, branch: str) -> Scene:
    """Returns a scene in which the hand on `channel` stays on this branch of its first curve with two: what small
    motions meet while it slides. Its other such curves are on the branch of the same way of the hand. Raises
    UsageError for another word, and for a hand without such a curve to a ground."""
    if branch not in BRANCHES:
        raise UsageError(f"branch: found '{branch}', expected {' or '.join(BRANCHES)}")
    instead = {}
    for name, _, side in _branches_of(scene, channel, branch):
        link = scene.modules[name]
        assert isinstance(link, Nonlinear)
        both = link.branches
        curve = both and (both.press if side > 0.0 else both.release)
        instead[name] = link.model_copy(update={"force_over_distance": curve})
    return scene.model_copy(update={"modules": dict(scene.modules) | instead})


def slides(scene: Scene, channel: int, branch: str, way: Floats) -> NDArray[np.bool_]:
    """Returns at which of these positions of the hand (m, from the first sample on) it is on that branch."""
    found = np.ones(way.size, bool)
    for _, link, side in _branches_of(scene, channel, branch):
        assert isinstance(link.law, BranchLaw)
        d = link.distance(way)
        found &= link.law.along(d, float(d[0])) == side
    return found


def approach(scene: Scene, channel: int, branch: str) -> float:
    """Returns the way of a hand that slides along this branch: 1 or -1."""
    _, link, side = next(_branches_of(scene, channel, branch))
    return link.sign * side


def _branches_of(scene: Scene, channel: int, branch: str) -> Iterator[tuple[str, HandLink, float]]:
    """Yields the curves with two branches of a hand, with z on the branch that they are on then."""
    hand = characteristic_of(scene, scene.hand_on(channel))
    links = {name: one for name, one in (hand.links if hand else {}).items() if isinstance(one.law, BranchLaw)}
    if not links:
        found = f"found {branch}, but {scene.hand_on(channel)} has no curve with two branches to a ground"
        raise UsageError(f"branch: {found}; omit --branch")
    way = next(iter(links.values())).sign * (1.0 if branch == "press" else -1.0)
    yield from ((name, one, one.sign * way) for name, one in links.items())
