"""What a motion found by iterations says of its pole, which it knows better than they do: Rayleigh's quotients.

A pole's motion x makes D(z) x zero (``response.py`` has D), and where no velocity comes from the device D is
symmetric. So x' D(z) x is zero at a z that is as much nearer to the pole than x is to the motion as a square is to its
root. Of two poles of which the motions are almost one, those of a slow swing beside 1, iterations find the mean well
and the difference badly: they move such a pole off the circle, by the root of rounding and more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Bools, Complexes, Floats
from hapsim.theory.interface import DamperModel
from hapsim.theory.network.layout import damping_links
from hapsim.theory.network.network import Network, acting_links, is_centred
from hapsim.theory.network.response import channel_answer, damper_answer
from hapsim.theory.network.state import channel_steps

STEPS = 5
BESIDE = 1e-4  # of z - 1: how far from z the slope is taken
NEAR = 1e-5  # a pole that would move further is left where it was found
ROUNDING = float(np.finfo(float).eps)


def refined(network: Network, poles: Complexes, motions: NDArray) -> Complexes:
    """The poles (n,) moved to where x' D(z) x is zero; ``motions`` (points, n), of which the poles are about known."""
    if not is_centred(network) or any(damper.senses for damper in damping_links(network)):
        return poles
    form = _Form(network, motions)
    w = poles - 1.0
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            aside = BESIDE * w
            slope = (form.at(w + aside) - form.at(w - aside)) / (2.0 * aside)
            w = w - form.at(w) / slope
    moved = 1.0 + w
    return np.where(np.abs(moved - poles) < NEAR, moved, poles)


def at_rest(network: Network, poles: Complexes, motions: NDArray, same: float) -> Bools:
    """(n,) which of the poles within ``same`` of 1 are those of motions that stretch nothing, and not a brake's."""
    inertia = _masses(network) @ np.abs(motions) ** 2 * network.rate
    stretch = np.abs(_stretches(network, motions)) ** 2
    own = np.abs(motions[: network.channel_mass.size]) ** 2
    links = acting_links(network)
    stiffness = network.stiffness[links] @ stretch + network.channel_stiffness @ own
    damping = (network.damping[links] @ stretch + network.channel_friction @ own) / inertia
    w = poles - 1.0
    rests = (damping**2 < ROUNDING) | (np.abs(w) <= np.abs(w + damping))  # z = 1, not 1 - damping
    result: Bools = (np.abs(stiffness) < ROUNDING * inertia * network.rate) & (np.abs(w) < same) & rests
    return result


class _Form:
    """x' D(1 + w) x of several motions x at once, each at its own w."""

    def __init__(self, network: Network, motions: NDArray) -> None:
        square = motions**2
        stretch = _stretches(network, motions) ** 2
        channels = network.channel_mass.size
        self._steps = channel_steps(network)
        self._channels = (network.channel_mass * network.rate**2)[:, None] * square[:channels]
        self._masses = network.point_mass @ square[channels:] * network.rate**2
        self._springs = network.stiffness[acting_links(network)] @ stretch
        place = {link: i for i, link in enumerate(acting_links(network).tolist())}
        self._dampers: list[tuple[DamperModel, Complexes]] = [
            (damper, network.damping[links] * network.rate @ stretch[[place[link] for link in links.tolist()]])
            for damper, links in damping_links(network).items()
        ]

    def at(self, w: Complexes) -> Complexes:
        """x' D(z) x at z = 1 + w, of each motion, for w of their shape."""
        z = 1.0 + w
        total = self._masses * w * w / z + self._springs
        for damper, weight in self._dampers:
            total = total + weight * damper_answer(damper, z, w)
        for step, weight in zip(self._steps, self._channels, strict=True):
            total = total + weight / channel_answer(step, z, w)[0]
        return np.asarray(total, complex)


def _masses(network: Network) -> Floats:
    return np.concatenate([network.channel_mass, network.point_mass])


def _stretches(network: Network, motions: NDArray) -> NDArray:
    """(links that act, n)."""
    padded = np.vstack([motions, np.zeros((1, motions.shape[1]))])  # a ground, -1, is the last
    first, second = network.ends[acting_links(network)].T
    return np.asarray(padded[first] - padded[second])
