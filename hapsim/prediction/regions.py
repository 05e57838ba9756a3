"""What a hand feels in each region of its travel: contacts, tables, detents, friction that sticks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hapsim.prediction.characteristic import Characteristic, Piece, characteristic_of, hand_at, scene_at
from hapsim.prediction.correction import Rendering
from hapsim.prediction.felt import felt_by
from hapsim.prediction.linear import LinearScene, hand_of, links_of, why_coupled
from hapsim.prediction.types import Region, RegionKind
from hapsim.scene import Scene

_GROWS = 1.0 + 1e-9  # what grows by more in a sample is not at the limit
_POINTS = 1025  # at which the energy of a curved snap is summed


def regions_of(rendering: Rendering, name: str, around: float = 0.0) -> tuple[Region, ...]:
    """The regions of the hand at this device point, by position; of one place first the one in which all friction
    sticks. None where it moves more than itself. `around`: as in `characteristic_of`."""
    hand, seen = characteristic_of(rendering.desired, name, around), rendering.seen
    linear = scene_at(seen)
    if hand is None or why_coupled(seen, linear, name):
        return ()
    simulated, regions = hand_at(seen, name), []
    for piece in hand.pieces():
        here = linear_at(simulated, linear, piece)
        felt = felt_by(rendering, here, name)
        kind = _kind(felt.stiffness + felt.configuration.stiffness)
        stable = felt.stable if kind == "held" else modulus_without(felt.poles, kind) < _GROWS
        energy = _snap_energy(piece, hand) if kind == "snap" else 0.0
        regions.append(Region(piece, felt, kind, stable, links_of(here, name), energy, float(hand.force(piece.place))))
    return tuple(regions)


def growth(regions: tuple[Region, ...]) -> float:
    """The largest modulus of a pole with which a region shakes the hand; 0 where none does."""
    return max((modulus_without(one.felt.poles, one.kind) for one in regions if not one.is_stable), default=0.0)


def growth_of(seen: Scene, linear: LinearScene, name: str) -> tuple[float, str]:
    """The same from the poles of the hand `name` alone, where it feels different springs, and the hand's name with the
    stiffest link there; 0 for another hand."""
    hand = characteristic_of(seen, name, wherever=True)
    if hand is None or not hand.is_regional:
        return 0.0, name
    (grown, whose), known = (0.0, name), set()
    for piece in hand.pieces():
        here = linear_at(hand, linear, piece)
        element = hand_of(seen, here, name)
        if element not in known:
            known.add(element)
            configuration, stiffness, damping = element
            kind = _kind(stiffness + configuration.stiffness)
            if not (kind == "held" and bool(configuration.is_stable(stiffness, damping))):
                grows = modulus_without(configuration.poles(stiffness, damping).tolist(), kind)
                if grows > grown:
                    links = links_of(here, name)
                    grown, whose = grows, f"{name} in {max(links, key=lambda link: links[link].stiffness)}"
    return grown, whose


def linear_at(hand: Characteristic, linear: LinearScene, piece: Piece) -> LinearScene:
    """`linear`, a scene as the theory takes it, with this hand of it in this piece."""
    taken = hand.taken(piece.place, piece.sliding)
    here = {
        link: linear.links[link]._replace(stiffness=one.stiffness, damping=one.damping) for link, one in taken.items()
    }
    return linear._replace(links=linear.links | here)


def _kind(stiffness: float) -> RegionKind:
    return "held" if stiffness > 0.0 else "snap" if stiffness < 0.0 else "free"


def modulus_without(poles: Iterable[complex], kind: RegionKind) -> float:
    """The largest modulus of a pole, without the one that a snap or a free hand has by itself: the largest real one."""
    rest = list(poles)
    real = [pole for pole in rest if abs(pole.imag) <= 1e-6 * abs(pole) and pole.real > 0.0]
    if kind != "held" and real:
        rest.remove(max(real, key=abs))
    return max(map(abs, rest), default=0.0)


def _snap_energy(piece: Piece, hand: Characteristic) -> float:
    """The work of the force at the snap's beginning over its width, less that of the scene."""
    if not np.isfinite(piece.high - piece.low):
        return 0.0
    x = np.linspace(*piece.within, _POINTS if piece.is_curved else 2)
    force = hand.force(x)
    return float(np.trapezoid(np.max(force) - force, x))
