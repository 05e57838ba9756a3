"""The force law on the board: the step of a device that moves its force along a line between two samples.

The host sends what the force would be at x = 0 and v = 0, c = F + k x_n, with the line's k and b. N times a sample,
every h = T/N, the board measures x and computes

    f[j] = c - k x[j] - b (x[j] - x[j-W])/(W h)

which acts a local delay of D periods h later. A line begins with the local period at which its c arrives, so c acts
``delay`` + D/N samples after its position. The board's memories are inner states of the channel, as those of a drive
are: the ways x[j] - x[j-1] ... x[j] - x[j-W], then the D forces under way. Between two places of rounding this is the
only difference to a device that holds the host's force: another ``DeviceStep``.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from hapsim.theory.arrays import Complexes, Floats, powered
from hapsim.theory.device_step import DeviceStep, device_step
from hapsim.theory.interface import BoardLaw, damper_named, damper_velocity, delay_and_hold, whole_and_fraction
from hapsim.theory.network.network import Network, acting_links, joined_points, part_of


def own_lines(network: Network) -> tuple[Floats, Floats]:
    """Stiffness k, N/m, and damping b, N·s/m, of each channel's line, (C,): those of all links that end there."""
    links, channels = acting_links(network), network.channel_mass.size
    place, point = joined_points(network, links)
    at, on = place[point < channels], point[point < channels]
    k, b = (np.bincount(on, of[links][at], channels) for of in (network.stiffness, network.damping))
    return np.asarray(k, float), np.asarray(b, float)


@lru_cache(maxsize=64)
def board_step(
    damping: float, stiffness: float, kappa: float, beta: float, delay: float, board: BoardLaw
) -> DeviceStep:
    """Returns the step of a mass with normalised friction b0 T/m and own spring k0 T²/m on a line of k T²/m and b T/m;
    the forces are T²/m c."""
    steps, held, window = board
    size = 2 + window + held
    local = device_step(damping / steps, 0.0, "zoh", stiffness / steps**2)
    x, v, c, *_ = one = np.eye(1 + size)[[0, 1, size, *range(2, size)]]
    ways, under_way = one[3 : 3 + window], one[3 + window :]
    computed = c - kappa * x - beta * steps / window * ways[-1]
    acting = under_way[-1] if held else computed
    moved = [
        of_state[0] * x + of_state[1] * v / steps + of_force[0] * acting / steps**2
        for of_state, of_force in zip(local.motion[:2], local.forces[:2], strict=True)
    ]
    older = [0.0 * x, *ways[:-1]]
    rows = [moved[0], steps * moved[1], *(moved[0] + old - way for old, way in zip(older, ways, strict=True))]
    rows += [new - old for new, old in zip([computed, *under_way], under_way, strict=False)]
    period = np.vstack([*rows, 0.0 * x])
    whole, fraction = whole_and_fraction(delay)
    first = round(fraction * steps)
    before, after = powered(period, first), powered(period, steps - first)
    of_state = before[:size, :size] + after[:size, :size] @ (np.eye(size) + before[:size, :size])
    of_old = before[:size, size] + after[:size, :size] @ before[:size, size]
    of_forces = np.column_stack([*np.zeros((whole, size)), after[:size, size], *([of_old] if first else [])])
    still = np.zeros((1, size)), np.zeros((1, of_forces.shape[1]))
    each = zip((of_state, of_forces), still, strict=True)
    motion, forces = (np.vstack([of[:2], none, of[1:2], of[2:]]) for of, none in each)
    motion[3, 1] += 1.0
    for shared in (motion, forces):
        shared.flags.writeable = False
    return DeviceStep(motion, forces)


def without_lines(network: Network) -> Network:
    """Returns a network whose device holds the forces of the board's lines, c, as late as they act there."""
    assert network.board is not None
    return replace(network, board=None, delay=network.delay + network.board.delay / network.board.steps)


def on_own_lines(network: Network) -> Network:
    """Returns the channels of a network alone, each on the spring and the damper of its line."""
    k, b = own_lines(network)
    alone = part_of(network, np.arange(k.size), linked=False)
    ends, damper = (
        np.column_stack([np.arange(k.size), np.full(k.size, -1)]),
        (damper_named("backward", None, 1.0),) * k.size,
    )
    return replace(alone, ends=ends, stiffness=k, damping=b, damper=damper, outside=())


def line_answers(network: Network, phi: Floats) -> Complexes:
    """Pulls (n, C), N/m, of the channels' own lines at phi radians per local period, as the board computes them."""
    board, (k, b) = network.board, own_lines(network)
    assert board is not None
    velocity = damper_velocity(damper_named("backward", None, 1.0, board.window), phi) * board.steps * network.rate
    return np.asarray(k + b * velocity[:, None])


def acting_lines(network: Network, theta: Floats) -> Complexes:
    """The same pulls as they act, (n, C, C), of a motion of theta radians per sample: the part at its own frequency."""
    assert network.board is not None
    phi = theta / network.board.steps
    through = delay_and_hold(phi, network.board.delay, "zoh", "ideal")
    return np.asarray(
        through[:, None, None] * line_answers(network, phi)[:, :, None] * np.eye(network.channel_mass.size)
    )


def power_of_lines(network: Network, theta: Floats, carried: Complexes) -> Complexes:
    """Power (n, N C, N C), N·s/m, that a board gives to hands that move at theta and at all its images at once: X* P X
    for velocities of 1 m/s in each of the N classes of images that it does not tell apart. ``carried``: (n, C, C), N/m,
    c for positions of 1 m.

    With phi the angles of the classes, X their positions as the board reads them and E the classes of a line that is
    held for N periods, the forces are E c sum(X) - L X. They act through (1 - exp(-j phi)) exp(-j phi D)/h, and of all
    motions with these X the slowest have the velocities squared X² 4 sin²(phi/2)/h².
    """
    board, hands = network.board, network.channel_mass.size
    assert board is not None
    steps = board.steps
    phi = (theta[:, None] + 2.0 * np.pi * np.arange(steps)) / steps
    period = 1.0 / (steps * network.rate)
    acts = (1.0 - np.exp(-1j * phi)) * np.exp(-1j * phi * board.delay) / period
    size = 0.5 * period / np.sin(0.5 * phi)
    first = round(network.delay * steps)
    held = np.exp(-1j * phi[..., None] * (first + np.arange(steps))).mean(axis=2)
    own = line_answers(network, phi.ravel()).reshape(*phi.shape, hands)
    one, across = np.eye(steps), acts * size * held
    lines = (acts * size**2)[..., None] * own
    whole = np.einsum("nrc,rs,cd->nrcsd", lines, one, np.eye(hands)) - np.einsum(
        "nr,ncd,ns->nrcsd", across, carried, size
    )
    return np.asarray(whole.reshape(theta.size, steps * hands, steps * hands))
