"""Driving-point impedances of a scene at its device channels, force over velocity (Florens et al., §2.2, Figures 1, 2).

Z (C, C) relates the forces on the channels to their velocities: Z[i, j] is the force on channel i while channel j
moves and the others are held. Three of them, at one frequency f, s = 2 pi j f, z = exp(s T):

* desired: the scene in continuous time, its springs, dampers and masses without sampling, hold and delay.
* rendered: the force that the loop gives back, as it acts on the real mass: of the samples of a held, late force the
  part at f itself (``late_and_held``). The velocity is the one that the device reads, s times the reading's position.
* device: the real mass, friction and spring as the loop sees them, the force that a computed one becomes over the
  velocity that is read. m s + b0 + k0/s, but for the images of the motion that sampling folds onto f.

Their sum device + rendered is what an additional force of the loop meets: the closed loop's impedance.

The points' forces and motions obey D(z) x = f (``response.py``), D over the links, the masses' inertia and 1/G
of the channels: the rendered impedance is D without 1/G, the masses eliminated. Where another scheme than CORDIS's
moves the masses, or they move in substeps, it is the inverse of the closed loop's transfer function, read from its
state, without 1/G.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapsim.theory.arrays import Complexes
from hapsim.theory.hand.impedance import late_and_held
from hapsim.theory.network.large_loop import factorised, sparse_transition
from hapsim.theory.network.network import Network, is_centred
from hapsim.theory.network.response import Places, SceneMatrix, on_circle
from hapsim.theory.sample import is_large, loop


class LoopImpedance(NamedTuple):
    """(n, C, C) each, N·s/m."""

    device: Complexes
    rendered: Complexes

    @property
    def closed_loop(self) -> Complexes:
        """What an additional force of the loop meets."""
        return self.device + self.rendered


def loop_impedance(network: Network, frequency: ArrayLike) -> LoopImpedance:
    """What the sampled, held and late loop is at the device channels, at frequencies (n,) in Hz; NaN from the Nyquist
    frequency on, and at 0.

    Raises:
        NotWorkedOutError: the scene is large, and its scheme's matrix is not sparse.
    """
    f = np.asarray(frequency, dtype=float)
    theta = 2.0 * np.pi * f / network.rate
    some = (theta > 0.0) & (theta < np.pi)
    angle = theta[some]
    places, matrix = on_circle(angle), SceneMatrix(network)
    functions, plants = matrix.without_plants(matrix.functions(places))
    channels = network.channel_mass.size
    inverse_plant = plants[:, :, None] * np.eye(channels)
    if is_centred(network):
        scene = _eliminated(matrix, functions, channels)
    else:
        scene = _by_state(network, places, inverse_plant)
    through = late_and_held(angle, network.delay, network.hold, network.sampling) / (2j * np.pi * f[some])
    found = np.full((2, f.size, channels, channels), np.nan, dtype=complex)
    found[:, some] = np.stack([inverse_plant, scene]) * through[:, None, None]
    return LoopImpedance(*found)


def desired_impedance(network: Network, frequency: ArrayLike) -> Complexes:
    """(n, C, C) N·s/m at frequencies (n,) in Hz above 0: the scene in continuous time, every damper an ideal one. The
    device's own mass, friction and spring are not in it."""
    s = 2j * np.pi * np.asarray(frequency, dtype=float)
    matrix = SceneMatrix(network)
    found = _eliminated(matrix, matrix.ideal_functions(s), network.channel_mass.size)
    return np.asarray(found / s[:, None, None])


def _eliminated(matrix: SceneMatrix, functions: Complexes, channels: int) -> Complexes:
    """(n, C, C): force over position on the channels, the simulated masses left to themselves."""
    out = np.zeros((functions.shape[1], channels, channels), dtype=complex)
    for n in range(functions.shape[1]):
        whole = matrix.sparse(functions[:, n])
        out[n] = whole[:channels, :channels].toarray()
        if whole.shape[0] > channels:
            across = whole[channels:, :channels].toarray()
            solve = factorised(whole[channels:, channels:])
            inner = np.full_like(across, np.nan) if solve is None else solve(across)
            out[n] -= np.asarray(whole[:channels, channels:] @ inner)
    return out


def _by_state(network: Network, places: Places, inverse_plant: Complexes) -> Complexes:
    """(n, C, C): force over the positions that are read, of the scene, a force added to the computed ones."""
    channels = network.channel_mass.size
    read, force = np.zeros((2, places.z.size, channels, channels), dtype=complex)
    if is_large(network):
        operator = sparse_transition(network)
        for n, place in enumerate(places.z.tolist()):
            inverse = operator.inverse(place)
            read[n] = np.nan if inverse is None else -operator.points[:channels] @ inverse(operator.push + 0j)
        return np.asarray(np.linalg.inv(read) - inverse_plant, complex)
    change, points, push, asked, _ = loop(network, inputs=True)
    for n, w in enumerate(places.w):
        state = np.linalg.solve(w * np.eye(len(change)) - change, push[:, :channels])
        read[n], force[n] = points[:channels] @ state, asked @ state
    return np.asarray(-force @ np.linalg.inv(read))
