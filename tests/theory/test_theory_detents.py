"""Detents that hold, snaps that are crossed in a sample, and the energy of a flank."""

from __future__ import annotations

import itertools
import json
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hapsim.cli.check_regions import hand_lines
from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene
from hapsim.measuring.measure import measure
from hapsim.prediction import Region, predict
from hapsim.prediction.characteristic import hand_at
from hapsim.scene import Scene, parse_scene

Floats = NDArray[np.float64]
PITCH, DEPTH = math.radians(15.0), 0.03
KNOB = {"clock": "lockstep", "motion": "rotary", "mass": 5.0e-5, "friction": 5.0e-4, "delay": 1, "force_limit": 0.3}
LINE = {"clock": "lockstep", "mass": 0.1, "friction": 1.0, "delay": 1, "force_limit": 20}


def scene_of(device: dict[str, Any], rate: float = 2000.0, **links: dict[str, Any]) -> Scene:
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "frame": {"type": "ground"}}
    modules |= {name: {"between": ["hand", "frame"]} | one for name, one in links.items()}
    return parse_scene(json.dumps({"version": 1, "rate": rate, "device": device, "modules": modules}))


def held(**values: Any) -> dict[str, Any]:
    return {"type": "detent", "depth": 5.0} | values


def forces_along(scene: Scene, way: Floats) -> Floats:
    """N, with which the hand pushes along this way, m."""
    program, force = compile_scene(scene), np.zeros((way.size, 1))
    start(program, way[:1])
    for n in range(way.size):
        tick(program, way[n : n + 1], np.zeros(1), force[n])
    return -force[:, 0]


def work(scene: Scene, way: Floats, since: int = 0) -> float:
    """J, that the hand does along it, from this sample on."""
    force, way = forces_along(scene, way)[since:], way[since:]
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(way)))


def random_detent(rng: np.random.Generator) -> dict[str, Any]:
    ways = rng.uniform(5e-3, 3e-2, int(rng.integers(1, 5)))
    free, hold = float(rng.uniform(0.0, 0.4) * ways.min()), float(rng.uniform(0.5, 1.49))
    if rng.random() < 0.3:
        return held(pitch=float(ways[0]), hold_until=hold, dead_zone=min(free, 0.4 * ways[0]))
    more: dict[str, Any] = {"stop": float(rng.uniform(0.0, 500.0))} if hold <= 1.0 else {"stop": 0.0}
    if rng.random() < 0.3:
        more["only"] = sorted({int(k) for k in rng.integers(0, ways.size + 1, 3)})
    return held(places=[0.0, *np.cumsum(ways).tolist()], hold_until=hold, dead_zone=free, **more)


@pytest.mark.parametrize("seed", range(8))
def test_no_closed_way_gets_energy_from_a_detent_that_holds(seed: int) -> None:
    """The hand comes back to where it began, in the same place."""
    rng = np.random.default_rng(seed)
    scene = scene_of(LINE, it=random_detent(rng))
    ends = rng.permutation([-0.05, 0.2])  # beyond all places: there it is in the same one whatever the way
    turns = np.array([*ends, *rng.uniform(-0.02, 0.08, 20), *ends, ends[0]])
    pieces = [np.linspace(a, b, 400, endpoint=False) for a, b in itertools.pairwise(turns)]
    way = np.array([*np.concatenate(pieces), ends[0]])
    since = 400  # from then on it is in the place of the second end
    way = np.array([*way, *np.linspace(ends[0], ends[1], 400)])
    assert work(scene, way, since) > -1e-3  # jumps are met within a step


@pytest.mark.parametrize(
    ("hold", "free"), [(0.5, 0.0), (0.55, 1e-3), (0.8, 0.0), (1.0, 2e-3), (1.1, 2e-3), (1.4, 1e-3)]
)
def test_a_passage_costs_what_the_page_states(hold: float, free: float) -> None:
    p = 0.02
    scene = scene_of(LINE, it=held(pitch=p, hold_until=hold, dead_zone=free))
    stiffness = 5.0 / (hold * p - free)
    expected = 0.5 * stiffness * ((hold * p - free) ** 2 - max(0.0, abs(1.0 - hold) * p - free) ** 2)
    way = np.linspace(0.0, 5.0 * p, 20_001)
    assert work(scene, way, since=8_000) == pytest.approx(3.0 * expected, rel=2e-3, abs=1e-4)  # steady by then
    one = np.linspace(0.0, p, 20_001)
    assert float(np.trapezoid(scene.links["it"].law().pull(one, 1.0), one)) == pytest.approx(expected, abs=1e-5)


def test_a_place_that_holds_for_half_the_way_is_a_saw() -> None:
    way = np.random.default_rng(3).uniform(-0.3, 0.3, 2000)
    force = forces_along(scene_of(LINE, it=held(pitch=0.02, hold_until=0.5)), way)
    u = way - 0.02 * np.floor(way / 0.02 + 0.5)
    assert force == pytest.approx(u * 5.0 / 0.01, abs=1e-12)


@pytest.mark.parametrize(
    ("link", "at"),
    [
        (held(pitch=0.02, hold_until=1.1, damping=0.5), 0.045),
        (held(places=[0.0, 0.012, 0.04], hold_until=0.55, dead_zone=1e-3, damping=1.0), 0.025),
        (held(places=[0.0, 0.012, 0.04], hold_until=1.2, stop=900.0, damping=1.0), -0.004),
    ],
)
def test_in_each_place_a_hand_feels_what_is_predicted(link: dict[str, Any], at: float) -> None:
    scene = scene_of(LINE, 1000.0, it=link)
    region = predict(scene, at=at).parts[0].region_here
    found = measure(scene, at=at)
    assert region is not None
    assert found.k == pytest.approx(region.felt.k, rel=1e-4)
    assert found.b == pytest.approx(region.felt.b, abs=1e-3)


# Snaps


def table_of(points: Any) -> dict[str, Any]:
    return {"type": "nonlinear", "force_over_distance": [[float(x), float(y)] for x, y in points]}


def sine_table(count: int, noise: float, seed: int) -> dict[str, Any]:
    """Two pitches to both sides, `count` points in each; noise as a share of the depth."""
    x = np.arange(-2 * count, 2 * count + 1) * PITCH / count
    error = noise * np.random.default_rng(seed).normal(size=x.size)
    return table_of(zip(x, DEPTH * (np.sin(2.0 * np.pi * x / PITCH) + error), strict=True))


def snaps_of(scene: Scene) -> list[Region]:
    return [one for one in predict(scene, with_margins=False).regions["hand"] if one.kind == "snap"]


def test_a_snaps_energy_is_that_of_its_flank_however_many_points_draw_it() -> None:
    damper = {"type": "damper", "damping": 0.002}
    sine = snaps_of(scene_of(KNOB, it={"type": "detent", "pitch": PITCH, "depth": DEPTH}, damper=damper))
    assert sine[0].snap_energy == pytest.approx(DEPTH * PITCH / 2.0, rel=1e-4)
    table = snaps_of(scene_of(KNOB, it=sine_table(24, 0.0, 0), damper=damper))
    assert [one.snap_energy for one in table] == pytest.approx([sine[0].snap_energy] * len(table), rel=1e-3)
    for seed in range(3):
        recorded = snaps_of(scene_of(KNOB, it=sine_table(24, 0.005, seed), damper=damper))
        assert [one.snap_energy for one in recorded] == pytest.approx([sine[0].snap_energy] * len(recorded), rel=0.02)


def test_many_pieces_of_a_flank_are_one_row_with_its_stiffness() -> None:
    damper = {"type": "damper", "damping": 0.002}
    regions = predict(scene_of(KNOB, it=sine_table(24, 0.0, 0), damper=damper)).regions["hand"]
    hand = regions[0].hand
    assert len(regions) == 91
    rest = hand.flank_at(0.0)
    assert rest is not None
    assert (rest.low, rest.high) == pytest.approx((-PITCH / 4.0, PITCH / 4.0))
    assert rest.stiffness == pytest.approx(4.0 * DEPTH / PITCH)
    lines = [str(cell) for line in hand_lines("hand", regions) for cell in getattr(line, "rows", [line])]
    assert any("11 pieces" in one and "0.4584 to 0.7118" in one for one in lines), lines


def test_a_flank_ends_where_the_force_is_level() -> None:
    notch = {"type": "detent", "pitch": 0.05, "depth": 2.0, "shape": "notch", "sharpness": 5.0}
    regions = snaps_of(scene_of(LINE, it=notch))
    assert [one.snap_energy for one in regions] == pytest.approx([0.5 * 2.0 * 0.0025] * len(regions))
    level = table_of([(-0.02, -1.0), (-0.01, 1.0), (0.0, 1.0), (0.001, 0.4), (0.02, 0.4), (0.03, 2.0)])
    (snap,) = snaps_of(scene_of(LINE, it=level))
    assert snap.snap_energy == pytest.approx(0.5 * 0.6 * 0.001)


def test_a_turn_of_the_force_counts_from_a_twentieth_of_the_deepest_fall() -> None:
    def flanks(dip: float) -> int:
        points = [(0.0, 0.0), (0.01, 1.0), (0.02, 0.4), (0.021, 0.4 + dip), (0.03, 0.0), (0.04, 2.0)]
        return len(hand_at(scene_of(LINE, it=table_of(points)), "hand").flanks)

    assert (flanks(0.04), flanks(0.06)) == (3, 5)


def saw_table(width: float, fall: float) -> dict[str, Any]:
    """Four detents of 20 mm whose force falls by `fall` N within `width` m."""
    half, low = 0.5 * width, 0.5 * fall
    ends = [(0.02 * n + side * (0.01 - half), side * low) for n in range(4) for side in (-1.0, 1.0)]
    return table_of(ends)


@pytest.mark.parametrize(("width", "is_crossed"), [(1e-9, True), (1e-6, True), (0.99e-4, True), (1.01e-4, False)])
def test_nobody_rests_in_a_fall_that_a_hand_crosses_in_a_sample(width: float, is_crossed: bool) -> None:
    """0.1 m/s at 1 kHz are 0.1 mm. Spread over that way the fall of 2 N drives a hand on, and shakes none."""
    scene = scene_of(LINE, 1000.0, it=saw_table(width, 2.0), damper={"type": "damper", "damping": 1.0})
    snaps = snaps_of(scene)
    assert {one.crossed for one in snaps} == {is_crossed}
    assert {one.kind for one in snaps} == {"snap"}
    assert predict(scene, with_margins=False).stable
    assert all(one.piece.stiffness == pytest.approx(-2.0 / width, rel=1e-3) for one in snaps)


def test_a_pair_that_grows_in_such_a_fall_counts() -> None:
    """Spread over the way of a sample, 1000 N are as steep as the loop cannot render."""
    scene = scene_of(LINE, 1000.0, it=saw_table(1e-6, 1000.0), damper={"type": "damper", "damping": 1.0})
    snaps = snaps_of(scene)
    assert all(one.crossed and not one.is_stable for one in snaps)
    assert sum(abs(pole) > 1.0 for pole in snaps[0].felt.poles) > 1


def test_a_mass_in_a_table_with_such_a_fall_is_judged_alike() -> None:
    def stable(width: float) -> bool:
        modules = {
            "hand": {"type": "device", "channel": 0},
            "frame": {"type": "ground"},
            "slider": {"type": "mass", "mass": 0.1},
            "tie": {"type": "viscoelastic", "between": ["hand", "slider"], "stiffness": 300.0, "damping": 1.0},
            "brake": {"type": "damper", "between": ["slider", "frame"], "damping": 1.0},
            "saw": {"between": ["slider", "frame"]} | saw_table(width, 2.0),
        }
        document = {"version": 1, "rate": 1000.0, "device": LINE, "modules": modules}
        return bool(predict(parse_scene(json.dumps(document)), with_margins=False).stable)

    assert stable(1e-6)
    assert stable(1e-4)
