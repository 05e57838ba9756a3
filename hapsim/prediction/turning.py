"""Curves with two branches: the `turn` from which on any hand is safe, and the energy that a cycle takes.

A spring K behind a sample period T and a delay of d samples adds (1/2 + d) T K to the friction that any hand needs
(Colgate and Schenkel). Between its branches a curve is such a spring, at most as stiff as its steepest slope.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from hapsim.branch_law import BranchLaw
from hapsim.prediction.characteristic import HandLink, characteristic_of
from hapsim.scene import Scene
from hapsim.scene.modules.links import Nonlinear


@dataclass(frozen=True)
class Turning:
    """A curve with two branches between a hand and the ground."""

    DOCUMENT = "hand turn_m=turn least_turn_m=least steepest needed_friction cycle_m=cycle cycle_energy_j=energy"

    hand: str
    turn: float
    """m."""
    least: float
    """The least `turn` that is safe in any hand, m; infinite if none is."""
    steepest: float
    """Steepest slope, N/m."""
    needed_friction: float
    """Friction that makes any hand safe with this curve alone, N·s/m."""
    cycle: tuple[float, float]
    """Positions of the hand, m, from the first distance to the last, within the travel."""
    energy: float
    """Energy that a way to and fro between them takes from the hand, J; NaN if they are nearer than `turn`."""


def turnings_of(scene: Scene) -> dict[str, Turning]:
    """Returns each such curve of a scene on a line, by name."""
    found: dict[str, Turning] = {}
    for hand in scene.device_points:
        characteristic = characteristic_of(scene, hand)
        for name, one in characteristic.links.items() if characteristic else ():
            link = scene.modules.get(name)
            if characteristic and isinstance(link, Nonlinear) and (branches := link.branches):
                needed = branches.steepest * scene.device.lag * scene.period
                assert isinstance(one.law, BranchLaw)
                cycle, energy = _cycle(one, one.law, characteristic.low, characteristic.high)
                least = scene.least_turn(link)
                found[name] = Turning(hand, branches.width, least, branches.steepest, needed, cycle, energy)
    return found


def turning_sentences(scene: Scene) -> Iterator[str]:
    """Yields what `check` says about each."""
    for name, one in turnings_of(scene).items():
        units = scene.units_at(name)
        steep = f"its steepest slope, {units(one.steepest, 'N/m')}, asks {units(one.needed_friction, 'N·s/m')}"
        enough = f"any hand is safe with a turn of {units(one.least, 'mm', 4)} or more"
        if not math.isfinite(one.least):
            enough = "no turn is safe in any hand with the declared friction: a branch is too steep itself"
        elif one.turn < one.least * (1.0 - 1e-9):
            enough = f"too small for some hands with the declared friction: {enough}"
        takes = ""
        if not math.isnan(one.energy):
            takes = f". From {units.between(*one.cycle, 'mm')} and back it takes {units(one.energy, 'mJ', 4)}"
        yield f"{name} turns over {units(one.turn, 'mm', 4)}; {steep} of friction; {enough}{takes}"


def _cycle(link: HandLink, law: BranchLaw, low: float, high: float) -> tuple[tuple[float, float], float]:
    ends = sorted(float(link.distance(x)) for x in (low, high))
    first, last = max(law.knots[0][0], ends[0]), min(law.knots[-1][0], ends[1])
    cycle = sorted(link.fixed_m + link.sign * d for d in (first, last))
    energy = law.cycle_energy(first, last) if last - first >= 2.0 * law.reach else math.nan
    return (cycle[0], cycle[1]), energy
