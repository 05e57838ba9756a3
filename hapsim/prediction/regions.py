"""What a hand feels in each region of its travel: contacts, tables, detents, friction that sticks."""

from __future__ import annotations

import numpy as np

from hapsim.prediction.characteristic import Characteristic, Piece, characteristic_of, scene_at
from hapsim.prediction.correction import Rendering
from hapsim.prediction.felt import felt_by
from hapsim.prediction.linear import links_of, why_coupled
from hapsim.prediction.types import Felt, Region, RegionKind

_GROWS = 1.0 + 1e-9  # what grows by more in a sample is not at the limit
_POINTS = 1025  # at which the energy of a curved snap is summed


def regions_of(rendering: Rendering, name: str) -> tuple[Region, ...]:
    """The regions of the hand at this device point, by position; of one place first the one in which all friction
    sticks. None where it moves more than itself."""
    desired, seen = (characteristic_of(scene, name) for scene in (rendering.desired, rendering.seen))
    if desired is None or seen is None:
        return ()
    if why_coupled(rendering.seen, scene_at(rendering.seen), name):
        return ()
    regions = []
    for piece in desired.pieces():
        linear = scene_at(rendering.seen, {name: (piece.place, piece.sliding)})
        felt = felt_by(rendering, linear, name)
        stiffness = felt.stiffness + felt.configuration.stiffness
        kind: RegionKind = "held" if stiffness > 0.0 else "snap" if stiffness < 0.0 else "free"
        stable = felt.stable if kind == "held" else max(_others(felt, kind), default=0.0) < _GROWS
        energy = _snap_energy(piece, desired) if kind == "snap" else 0.0
        regions.append(Region(piece, felt, kind, stable, links_of(linear, name), energy))
    return tuple(regions)


def growth(regions: tuple[Region, ...]) -> float:
    """The largest modulus of a pole with which a region shakes the hand; 0 where none does."""
    return max((max(_others(one.felt, one.kind), default=0.0) for one in regions if not one.is_stable), default=0.0)


def _others(felt: Felt, kind: RegionKind) -> list[float]:
    """The moduli of the poles, without the one that a snap or a free hand has by itself: the largest real one, at 1 or
    above."""
    if kind == "held":
        return [abs(pole) for pole in felt.poles]
    real = [pole for pole in felt.poles if abs(pole.imag) <= 1e-6 * abs(pole) and pole.real > 0.0]
    own = max(real, key=abs, default=None)
    return [abs(pole) for pole in felt.poles if pole != own]


def _snap_energy(piece: Piece, hand: Characteristic) -> float:
    """The work of the force at the snap's beginning over its width, less that of the scene."""
    if not np.isfinite(piece.high - piece.low):
        return 0.0
    x = np.linspace(piece.low, piece.high, _POINTS if piece.is_curved else 2)
    force = hand.force(x)
    return float(np.trapezoid(np.max(force) - force, x))
