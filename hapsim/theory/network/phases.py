"""Several ports over all phases of their clocks: the worst one, and the least and largest of values.

The clocks of two ports drift through every phase. Values are computed on an even grid of the ports' phases against the
first, both ends included, and their extremes are refined along each port's phase, by parabolas over shorter and shorter
steps.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.network.network import Network
from hapsim.theory.sample import loop, several_clocks, state_size

Phases = tuple[float, ...]

PHASES = 32
"""Phases of two ports on the grid."""
_MOST = 256  # phases of more ports on the grid
_MANY_STATES, _FEW = 100, 8  # numbers in the state above which an eigenvalue problem takes long; phases then
_FINEST = 2e-4  # sample periods between the phases of the last refinement
_SHORTER = 8.0  # times, each refinement
_RESTS = 1.0 + 1e-9  # a positive real pole up to here rests, or decays without an oscillation


def moving_ports(network: Network) -> list[int]:
    """Ports that have points, but the first: their phases against it vary. Empty with one clock."""
    if network.clocks is None or not network.clocks.phases:
        return []
    return sorted({*network.clocks.port})[1:]


def phases_on_axis(network: Network) -> int:
    """Number of phases on the grid of each moving port; 1 with one clock."""
    moving = len(moving_ports(network))
    if not moving:
        return 1
    each = PHASES if moving < 2 else max(2, int(_MOST ** (1.0 / moving) + 1e-9))
    return each if state_size(network) <= _MANY_STATES else min(each, _FEW)


def at_phases(network: Network, phases: Phases) -> Network:
    """Returns the network at other phases."""
    assert network.clocks is not None
    return replace(network, clocks=network.clocks._replace(phases=phases))


def extremes(network: Network, value: Callable[[Phases], Floats]) -> tuple[Floats, Floats]:
    """Returns the least and the largest of each of the values (n,) of the phases; NaN where one is NaN."""
    grid, known = _grid(network), dict[Phases, Floats]()

    def values(at: Phases) -> Floats:
        if at not in known:
            known[at] = np.asarray(value(at), float)
        return known[at]

    every = np.array([values(at) for at in grid])
    ends = every.min(axis=0), every.max(axis=0)
    for sign, end in zip((-1.0, 1.0), ends, strict=True):
        for n in np.flatnonzero(np.isfinite(end)).tolist():
            best = grid[int(np.argmax(sign * every[:, n]))]
            best = _refined(lambda at, n=n, sign=sign: sign * float(values(at)[n]), best, network)  # type: ignore[misc]
            end[n] = values(best)[n]
    return ends


def at_worst_phase(network: Network) -> Network:
    """Returns the network at the phases at which a motion grows most, or an oscillation decays most slowly; itself with
    one clock."""
    return worst_loop(network)[0] if moving_ports(network) else network


@np.errstate(all="ignore")
def worst_loop(network: Network) -> tuple[Network, Floats]:
    """Returns the same, and the change of its loop there."""
    if not moving_ports(network):
        return network, loop(network).change
    ports = several_clocks(network)

    def growth(at: Phases) -> float:
        """Returns the size of the largest pole that does not rest, at these phases."""
        change = ports.change(at)
        if not np.isfinite(change).all():
            return np.inf
        poles = 1.0 + np.linalg.eigvals(change).astype(complex)
        rests = (poles.imag == 0.0) & (poles.real > 0.0) & (poles.real <= _RESTS)
        return float(np.abs(poles[~rests]).max(initial=0.0))

    worst = _refined(growth, max(_grid(network), key=growth), network)
    return at_phases(network, worst), ports.change(worst)


def _grid(network: Network) -> list[Phases]:
    clocks, moving = network.clocks, moving_ports(network)
    if clocks is None or not moving:
        return [() if clocks is None else clocks.phases]
    axis = np.linspace(0.0, 1.0, phases_on_axis(network)).tolist()
    still = (0.0,) * len(clocks.interfaces)
    every = itertools.product(axis, repeat=len(moving))
    return [_with(still, dict(zip(moving, at, strict=True))) for at in every]


def _with(phases: Phases, changed: dict[int, float]) -> Phases:
    return tuple(changed.get(port, phase) for port, phase in enumerate(phases))


def _refined(value: Callable[[Phases], float], best: Phases, network: Network) -> Phases:
    """Returns the phases at which the value is largest, near those."""
    step = 1.0 / max(1, phases_on_axis(network) - 1)
    while step > _FINEST:
        for port in moving_ports(network):
            at = best[port]
            tries = [_with(best, {port: one}) for one in (at - step, at + step) if 0.0 <= one <= 1.0]
            if len(tries) > 1:
                low, here, high = value(tries[0]), value(best), value(tries[1])
                bend = low - 2.0 * here + high
                vertex = at + 0.5 * step * (low - high) / bend if bend < 0.0 else at
                tries.append(_with(best, {port: min(max(vertex, at - step), at + step)}))
            best = max([best, *tries], key=value)
        step /= _SHORTER
    return best
