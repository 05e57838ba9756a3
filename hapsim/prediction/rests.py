"""Where a steady push holds a hand, and the masses that it moves, in a state of their contacts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hapsim.laws import Law
from hapsim.prediction.linear import LinearScene
from hapsim.prediction.pieces import State
from hapsim.prediction.reach import beginnings, stretches_at_the_beginning
from hapsim.prediction.swings import Rest, Swing, Swinging, has_pieces
from hapsim.scene import Scene
from hapsim.theory import Network
from hapsim.theory.arrays import Floats
from hapsim.theory.network import part_of
from hapsim.theory.rows import stretches_of

_INSIDE = 1e-2  # m: so far from the only edge of a state a hand is, where it need not press more than it can
_STILL = 1e-12  # of the hand's way: a link that is stretched by less of it is not stretched


def swing_of_part(
    scene: Scene,
    linear: LinearScene,
    network: Network,
    points: Sequence[str],
    inside: Sequence[int],
    grown: Sequence[tuple[float, State]],
) -> Swing | None:
    """How large a swing gets in a part of the scene, from where it rests in states in which something grows.

    Args:
        inside: the numbers of the part's points, ascending, which no link joins to another.
        grown: by how much in a sample, and the state.

    Returns:
        None also where the part has several hands, masses that pull themselves, or links that remember. It is never
        unnoticed where something grows in a state that has no rest, or while a damper is fast.
    """
    names, begins = [points[point] for point in inside], beginnings(scene)
    hands = [name for name in names if name in scene.device_points]
    if not names or any(one.pulls_itself for name, one in scene.material_points.items() if name in names):
        return None
    numbers = np.flatnonzero(np.isin(network.ends, inside).any(axis=1)).tolist()
    part, of_link = part_of(network, np.array(inside)), [*linear.links, *("" for _ in linear.inner)]
    links = {i: of_link[link] for i, link in enumerate(numbers) if of_link[link]}
    laws = {i: law for i, name in links.items() if has_pieces(law := scene.links[name].law())}
    channel = scene.device_points[hands[0]].channel if hands else 0
    travel, quantum = scene.device.travels(scene.channels)[channel], scene.mock_device.quantum[channel]
    swinging = Swinging(part, names, laws, scene.device.force_limit, travel, quantum)
    if not laws or not swinging.is_simulated:
        return None
    stretch = stretches_at_the_beginning(scene, linear)[numbers]
    fixed = stretch - stretches_of(part, sparse=False) @ np.array([begins[name] for name in names])
    rests = []
    for growth, state in grown:
        springs = part.stiffness.copy(), part.damping.copy()
        pieces = dict.fromkeys(laws, (-math.inf, math.inf))
        for i, name in links.items():
            if name in state:
                springs[0][i], springs[1][i] = state[name].linear.stiffness, state[name].linear.damping
                pieces[i] = state[name].near(stretch[i])
        there = replace(part, stiffness=springs[0], damping=springs[1])
        is_moving = any(law.speeds and springs[1][i] != law.linear().damping for i, law in laws.items())
        rests.append(
            None if is_moving else rest_in(there, fixed, laws, pieces, travel, scene.device.force_limit, growth)
        )
    found = [one for one in rests if one is not None]
    return swinging.swing_at(found, is_all=len(found) == len(rests))


def rest_in(
    network: Network,
    fixed: Floats,
    laws: Mapping[int, Law],
    pieces: Mapping[int, tuple[float, float]],
    travel: tuple[float, float],
    force_limit: float,
    growth: float,
) -> Rest | None:
    """Where the part of a scene with one hand or none rests in the middle of this state, pressed no harder than the
    force limit lets it; None where it does nowhere.

    Args:
        network: the part, as its links are in this state.
        fixed: (L,) m, what ends that do not move add to each link's distance.
        laws, pieces: of the links that have several pieces, by number; from where to where this one goes, m.
        travel: of the hand, m. growth: in the state, of a sample.
    """
    stretches, hands, stiffness = stretches_of(network, sparse=False), network.channel_mass.size, network.stiffness
    force = stiffness * fixed
    for link, law in laws.items():
        low, high = pieces[link]
        middle = 0.5 * (low + high) if math.isfinite(high - low) else low if math.isfinite(low) else high
        middle = middle if math.isfinite(middle) else 0.0
        force[link] = float(law.tension(middle)) + stiffness[link] * (fixed[link] - middle)
    # The masses rest where they do with the hand at 0, and move evenly with it.
    of_masses, of_hand = stretches[:, hands:], stretches[:, :hands].sum(axis=1)
    wanted = np.array([-of_masses.T @ force, -of_masses.T @ (stiffness * of_hand)]).T
    try:
        masses = np.linalg.solve(of_masses.T @ (stiffness[:, None] * of_masses), wanted)
    except np.linalg.LinAlgError:
        return None
    begin, slope = of_masses @ masses[:, 0] + fixed, of_masses @ masses[:, 1] + of_hand
    low, high = travel if hands else (0.0, 0.0)
    for link, ends in pieces.items():
        if abs(slope[link]) > _STILL:
            near, far = sorted((end - begin[link]) / slope[link] for end in ends)
            low, high = max(low, near), min(high, far)
        elif not ends[0] <= begin[link] <= ends[1]:
            return None
    press, rise = (-float(of_hand @ one) for one in (force + stiffness * (begin - fixed), stiffness * slope))
    low, high = pressed_within(low, high, press, rise, force_limit)
    if not low <= high:
        return None
    x = _place(low, high)
    distances = [float(begin[link] + slope[link] * x) for link in laws]
    return Rest(x, distances, press + rise * x, min(far - near for near, far in pieces.values()), growth)


def pressed_within(low: float, high: float, press: float, rise: float, most: float) -> tuple[float, float]:
    """The part of a way, m, in which a force of press + rise x does not exceed `most`, N; empty where there is none."""
    if not rise:
        return (low, high) if abs(press) <= most else (math.inf, -math.inf)
    near, far = sorted((side * most - press) / rise for side in (-1.0, 1.0))
    return max(low, near), min(high, far)


def _place(low: float, high: float) -> float:
    if math.isfinite(high - low):
        return 0.5 * (low + high)
    return low + _INSIDE if math.isfinite(low) else high - _INSIDE if math.isfinite(high) else 0.0
