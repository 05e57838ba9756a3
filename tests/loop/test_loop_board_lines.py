"""The lines of `law: board` beside a second description: the law of a hand as a function, searched on a fine grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from board_device import FASTEST, LIMIT, MASS, RATE, BoardDevice, Rig, board_line, host_line, scene_with

from hapsim.prediction import predict
from tests import thorough

WIDE = 0.05  # m, to both sides of the hand: farther than any piece of these laws that ends


@dataclass
class Referee:
    """The law of a hand on grounds at 0, by the tables of its links."""

    links: Sequence[Any]

    def __call__(self, x: Any) -> Any:
        force = np.zeros(np.shape(x))
        for link in self.links:
            side = 1.0 if link.between[0] == "hand" else -1.0
            force = force - side * link.law().tension(side * np.asarray(x, float))
        return force

    def knots(self, x: float) -> Any:
        every = set()
        for link in self.links:
            law, side = link.law(), 1.0 if link.between[0] == "hand" else -1.0
            ends = sorted((side * (x - WIDE), side * (x + WIDE)))
            every |= {side * edge for edge in law.edges_between(*ends)}
        return np.array(sorted(every))

    def stiffness(self, x: float) -> float:
        near = 1e-9
        return float(self(x - near) - self(x + near)) / (2.0 * near)

    def damping(self, x: float, free: bool) -> float:
        """Damping of all links at x, or of those that are no contacts, N·s/m."""
        sides = [(link.law(), 1.0 if link.between[0] == "hand" else -1.0) for link in self.links]
        return sum(float(law.damping_along(side * x)) for law, side in sides if not (free and law.pushes))

    def _extremes(self, low: float, high: float) -> tuple[float, float]:
        knots = self.knots(low)
        forces = self(np.concatenate([np.linspace(low, high, 4001), knots[(knots > low) & (knots < high)]]))
        return float(forces.min()), float(forces.max())

    def line(self, x: float, v: float, delay: float) -> tuple[list[float], float, float]:
        """Returns the line, the place of its damping, and its least distance from a decision, m."""
        way, lead = v / RATE, delay + 0.1
        begin, end = x + way * lead, x + way * (lead + 1.0)
        middle = 0.5 * (begin + end)
        reach = abs(way) * (delay + 2.0) + 0.5 * LIMIT / MASS * ((delay + 2.0) / RATE) ** 2
        knots, bounds = self.knots(x), [*self._extremes(x - reach, x + reach)]
        stretch = sorted((begin, end))
        pieces = [p for p in pairwise(knots) if p[1] > stretch[0] and p[0] < stretch[1]]
        unsure = [abs(knot - place) for knot in knots for place in (begin, middle, end, x - reach, x + reach)]
        unsure += [abs(high - low - abs(way)) for low, high in pieces]
        if any(high - low < abs(way) for low, high in pieces):
            chord = float(self(begin) - self(end)) / (end - begin)
            inside = np.linspace(begin, end, 20001)
            off = np.abs(self(inside) - self(begin) + chord * (inside - begin)).max()
            follows = chord > 0.0 and off <= 0.1 * np.ptp(self(inside))
            k = chord if follows else max(self.stiffness(begin), 0.0)
            unsure.append(abs(off - 0.1 * np.ptp(self(inside))) * 1e-3)
            return [float(self(begin)) + k * (begin - x), k, *bounds], begin, min(unsure)
        at, k = middle, self.stiffness(middle)
        stays = self.stiffness(x)
        unsure += [abs(knot - x) for knot in knots]
        if stays > max(k, 0.0) + 1e-3 and any(min(x, middle) < one < max(x, middle) for one in knots):
            at, k, middle = x, stays, x  # a stiffer piece is left only once the hand is out of it
        left = max([k for k in knots if k <= middle], default=-math.inf)
        right = min([k for k in knots if k > middle], default=math.inf)
        bounds = self._with_piece(bounds, left, right, middle)
        beside = min((x - left, left, -1.0), (right - x, right, 1.0), key=lambda one: abs(one[0]))
        unsure.append(abs(abs(x - left) - abs(right - x)) if len(knots) > 1 else 1.0)
        unsure.append(abs(abs(beside[0]) - reach))
        is_bound = self(middle) <= bounds[0] + 1e-6 or self(middle) >= bounds[1] - 1e-6
        if abs(k) < 1e-3 and is_bound and abs(beside[0]) <= reach:
            _, edge, way_out = beside
            following = [one for one in knots if (one - edge) * way_out > 1e-12]
            following = min(following, key=lambda one: abs(one - edge), default=edge + 2.0 * way_out * reach)
            place = 0.5 * (edge + following)
            if abs(self.stiffness(place)) > 1e-3:
                at, k = place, self.stiffness(place)
                far = following if following in knots else way_out * math.inf
                bounds = self._with_piece(bounds, min(edge, far), max(edge, far), place)
        return [float(self(at)) + k * (at - x), k, *bounds], at, min(unsure)

    def _with_piece(self, bounds: list[float], left: float, right: float, at: float) -> list[float]:
        ends = [float(self(one)) for one in (left, right) if math.isfinite(one)]
        k = self.stiffness(at)
        if abs(k) > 1e-3:
            ends += [math.copysign(math.inf, k)] * bool(left == -math.inf)
            ends += [-math.copysign(math.inf, k)] * bool(right == math.inf)
        return [min(bounds[0], *ends), max(bounds[1], *ends)] if ends else bounds


TABLE = {"type": "nonlinear", "force_over_distance": [[-0.01, -5], [0, 0], [0.002, 4], [0.01, 8]]}
MANY = {
    "type": "nonlinear",
    "force_over_distance": [[x, 60.0 * x + 4e6 * x**3] for x in np.linspace(-0.01, 0.01, 201).round(6).tolist()],
}
LAWS: dict[str, dict[str, Any]] = {
    "spring": {"a": {"type": "spring", "stiffness": 700}},
    "viscoelastic": {"a": {"type": "viscoelastic", "stiffness": 2000, "damping": 5}},
    "damper": {"a": {"type": "damper", "damping": 3}},
    "contact": {"a": {"type": "buffer", "stiffness": 10000, "damping": 4, "distance": 0.001}},
    "contact from below": {"a": {"type": "buffer", "stiffness": 3000, "damping": 1, "between": ["wall", "hand"]}},
    "table": {"a": TABLE},
    "table of many": {"a": MANY},
    "sine": {"a": {"type": "detent", "pitch": 0.003, "depth": 1.5, "damping": 0.3}},
    "snap": {"a": {"type": "detent", "pitch": 0.002, "depth": 1, "damping": 0.5, "shape": "snap"}},
    "notch": {"a": {"type": "detent", "pitch": 0.004, "depth": 1, "shape": "notch", "between": ["wall", "hand"]}},
    "click": {"a": {"type": "click", "travel": 0.004, "peak": 3, "drop": 2, "bottom": 4000, "damping": 1}},
    "contact on a spring": {
        "a": {"type": "buffer", "stiffness": 8000, "damping": 2},
        "b": {"type": "viscoelastic", "stiffness": 300, "damping": 1},
    },
    "detents in a table": {"a": TABLE, "b": {"type": "detent", "pitch": 0.003, "depth": 0.7, "shape": "snap"}},
}


@pytest.mark.thorough(keep=8)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("delay", [1.0, 5.0])
def test_a_line_follows_the_law_where_it_will_act_and_bounds_it_where_the_hand_gets(law: str, delay: float) -> None:
    scene = scene_with(LAWS[law])
    rig, referee = Rig(scene, delay), Referee(list(scene.links.values()))
    chance, judged = np.random.default_rng(len(law)), 0
    count = thorough.points(25, 60)
    for _ in range(count):
        x, v = chance.uniform(-0.012, 0.012), chance.choice([-1.0, 1.0]) * 10.0 ** chance.uniform(-3.0, 0.0)
        wanted, at, unsure = referee.line(x, v, delay)
        if unsure < 1e-7:  # a decision that rounding takes
            continue
        judged += 1
        force, k, b, low, high = rig.line(x, v)
        widest = referee.damping(x if law == "damper" else at, free=True) * FASTEST
        assert b == pytest.approx(referee.damping(at, free=False), abs=1e-12), (x, v)
        assert k == pytest.approx(wanted[1], rel=1e-5, abs=1e-3), (x, v)
        assert force == pytest.approx(wanted[0], rel=1e-6, abs=1e-5), (x, v)
        assert [low + widest, high - widest] == pytest.approx(wanted[2:], rel=1e-4, abs=2e-3), (x, v)
    assert judged > 0.6 * count


@pytest.mark.parametrize("law", ["contact", "table", "table of many", "snap", "click", "detents in a table"])
@pytest.mark.parametrize("delay", [1.0, 5.0])
def test_a_prediction_simulates_hands_on_the_same_lines(law: str, delay: float) -> None:
    """Also at speeds at which a hand reaches all knots of a table."""
    scene, chance, count = scene_with(LAWS[law], device={"delay": delay}), np.random.default_rng(len(law)), 100
    rig, (part,) = Rig(scene, delay), predict(scene, with_margins=False).lined
    rig.own.law.fastest_way = part.fastest / RATE
    x, speed = chance.uniform(-0.012, 0.012, count), 10.0 ** chance.uniform(-3.0, 0.0, count)
    v = speed * chance.choice([-1.0, 1.0], count)
    ends = np.repeat(part.fixed[:, None], count, axis=1)
    with np.errstate(all="ignore"):
        simulated = part.hands[0].line(x, v / RATE, ends, 0.0 * ends)
    found = np.array([rig.line(*each) for each in zip(x, v, strict=True)]).T
    found[3:] = np.clip(found[3:], -LIMIT, LIMIT)
    np.testing.assert_array_equal(simulated[5], x)
    np.testing.assert_allclose(simulated[:5], found, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize(("stiffness", "rebound"), [(2000.0, 1.0238), (10000.0, 1.0541)])
@pytest.mark.parametrize("delay", [1, 5])
def test_a_wall_throws_back_what_hits_it_at_the_same_speed_wherever_the_samples_fall(
    stiffness: float, rebound: float, delay: int
) -> None:
    """Host's law: 1.28 and 1.72 times the impact at delay 1, 2.26 and 4.7 at delay 5, with a local period more."""
    rig, speeds = Rig(scene_with({"wall_": {"type": "buffer", "stiffness": stiffness}}), delay), []
    for phase in np.arange(6) / 6.0:
        device, answer = BoardDevice(3e-4 * (10.0 + phase), -0.3, delay=delay, window=1), board_line(rig)
        for _ in range(120):
            device.sample(answer)
        speeds.append(device.v / 0.3)
    assert speeds == pytest.approx([rebound] * 6, abs=1e-4)


DETENTS = {
    "sine": {"type": "detent", "pitch": 1e-3, "depth": 0.32},
    "snap": {"type": "detent", "pitch": 1e-3, "depth": 0.32, "shape": "snap"},
    "saw": {"type": "detent", "pitch": 1e-3, "depth": 0.32, "shape": "snap", "sharpness": 1e6},
    "notch": {"type": "detent", "pitch": 1e-3, "depth": 0.32, "shape": "notch", "sharpness": 3},
}


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("shape", DETENTS)
@pytest.mark.parametrize(("speed", "delay"), [(0.0517, 2), (0.2071, 1), (0.5137, 5)])
def test_detents_give_a_launched_hand_less_energy_than_the_host_s_law(shape: str, speed: float, delay: int) -> None:
    scene = scene_with({"detents": DETENTS[shape]})
    law, pitch = scene.links["detents"].law(), 1e-3
    places = np.linspace(0.0, pitch, 4001)
    forces = -law.tension(places)
    stored = np.concatenate([[0.0], -np.cumsum(0.5 * (forces[1:] + forces[:-1])) * (places[1] - places[0])])
    rig, gained = Rig(scene, delay), []
    for kind in (host_line(lambda x: float(np.interp(x % pitch, places, forces))), board_line(rig)):
        device, most = BoardDevice(2e-4, speed, friction=1.0, delay=delay), 0.0
        for _ in range(700):
            device.sample(kind)
            given = float(np.interp(device.x % pitch, places, stored) - np.interp(2e-4, places, stored))
            most = max(most, device.work + given)
        gained.append(most)
    assert gained[1] < 0.8 * gained[0]


@pytest.mark.parametrize(("delay", "least_unstable"), [(1, 27600.0), (2, 13500.0)])
def test_a_mass_behind_the_line_enters_with_its_place_at_the_next_sample(delay: int, least_unstable: float) -> None:
    """With its place at the position's own sample the limits would be 13 452 and 8800 N/m."""
    swings = []
    for share in (0.97, 1.03):
        modules = {"body": {"type": "mass", "mass": 0.5}}
        links = {
            "coupling": {"type": "viscoelastic", "stiffness": share * least_unstable, "damping": 5},
            "spring": {"type": "viscoelastic", "stiffness": 3000, "damping": 2, "between": ["body", "wall"]},
        }
        links["coupling"]["between"] = ["hand", "body"]
        rig, device = (
            Rig(scene_with(links, modules=modules), delay),
            BoardDevice(0.0, 0.01, friction=1.0, delay=delay, window=1),
        )
        answer = board_line(rig)
        x = [device.sample(answer) for _ in range(1500)]
        swings.append(np.ptp(x[-300:]) / np.ptp(x[300:600]))
    assert swings[0] < 1.0 < swings[1]
