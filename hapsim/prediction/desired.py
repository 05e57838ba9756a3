"""What a hand is to feel, and how far a correction brings it there."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hapsim.prediction.characteristic import Piece
from hapsim.prediction.correction import Corrected, CorrectionKind, Remedies, Rendering, felt_error, remedies_for
from hapsim.prediction.felt import Felt, swing

_MASSES = 9  # of a span, at which the error of a correction is looked at
_REACHED = 1e-6  # an error of a correction that is none


class Desired(NamedTuple):
    """The scene's stiffness and damping at one device point, the device's own included; and how far a correction brings
    the hand there."""

    name: str
    channel: int
    k: float
    """N/m"""
    b: float
    """N·s/m"""
    frequency_hz: float
    damping_ratio: float
    error: float
    """Of what is felt, as `felt_error` counts it; over a span of masses the largest."""
    reached: bool
    remedies: Remedies | None
    """What would make it reachable; None where it is reached, or the mass is a span."""
    stable_masses: tuple[float, float]
    steady_stiffness: float
    """Both as in `Robustness`, of the corrected loop."""


def desired_of(rendering: Rendering, felt: Sequence[Felt], here: Mapping[str, Piece]) -> Iterator[Desired]:
    """Yields one for each of these lone hands that a correction acts on; `here`: where those with regions are."""
    hands = {one.name: one for one in felt}
    if rendering.kind is None:
        return
    for port in (one for one in rendering.ports if one.name in hands and not math.isnan(one.desired[0])):
        one, device, (k, b) = hands[port.name], port.declared, port.desired
        piece = here.get(port.name)
        least, most = rendering.desired.device.mass_spans(rendering.desired.channels)[port.channel]
        if piece is not None:
            k, b = device.stiffness + piece.stiffness, device.friction + piece.damping
            error = float(felt_error((np.array(one.k), np.array(one.b)), (k, b), one.configuration.mass))
        else:
            masses = np.geomspace(least, most, 1 if least == most else _MASSES).tolist()
            error = max(_error_with(rendering.kind, port, mass) for mass in masses)
        reached = port.reached if piece is None else error < _REACHED
        given_up = not reached and piece is None and least == most
        yield Desired(
            port.name,
            port.channel,
            k,
            b,
            *swing(device.mass, k, b),
            error=error,
            reached=reached,
            remedies=remedies_for(rendering.kind, device, port.desired) if given_up else None,
            stable_masses=one.robustness.stable_masses,
            steady_stiffness=one.robustness.steady_stiffness,
        )


def _error_with(kind: CorrectionKind, port: Corrected, mass: float) -> float:
    """`felt_error` of a hand of this mass, once an estimate of it has settled; 0 for the device alone."""
    one = port.settled(mass)
    if one.stiffness == one.damping == 0.0:
        return 0.0
    loop = kind.closed(replace(port.declared, mass=mass), replace(port.declared, mass=one.made_for), one.observer)
    return float(felt_error(loop.equivalent(one.stiffness, one.damping), port.desired, mass))
