"""Parameters of the ports of hands that move masses, or each other: they place the slowest modes of the closed loop
where the continuous scene has them.

Each device point has two free numbers, the stiffness and the damping of its links together. So one mode of its own, two
poles, can be placed where the continuous scene has it. The prediction shows the effect on the other modes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hapsim.prediction.correction.kind import Port, distribute, with_modules
from hapsim.prediction.linear import linear_scene, network_of
from hapsim.scene import Scene
from hapsim.scene.choices import DamperScheme
from hapsim.scene.modules import Module
from hapsim.theory import Network
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.network import ContinuousMode, continuous_modes, poles_of, state_size

MOST_STATES = 200
"""Limit of the search for modes; in a larger scene the neighbours of its hands count as fixed."""

_MOVES = 0.05  # share of the hand in a mode's kinetic energy, above which the mode is one of the hand's
_ON_THE_CIRCLE = 1e-7  # rounding of the two poles of a free motion
_AT_REST = 1e-6  # of the fastest root: rounding of a motion without a restoring force
_LEAST, _MOST = 1e-3, 10.0  # times the scene's values: range of the search for the nearest
_SOLVED = 1e-9  # of the distance of the poles from z = 1


Matched = tuple[list[tuple[float, float]], bool]
"""Parameters (K, B) for each port in N/m and N·s/m, and whether they place the modes exactly."""


def is_small(scene: Scene) -> bool:
    """Returns whether the modes of this scene are searched."""
    return state_size(_network(scene)) <= MOST_STATES


def is_stable(network: Network) -> bool:
    """Returns whether every motion of the scene decays or stays constant."""
    return _is_stable(poles_of(network))


def _network(scene: Scene) -> Network:
    return network_of(scene, linear_scene(scene))[0]


def match_modes(
    desired: Scene,
    as_seen: Scene,
    ports: Sequence[Port],
    damper: DamperScheme | None,
    starts: Sequence[Sequence[tuple[float, float]]],
) -> Matched | None:
    """Returns the elements of the ports, or the nearest; None if no mode is a hand's own, or none near is stable.
    ``desired``: the scene as written. ``as_seen``: the same, with the device as the loop sees it under the correction.
    ``starts``: elements from which to search."""
    network, names = network_of(desired, linear_scene(desired))
    pairs = _targets(continuous_modes(network), [names.index(port.name) for port in ports], desired.rate)
    if len(pairs) < len(ports):
        return None
    written = np.array([[port.stiffness, port.damping] for port in ports])
    scale = np.maximum(written, 1e-3 * written.max(initial=1e-6))
    target = np.array([_sum_and_product(pair) for pair in pairs])
    unit = np.array([[abs(1.0 - pair[0]), abs(1.0 - pair[0]) ** 2] for pair in pairs])

    def poles_with(elements: Floats) -> Complexes:
        """Returns the poles with these stiffnesses and dampings of the ports, (P, 2)."""
        changed: dict[str, Module] = {}
        for port, (K, B) in zip(ports, elements.tolist(), strict=True):
            changed |= distribute(port, K, B, damper)
        return poles_of(_network(with_modules(as_seen, changed)))

    def off(x: Floats) -> Floats:
        found = _nearest_pairs(poles_with(x.reshape(-1, 2) * scale), pairs)
        return np.asarray(((found - target) / unit).ravel())

    from scipy.optimize import least_squares, root

    def stable(x: Floats, reached: bool) -> Matched | None:
        elements = x.reshape(-1, 2) * scale
        is_one = (elements >= 0.0).all() and _is_stable(poles_with(elements))
        return ([(float(K), float(B)) for K, B in elements], reached) if is_one else None

    begins = [np.array(begin).ravel() / scale.ravel() for begin in starts]
    for begin in begins:
        found = root(off, begin, options={"xtol": 1e-13}).x
        if np.abs(off(found)).max() < _SOLVED and (matched := stable(found, True)):
            return matched
    return stable(least_squares(off, np.clip(begins[-1], _LEAST, _MOST), bounds=(0.0, 2.0 * _MOST)).x, False)


def _is_stable(poles: Complexes) -> bool:
    return bool(np.abs(poles).max(initial=0.0) <= 1.0 + _ON_THE_CIRCLE)


def _targets(modes: list[ContinuousMode], hands: Sequence[int], rate: float) -> list[tuple[complex, complex]]:
    """Target poles in the z-plane, two for each hand: those of the slowest mode that moves it and is no other's; of
    real roots, the two slowest. A free motion of all points together is no mode that a link changes."""
    still = _AT_REST * max((abs(mode.root) for mode in modes), default=0.0)
    pairs, left = [], [mode for mode in modes if abs(mode.root) > still]
    for hand in hands:
        own = [mode for mode in left if mode.participation[hand] >= _MOVES and abs(mode.root.imag) < np.pi * rate]
        real = [mode for mode in own if not mode.root.imag]
        first = next((mode for mode in own if mode.root.imag or len(real) > 1), None)
        if first is None:
            continue
        second = first if first.root.imag else real[1]
        left = [mode for mode in left if mode is not first and mode is not second]
        z = np.exp(first.root / rate)
        pairs.append((complex(z), complex(np.conj(z)) if first.root.imag else complex(np.exp(second.root / rate))))
    return pairs


def _nearest_pairs(poles: Complexes, pairs: Sequence[tuple[complex, complex]]) -> Floats:
    """Sum and product of the poles nearest to each pair, (ports, 2)."""
    found, left = [], poles
    for pair in pairs:
        nearest = []
        for pole in pair:
            at = int(np.argmin(np.abs(left - pole)))
            nearest.append(complex(left[at]))
            left = np.delete(left, at)
        found.append(_sum_and_product((nearest[0], nearest[1])))
    return np.array(found)


def _sum_and_product(pair: tuple[complex, complex]) -> tuple[float, float]:
    """Sum and product of the distances of two poles from z = 1, in which slow ones keep their digits."""
    one, other = 1.0 - pair[0], 1.0 - pair[1]
    return (one + other).real, (one * other).real
