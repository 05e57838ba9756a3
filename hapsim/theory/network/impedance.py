"""Driving-point impedances of a scene at its device channels, force over velocity (Florens et al., §2.2, Figures 1, 2).

Z (C, C) relates the forces on the channels to their velocities: Z[i, j] is the force on channel i while channel j
moves and the others are held. Three of them, at one frequency f, s = 2 pi j f, z = exp(s T):

* desired: the scene in continuous time, its springs, dampers and masses without sampling, hold and delay.
* rendered: the force that the loop gives back, as it acts on the real mass: of the samples of a held, late force the
  part at f itself (``late_and_held``). The velocity is the one that the device reads, s times the reading's position.
* device: the real mass, friction and spring as the loop sees them, the force that a computed one becomes over the
  velocity that is read. m s + b0 + k0/s, but for the images of the motion that sampling folds onto f.

Their sum device + rendered is what an additional force of the loop meets: the closed loop's impedance.

The points' forces and motions obey D(z) x = f (``margin_response.py``), D over the links, the masses' inertia and 1/G
of the channels: the rendered impedance is D without 1/G, the masses eliminated. Where another scheme than CORDIS's
moves the masses, it is the inverse of the closed loop's transfer function, read from its state, without 1/G.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.hand.impedance import late_and_held
from hapsim.theory.interface import DamperModel
from hapsim.theory.network.layout import layout_of
from hapsim.theory.network.margin_response import PAIRS, channel_answer, damper_answer
from hapsim.theory.network.network import Network, acting_links, is_centred
from hapsim.theory.network.sparse import factorised
from hapsim.theory.network.state import channel_steps, is_large, transition
from hapsim.theory.network.transitions import operator_of


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
    z = np.exp(1j * angle)
    w = -2.0 * np.sin(0.5 * angle) ** 2 + 1j * np.sin(angle)  # z - 1, to all its digits
    answers = [channel_answer(step, z, w) for step in channel_steps(network)]
    channels = network.channel_mass.size
    inverse_plant = np.zeros((angle.size, channels, channels), dtype=complex)
    for c, (position, _) in enumerate(answers):
        inverse_plant[:, c, c] = network.channel_mass[c] * network.rate**2 / position
    if is_centred(network):
        scene = _eliminated(network, w * w / z * network.rate**2, _velocities(network, z, w, answers))
    else:
        scene = np.asarray(np.linalg.inv(_by_state(network, z)) - inverse_plant, complex)
    through = late_and_held(angle, network.delay, network.hold, network.sampling) / (2j * np.pi * f[some])
    found = np.full((2, f.size, channels, channels), np.nan, dtype=complex)
    found[:, some] = np.stack([inverse_plant, scene]) * through[:, None, None]
    return LoopImpedance(*found)


def desired_impedance(network: Network, frequency: ArrayLike) -> Complexes:
    """(n, C, C) N·s/m at frequencies (n,) in Hz above 0: the scene in continuous time, every damper an ideal one. The
    device's own mass, friction and spring are not in it."""
    s = 2j * np.pi * np.asarray(frequency, dtype=float)
    step = s / network.rate  # an ideal damper's velocity, in metres per sample period
    links = [(step, step)] * len(network.ends)
    return np.asarray(_eliminated(network, s**2, links) / s[:, None, None])


def _velocities(
    network: Network, z: Complexes, w: Complexes, answers: list[tuple[Complexes, Complexes]]
) -> list[tuple[Complexes, Complexes]]:
    """(L,) pairs: what each link's damper has as the velocity of its two ends, over their positions."""
    by_damper: dict[DamperModel, Complexes] = {}
    found = []
    for damper, ends in zip(network.damper, network.ends, strict=True):
        if damper not in by_damper:
            by_damper[damper] = damper_answer(damper, z, w)
        sensed = [damper.senses and 0 <= end < network.channel_mass.size for end in ends]
        own = [
            answers[end][1] / answers[end][0] if s else by_damper[damper] for end, s in zip(ends, sensed, strict=True)
        ]
        found.append((own[0], own[1]))
    return found


def _eliminated(network: Network, inertia: Complexes, velocities: list[tuple[Complexes, Complexes]]) -> Complexes:
    """(n, C, C): force over position on the channels, the simulated masses left to themselves.

    ``inertia`` (n,): force over position of 1 kg. ``velocities``: of each link's ends, in metres per sample period.
    """
    channels, points = network.channel_mass.size, network.channel_mass.size + network.point_mass.size
    out = np.zeros((inertia.size, channels, channels), dtype=complex)
    rows, columns, entry = _entries(network, inertia, velocities)
    for n in range(inertia.size):
        whole = _sparse(rows, columns, entry(n), points)
        out[n] = whole[:channels, :channels].toarray()
        if points > channels:
            across = whole[channels:, :channels].toarray()
            solve = factorised(whole[channels:, channels:])
            inner = np.full_like(across, np.nan) if solve is None else solve(across)
            out[n] -= np.asarray(whole[:channels, channels:] @ inner)
    return out


def _entries(
    network: Network, inertia: Complexes, velocities: list[tuple[Complexes, Complexes]]
) -> tuple[NDArray[np.intp], NDArray[np.intp], Callable[[int], Complexes]]:
    """Rows, columns and, for frequency n, the values of D without the channels' 1/G; those of one place add up."""
    channels, masses = network.channel_mass.size, network.point_mass.size
    acting = acting_links(network)
    ends, stiffness = network.ends[acting], network.stiffness[acting]
    damping = network.damping[acting] * network.rate
    seen = np.array([velocities[link] for link in acting]).reshape(acting.size, 2, inertia.size)
    own = channels + np.arange(masses)
    rows, columns, weights = [own], [own], []
    for row, column in PAIRS:
        met = (ends[:, row] >= 0) & (ends[:, column] >= 0)
        rows.append(ends[met, row])
        columns.append(ends[met, column])
        weights.append((1.0 if row == column else -1.0, met, column))

    def entry(n: int) -> Complexes:
        values: list[NDArray] = [network.point_mass * inertia[n]]
        for sign, met, column in weights:
            values.append(sign * (stiffness[met] + damping[met] * seen[met, column, n]))
        return np.concatenate(values)

    return np.concatenate(rows), np.concatenate(columns), entry


def _sparse(rows: NDArray[np.intp], columns: NDArray[np.intp], values: Complexes, size: int) -> Any:
    import scipy.sparse

    return scipy.sparse.csc_matrix((values, (rows, columns)), (size, size))


def _by_state(network: Network, z: Complexes) -> Complexes:
    """(n, C, C): the positions that are read, over forces added to the computed ones."""
    channels = network.channel_mass.size
    entering = _entering(network)
    out = np.zeros((z.size, channels, channels), dtype=complex)
    if not is_large(network):
        matrix, one = transition(network), np.eye(len(entering))
        for n, place in enumerate(z):
            out[n] = np.linalg.solve(place * one - matrix, entering)[:channels]
        return out
    operator = operator_of(network)
    for n, place in enumerate(z):
        inverse = operator.inverse(complex(place))
        out[n] = np.nan if inverse is None else -inverse(entering.astype(complex))[:channels]
    return out


def _entering(network: Network) -> Floats:
    """(size, C): the state at the next sample, out of a force of 1 N that is computed at this one."""
    steps = channel_steps(network)
    layout = layout_of(network, steps)
    out = np.zeros((layout.size, len(steps)))
    for c, step in enumerate(steps):
        slots = [layout.position.start + c, layout.velocity.start + c, c, int(layout.mean_velocity[c])]
        share = 1.0 / (network.channel_mass[c] * network.rate**2)
        for slot, forces in zip(slots, step.forces, strict=True):
            if slot >= 0:
                out[slot, c] = forces[0] * share
        if layout.held.stop > layout.held.start:
            out[layout.held.start + c, c] = share
    return out
