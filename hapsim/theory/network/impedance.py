"""Driving-point impedances of a scene at its device channels, force over velocity (Florens et al., §2.2, Figures 1, 2).

Z (C, C) relates the forces on the channels to their velocities: Z[i, j] is the force on channel i while channel j moves
and the others are held. Three of them, at one frequency f, s = 2 pi j f, z = exp(s T):

* desired: the scene in continuous time, its springs, dampers and masses without sampling, hold and delay.
* rendered: the force of the loop as it acts on the real mass: of a held, delayed force the part at f itself
  (``delay_and_hold``). The velocity is the one that the device reads, s times the reading's position.
* device: the real mass, friction and spring as the loop sees them: the held, delayed force over the velocity that is
  read. It is m s + b0 + k0/s, except for the images of the motion that sampling folds onto f.

Of channels with drives (``plant.py``) they are those that the handles present to a hand's force, which does not act
where the computed one does: with X_p, X_f the handles' motion after pushes and after held forces, and Y_p, Y_f that of
the readings, the scene's forces H Y move them by X_p - X_f H (1 + Y_f H)^-1 Y_p.

Their sum device + rendered is the impedance of the closed loop, which an additional force in the loop meets.

An additional force f moves the loop's state by (w - change)^-1 push f, w = z - 1. From this state the positions and the
forces of the scene are read. For a reading of 1, f is 1/G, where G is the device's response. A predictor knows such a
force, but not the hand's. So behind one the reading itself is moved, with every velocity reading unmoved.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.board_lines import acting_lines, on_own_lines, without_lines
from hapsim.theory.interface import delay_and_hold
from hapsim.theory.network.crossings import in_blocks, on_circle
from hapsim.theory.network.felt import matrices, static_stiffness
from hapsim.theory.network.large_loop import PIVOTS, factorised, sparse_transition
from hapsim.theory.network.network import Network, is_centred, part_of
from hapsim.theory.plant import answers
from hapsim.theory.rows import times, unit_rows
from hapsim.theory.sample import is_large, loop, plants_of, state_size

Answer = Callable[[Complexes], Complexes]
"""Matrices at w = z - 1 (n,), from a loop that is made once."""

_REST = 1e-6j  # z - 1 at which hardly anything moves
MOST_DENSE = 60  # numbers in the state; above, sparse rows are faster
LOST = 1e15  # a state that grows by more in a sample has no digit left


class LoopImpedance(NamedTuple):
    """Impedances of a loop, each (n, C, C), N·s/m."""

    device: Complexes
    rendered: Complexes

    @property
    def closed_loop(self) -> Complexes:
        """Impedance that an additional force in the loop meets."""
        return self.device + self.rendered


def loop_impedance(network: Network, frequency: ArrayLike, *, as_read: bool = False) -> LoopImpedance:
    """Returns the impedances of the sampled, held and delayed loop at the device channels, at frequencies (n,) in Hz;
    NaN at 0 and from the Nyquist frequency on. Behind a predictor that reads velocities `rendered` is NaN. ``as_read``:
    of channels with drives too, those of the computed forces over the velocities that are read.

    Raises:
        NotWorkedOutError: the scene is large, and its scheme's matrix is not sparse.
    """
    f, channels = np.asarray(frequency, dtype=float), network.channel_mass.size
    theta = 2.0 * np.pi * f / network.rate
    some = (theta > 0.0) & (theta < np.pi)
    w, held = on_circle(theta[some]), network if network.board is None else without_lines(network)
    through = delay_and_hold(theta[some], held.delay, network.hold, network.sampling) / (2j * np.pi * f[some])
    found = np.full((2, f.size, channels, channels), np.nan, dtype=complex)
    found[0, some] = device_matrix(held)(w)
    found[1, some] = _loop_forces(network)(w)[0]
    if network.drives and not as_read:
        found[:, some] = _at_handles(network, theta[some], found[:, some])
    else:
        found[:, some] *= through[:, None, None]
    if network.board is not None:
        found[1, some] += acting_lines(network, theta[some]) / (2j * np.pi * f[some])[:, None, None]
    found[1, :] *= math.nan if any(one.senses for one in network.predictors) else 1.0
    return LoopImpedance(*found)


def _at_handles(network: Network, theta: Floats, loop: Complexes) -> Complexes:
    """Impedances (2, n, C, C), N·s/m, of the handles alone, and what the scene adds, at theta; ``loop``: as of
    `_loop_forces`, of the device without links first."""
    s, one = np.asarray(1j * theta, complex), np.eye(network.channel_mass.size)
    held = delay_and_hold(theta, network.delay, network.hold, network.sampling)[:, None, None]
    unit = network.channel_mass[:, None, None] * network.rate**2
    of_each = [np.concatenate(answers(plant, s), axis=1) for plant in plants_of(network)]  # (n, 2, 2)
    (_, Y_p), (X_f, X_p) = (np.moveaxis(of_each / unit[..., None], 0, 3)[..., None] * one).transpose(1, 2, 0, 3, 4)
    alone, asked = loop
    moved = X_p - held * X_f @ asked @ np.linalg.solve(one + np.linalg.solve(alone, asked), Y_p)
    each = np.array([np.linalg.inv(X_p), np.linalg.inv(moved)]) / (s * network.rate)[:, None, None]
    return np.array([each[0], each[1] - each[0]])


def desired_impedance(network: Network, frequency: ArrayLike) -> Complexes:
    """Impedance (n, C, C), N·s/m, of the scene in continuous time with ideal dampers, at frequencies (n,) in Hz above
    0. It does not include the device's own mass, friction and spring."""
    channels = network.channel_mass.size
    none = np.zeros(channels)
    _, Z, K = matrices(replace(network, channel_friction=none, channel_stiffness=none), sparse=True)
    inertia = times(np.concatenate([none, network.point_mass]), unit_rows(K.shape[0], True))
    found = []
    for s in 2j * np.pi * np.asarray(frequency, dtype=float):
        whole = (K + s * Z + s**2 * inertia).tocsc()
        force, across = whole[:channels, :channels].toarray(), whole[channels:, :channels].toarray()
        if across.size:
            solve = factorised(whole[channels:, channels:])
            force = force - whole[:channels, channels:] @ solve(across) if solve else np.nan * force
        found.append(force / s)
    return np.array(found, complex).reshape(-1, channels, channels)


def device_matrix(network: Network) -> Answer:
    """Forces (n, C, C), N z^n, that produce a reading of 1 m z^n on one channel and of 0 on the others, without links,
    over w = z - 1 (n,); on a board with its lines."""
    channels = network.channel_mass.size
    alone = part_of(network, np.arange(channels), linked=False) if network.board is None else on_own_lines(network)
    forces, kept = _loop_forces(alone), np.eye(channels) if network.mass_coupling is None else 1.0
    return lambda w: np.asarray(forces(w)[1] * kept)


def device_forces(network: Network, w: Complexes) -> Complexes:
    """Forces (n, C), N z^n, that produce a reading of 1 m z^n on each channel alone, at w = z - 1 (n,); of coupled
    channels, while the others are held."""
    return np.asarray(np.diagonal(device_matrix(network)(w), axis1=1, axis2=2))


def steady_stiffness(network: Network) -> Floats:
    """Stiffness (C, C), N/m, that steady pushes on the hands meet, the device's own springs included."""
    if not network.predictors:
        return static_stiffness(network)
    at_rest = replace(network, scheme="cordis", substeps=1)  # masses at rest are so under every scheme
    pulls = _loop_forces(at_rest)(np.array([_REST]))[0, 0].real
    return np.asarray(pulls + np.diag(network.channel_stiffness))


@np.errstate(all="ignore")  # numbers out of range become NaN
def _loop_forces(network: Network) -> Answer:
    """Forces (2, n, C, C), N z^n, for a reading of 1 m z^n on one channel and of 0 on the others: those with which the
    scene pulls its channels back, and those that have to be added; with predictors the additions to the readings."""
    channels, size = network.channel_mass.size, state_size(network)
    sparse = is_centred(network) and size > MOST_DENSE
    if is_large(network) and not sparse:
        return (lambda w: _unknown(w, channels)) if network.predictors else _by_transition(network)
    change, points, push, asked, _, misread = loop(network, inputs=True, sparse=sparse)
    # The state and the added forces are solved in one system, so that no divisor is the motion of a force. A reading
    # moves the state of its own sample, z = 1 + w times.
    push, later = (misread[:, :channels],) * 2 if network.predictors else (push[:, :channels], 0.0 * push[:, :channels])
    direct = unit_rows(channels, sparse) * float(bool(network.predictors))
    rows, right = [[-change, -push], [points[:channels], direct]], np.eye(size + channels, channels, -size) + 0j

    @np.errstate(all="ignore")
    def dense(w: Complexes) -> Complexes:
        found = _unknown(w, channels)
        for part in in_blocks(w.size if bounded else 0, len(still)):
            with suppress(np.linalg.LinAlgError):  # numbers too far apart
                state = np.linalg.solve(w[part, None, None] * moving + still, right)
                found[:, part] = -asked @ state[:, :size], state[:, size:]
        return found

    @np.errstate(all="ignore")
    def of_sparse_rows(w: Complexes) -> Complexes:
        from scipy.sparse import bmat

        found = _unknown(w, channels)
        for n, place in enumerate(w.tolist()):
            whole = bmat([[place * unit_rows(size, True) + rows[0][0], rows[0][1] - place * later], rows[1]])
            solve = factorised(whole, **PIVOTS)
            state = np.full(right.shape, np.nan) if solve is None else solve(right)
            found[:, n] = -asked @ state[:size], state[size:]
        return found

    if sparse:
        return of_sparse_rows
    still, moving, bounded = np.block(rows), np.eye(size + channels), np.abs(change).max(initial=0.0) < LOST
    moving[size:], moving[:size, size:] = 0.0, -later
    return dense


def _by_transition(network: Network) -> Answer:
    """Returns the answer of a large scene that has no sparse rows, without predictors."""
    moved, channels = sparse_transition(network), network.channel_mass.size

    @np.errstate(all="ignore")
    def forces(w: Complexes) -> Complexes:
        found = _unknown(w, channels)
        for n, place in enumerate(w.tolist()):
            inverse = moved.inverse(1.0 + place)
            state = np.full(moved.push.shape, np.nan) if inverse is None else -inverse(moved.push + 0j)
            found[1, n] = np.linalg.inv(moved.points[:channels] @ state)
            found[0, n] = -moved.forces(state) @ found[1, n]
        return found

    return forces


def _unknown(w: Complexes, channels: int) -> Complexes:
    return np.full((2, w.size, channels, channels), complex(np.nan, np.nan))


def spring_and_damper(frequency: Floats, impedance: Complexes) -> tuple[Floats, Floats]:
    """Returns k in N/m and b in N·s/m with this impedance, N·s/m, at each frequency in Hz; k of a mass is negative."""
    return np.asarray(-2.0 * np.pi * frequency * impedance.imag), impedance.real
