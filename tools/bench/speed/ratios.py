"""The contests round by round: what a sample costs whom, and hapsim's share of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from hapsim.speed_accuracy.comparison import Running
from hapsim.speed_accuracy.objects import scene_of
from hapsim.speed_accuracy.strings import StringOfMasses, Timed, cost_of, hand_link, hand_motion
from speed.contenders import OURS, RATE, Contest, contests
from speed.peers.faust_mi import FaustMi
from speed.peers.mujoco_tendons import MuJoCo

_ROUND_S = 0.05
_AGREES = 1e-9  # of the largest force

Measured = dict[str, dict[str, list[float]]]
"""Object -> who -> ns a sample, one for each round."""


class Ratios:
    """Contests that were held to the same forces, to be timed round by round."""

    def __init__(self, log: Callable[[str], None]) -> None:
        self.measured: Measured = {}
        self.agreed: list[str] = []
        for contest in contests():
            log(f"compiling {contest.what}")
            self.agreed += _require_agreement(contest)
        self._others = list(_others(log))

    def round(self) -> None:
        """Everybody once, made anew: where its arrays happen to stand in memory decides too what a tick costs."""
        for contest in contests():
            for who, advance in contest.advance.items():
                self._note(contest.what, who, Timed(advance, 1e9, _ROUND_S).round())
        for what, costs in self._others:
            for who, cost in costs.items():
                self._note(what, who, cost())

    def _note(self, what: str, who: str, nanoseconds: float) -> None:
        self.measured.setdefault(what, {}).setdefault(who, []).append(nanoseconds)


def ratios_of(measured: dict[str, list[float]], one: str, other: str) -> list[float]:
    """`one` over `other`, round by round."""
    return [mine / theirs for mine, theirs in zip(measured[one], measured[other], strict=True)]


def _require_agreement(contest: Contest) -> list[str]:
    """A sentence where all give a hand the same force. RuntimeError where one does not."""
    if not contest.forces:
        return []
    motion = hand_motion(2000, RATE)
    found = {who: forces(motion) for who, forces in contest.forces.items()}
    most = float(np.max(np.abs(found[OURS])))
    worst = max(float(np.max(np.abs(forces - found[OURS]))) for forces in found.values()) / most
    if not worst <= _AGREES:
        raise RuntimeError(f"{contest.what}: the forces differ by {worst:.1e} of the largest")
    return [f"{contest.what}: all forces agree within {worst:.0e} of the largest"]


def _others(log: Callable[[str], None]) -> Iterator[tuple[str, dict[str, Callable[[], float]]]]:
    """Peers that are no C programs of ours, each beside hapsim: ns a sample."""
    string = StringOfMasses.tuned(100)
    scene = scene_of(string, "cordis", "double", RATE, *hand_link(string))

    def ours() -> float:
        return 1e9 * cost_of(Running(scene).advance, 1.0, 1, _ROUND_S)[0]

    for peer in (FaustMi(hand=True), MuJoCo("Euler"), MuJoCo("implicitfast"), MuJoCo("RK4")):
        if why := peer.available():
            log(f"{peer.name} is skipped: {why}")
            continue

        def theirs(peer: FaustMi | MuJoCo = peer) -> float:
            return 1e9 / RATE * peer.cost(string, RATE, 1)[0]

        yield f"string of 100: {peer.name}", {OURS: ours, peer.name: theirs}
