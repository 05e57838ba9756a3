"""Predicted impedance of a scene's loop at its device points, by frequency; and the device's Z-width."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hapsim.prediction.characteristic import places_of, scene_at
from hapsim.prediction.correction import rendered
from hapsim.prediction.linear import configuration_of, network_of, network_of_hand, stand_in_for
from hapsim.prediction.timing import on_wire
from hapsim.scene import Scene
from hapsim.theory import Network, NotWorkedOutError
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.hand.configuration import StiffestWall, stiffest_passive, stiffest_stable
from hapsim.theory.network.impedance import desired_impedance, loop_impedance


@dataclass(frozen=True)
class PredictedImpedance:
    """Driving-point impedances (n, C, C), N·s/m, at frequencies (n,) in Hz: the force on a device point over the
    velocity of another while the others are held. ``theory/network/impedance.py`` defines each."""

    names: tuple[str, ...]
    """Names of the device points (C,), in the scene's order."""
    frequency: Floats
    desired: Complexes
    """Impedance of the scene in continuous time, without the device."""
    device: Complexes
    """Impedance of the real mass, friction and spring as the loop sees them."""
    ideal_device: Complexes
    """Impedance m s + b0 + k0/s of each device point."""
    rendered: Complexes
    """Impedance that the sampled, held and delayed scene presents."""
    assumptions: tuple[str, ...]
    """Sentences: the linear forms that were assumed."""

    @property
    def closed_loop(self) -> Complexes:
        """Impedance that an additional force in the loop meets."""
        return self.device + self.rendered


def predict_impedance(scene: Scene, frequency: ArrayLike, *, as_read: bool = False) -> PredictedImpedance:
    """Returns the impedances at the device points of `scene`; NaN from the Nyquist frequency on. With a correction, the
    rendered impedance is that of the corrected scene. If a large scene's scheme cannot be computed, CORDIS's stands in
    for it, and an assumption reports this. Behind a transmission or a lagging motor they are those of a hand on the
    handle; `as_read`: of the loop's own force over the velocity that is read, as `measure_impedance` identifies."""
    scene.require_impedance("a force that is rendered has one")
    f = np.asarray(frequency, dtype=float)
    rendering = rendered(scene)
    (network, desired), assumptions = _networks(rendering.seen, scene)
    network = rendering.on_device(network)
    try:
        loop = loop_impedance(network, f, as_read=as_read)
    except NotWorkedOutError as reason:
        instead, sentence = stand_in_for(network, reason)
        assumptions.append(sentence)
        loop = loop_impedance(instead, f, as_read=as_read)
    if any(one.senses for one in network.predictors):
        assumptions.append("the rendered impedance behind a predictor that reads velocities is not worked out")
    s = 2j * np.pi * f[:, None]
    real = network.channel_mass * s + network.channel_friction + network.channel_stiffness / s
    ideal = real[:, :, None] * np.eye(network.channel_mass.size)
    if network.mass_coupling is not None:
        ideal = ideal + s[:, :, None] * network.mass_coupling
    return PredictedImpedance(
        names=tuple(scene.device_points),
        frequency=f,
        desired=desired_impedance(desired, f),
        device=loop.device,
        ideal_device=ideal,
        rendered=loop.rendered,
        assumptions=tuple(assumptions),
    )


def _networks(run: Scene, desired: Scene) -> tuple[tuple[Network, Network], list[str]]:
    """Returns both scenes as arrays, and sentences on the linear forms that were assumed."""
    if run.space == 1:
        linear = scene_at(run)
        taken = [*linear.assumptions, *places_of(run)]
        return (network_of(run, linear)[0], network_of(desired, scene_at(desired))[0]), taken
    from hapsim.prediction.predict_plane import PlanePrediction

    one = PlanePrediction(run, with_margins=False)
    return (one.network, one.network), [*one.assumptions]


@dataclass(frozen=True)
class ZWidth:
    """Range of a device, from itself alone to its stiffest wall K/s + B (Colgate and Brown, 1994), at frequencies (n,)
    in Hz, in dB: 20 log10 of the larger of the two impedances over the device's."""

    frequency: Floats
    wall: StiffestWall
    width_db: Floats
    """Width in dB, (n,)."""


def z_width_of(scene: Scene, channel: int, frequency: ArrayLike) -> dict[str, ZWidth]:
    """Returns the Z-width of the device's channel by name: "stable", to the stiffest wall that is stable with the
    declared mass; and "passive", to the stiffest that is stable in every hand, if this is derived for the hold and
    sampling. As `measure_impedance` sees the device: at the position that is read."""
    c = configuration_of(on_wire(scene), channel)
    f = np.asarray(frequency, dtype=float)
    walls = {"stable": stiffest_stable(c)}
    with contextlib.suppress(ValueError):
        walls = {"passive": stiffest_passive(c)} | walls
    found, read = {}, replace(c, ahead=None)
    for name, wall in walls.items():
        damping = wall.damping - wall.stiffness * c.spring_lag * c.period
        loop = loop_impedance(network_of_hand(read, wall.stiffness, damping), f, as_read=True)
        found[name] = ZWidth(f, wall, width_db(loop.device[:, 0, 0], loop.closed_loop[:, 0, 0]))
    return found


def width_db(device: Complexes, with_wall: Complexes) -> Floats:
    """Z-width in dB at each frequency, (n,), from the impedances of the device alone and with the wall."""
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(with_wall) / np.abs(device), 1.0)))


def mean_width(frequency: Floats, width: Floats) -> float:
    """Mean width in dB over the logarithm of the frequency."""
    if frequency.size < 2:
        return math.nan
    along = np.log(frequency)
    return float(np.trapezoid(width, along) / (along[-1] - along[0]))


def decades_of(frequency: Floats, width: Floats) -> list[tuple[float, float, float]]:
    """List of (from, to, mean width in dB) for each decade."""
    first, last = math.floor(math.log10(frequency[0])), math.ceil(math.log10(frequency[-1]))
    found = []
    for decade in range(first, last):
        inside = (frequency >= 10.0**decade) & (frequency <= 10.0 ** (decade + 1))
        if np.count_nonzero(inside) >= 2:
            f = frequency[inside]
            found.append((float(f[0]), float(f[-1]), mean_width(f, width[inside])))
    return found
