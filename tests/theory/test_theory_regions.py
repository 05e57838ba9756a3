"""The regions of a hand on contacts, tables, clicks, detents and friction: against a scan of the force, by formula."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from hapsim.errors import UsageError
from hapsim.prediction import Region, predict, warnings_about
from hapsim.scene import parse_scene
from tests import thorough
from tests.piecewise_scenes import TRAVEL, as_scene, formulas, random_scene

SCENES = thorough.points(10, 25)
STEP = 1e-6  # m, of the scan
LEVEL = 2e-10  # N, over a fifth of that


def scanned(document: dict[str, Any], *, sticks: bool) -> list[tuple[float, float, float, float]]:
    """(from, to, K, B) wherever slope and damping stay the same, by differences of the force every micrometre."""
    x = np.arange(TRAVEL[0], TRAVEL[1] + 0.5 * STEP, STEP)
    force, damping = formulas(document, x, sticks=sticks)
    slope, damping = np.diff(force) / STEP, damping[:-1]
    alike = (np.abs(np.diff(slope)) <= 1e-5 * np.abs(slope).max()) & (np.diff(damping) == 0.0)
    starts = np.flatnonzero(~alike) + 1
    found = []
    for first, last in zip([0, *starts], [*starts, slope.size], strict=True):
        if last - first > 3:  # the step across an edge is between two regions
            middle = (first + last) // 2
            found.append((x[first], x[last], slope[middle], damping[middle]))
    return found


def _width(region: Region) -> float:
    return region.piece.high - region.piece.low


def flank_energy(document: dict[str, Any], low: float, high: float) -> float:
    """J, of the flank on which this snap is: outwards from its middle, until the force is level or turns back by a
    twentieth of the deepest fall. Of a shallower snap its own."""
    x = np.linspace(*TRAVEL, 200_001)
    force = formulas(document, x, sticks=False)[0]
    least = 0.05 * float(np.max(np.maximum.accumulate(force) - force))
    ends = []
    for way in (-1, 1):
        best = at = int(np.searchsorted(x, 0.5 * (low + high)))
        begin = at
        while 0 <= at < x.size and way * (force[at] - force[best]) <= least:
            if at != begin and abs(force[at] - force[at - way]) <= LEVEL:
                break
            best = at if way * (force[at] - force[best]) <= 0.0 else best
            at += way
        ends.append(best)
    flank = slice(ends[0], ends[1] + 1)
    if force[ends[0]] - force[ends[1]] <= least:
        x = np.linspace(low, high, 1001)
        force, flank = formulas(document, x, sticks=False)[0], slice(None)
    x, force = x[flank], force[flank]
    return float(max(np.trapezoid(force.max() - force, x), np.trapezoid(force - force.min(), x)))


@pytest.mark.parametrize("seed", range(SCENES))
def test_no_region_is_missed_and_none_invented(seed: int) -> None:
    document = random_scene(seed)
    regions = predict(as_scene(document), with_margins=False).regions["hand"]
    has_friction = "rub" in document["modules"]
    for sticks in {True, not has_friction}:
        ours = [one for one in regions if bool(one.piece.sliding) != sticks and _width(one) > 5.0 * STEP]
        scan = scanned(document, sticks=sticks)
        assert len(ours) == len(scan)
        for region, (low, high, stiffness, damping) in zip(ours, scan, strict=True):
            assert (region.piece.low, region.piece.high) == pytest.approx((low, high), abs=3.0 * STEP)
            assert region.piece.stiffness == pytest.approx(stiffness, rel=1e-6, abs=1e-3)
            assert region.piece.damping == pytest.approx(damping, rel=1e-12)
            assert region.kind == ("free" if abs(stiffness) < 1e-3 else "held" if stiffness > 0.0 else "snap")
            if region.kind == "snap" and sticks != has_friction:
                expected = flank_energy(document, region.piece.low, region.piece.high)
                assert region.snap_energy == pytest.approx(expected, rel=2e-3)


def plucked(seed: int) -> dict[str, Any]:
    """A hand on a plectrum and a table, each with its ground within the travel or somewhat beyond."""
    draw = np.random.default_rng(seed)
    at = np.sort(draw.uniform(-0.02, 0.02, 5))
    release = float(draw.uniform(0.001, 0.008))
    plectrum = {
        "between": ["hand", "far"],
        "stiffness": float(draw.uniform(50, 900)),
        "release": release,
        "damping": 1.0,
    }
    modules: dict[str, Any] = {
        "hand": {"type": "device", "channel": 0},
        "wall": {"type": "ground"},
        "far": {"type": "ground", "position": float(draw.uniform(-0.018, 0.018))},
        "pick": {"type": "plectrum"} | plectrum,
    }
    if draw.random() < 0.7:
        points = [[float(x), float(f)] for x, f in zip(at, np.cumsum(draw.uniform(-0.6, 1.0, 5)), strict=True)]
        modules["table"] = {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": points}
    device = {"clock": "lockstep", "mass": 0.2, "friction": 2.0, "stiffness": float(draw.choice([0.0, 150.0]))}
    limits = {"delay": 0.0, "force_limit": 20.0, "travel": [-0.012, 0.012], "travel_margin": 0.05}
    return {"version": 1, "rate": 1000, "device": device | limits, "modules": modules}


def plucked_force(document: dict[str, Any], x: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    modules = document["modules"]
    pick, d = modules["pick"], x - modules["far"]["position"]
    force = document["device"]["stiffness"] * x
    if -0.012 <= modules["far"]["position"] <= 0.012 or abs(modules["far"]["position"]) <= pick["release"]:
        force = force + np.where(np.abs(d) < pick["release"], pick["stiffness"] * d, 0.0)
    if "table" in modules:
        force = force + np.interp(x, *zip(*modules["table"]["force_over_distance"], strict=True))
    return force


@pytest.mark.parametrize("seed", range(SCENES))
def test_a_plectrum_s_regions_are_those_in_which_it_can_grip_and_their_energy_is_without_its_release(seed: int) -> None:
    document = plucked(seed)
    prediction = predict(as_scene(document), with_margins=False)
    regions = prediction.regions.get("hand", ())
    for region in regions:
        width = region.piece.high - region.piece.low
        x = np.linspace(region.piece.low + 1e-7 * width, region.piece.high - 1e-7 * width, 1001)
        force = plucked_force(document, x)
        slope = (force[-1] - force[0]) / (x[-1] - x[0])
        assert region.piece.stiffness + document["device"]["stiffness"] == pytest.approx(slope, rel=1e-5, abs=1e-3)
        if region.kind == "snap":
            ends = [region.piece.low, region.piece.high]
            for other in (*regions[::-1], *regions):  # falls that follow each other without a step are one flank
                for i, edge in enumerate((other.piece.high, other.piece.low)):
                    before, after = plucked_force(document, np.array([edge - 1e-9, edge + 1e-9]))
                    if other.kind == "snap" and edge == ends[i] and abs(after - before) < 1e-4:
                        ends[i] = (other.piece.low, other.piece.high)[i]
            x = np.linspace(*ends, 100_001)[1:-1]
            force = plucked_force(document, x)
            gains = np.trapezoid(force.max() - force, x), np.trapezoid(force - force.min(), x)
            assert region.snap_energy == pytest.approx(max(gains), rel=1e-3)
    if not regions:
        x = np.linspace(-0.0119, 0.0119, 1001)
        whole = document["device"]["stiffness"] + prediction.felt[0].stiffness
        assert np.allclose(plucked_force(document, x), whole * x)


KNOB = """\
version: 1
rate: 1000
device: {{mass: 0.2, friction: 1{travel}}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  {links}
"""


def test_by_default_the_hand_is_where_it_rests_and_at_a_corner_in_the_stiffer_piece() -> None:
    wall = "stop: {type: buffer, between: [hand, wall], stiffness: 1500, damping: 4}"
    prediction = predict(parse_scene(KNOB.format(travel="", links=wall)))
    assert prediction.k == pytest.approx(1548.86, abs=0.01)
    assert [one.kind for one in prediction.regions["hand"]] == ["held", "free"]
    curve = "[[-0.02, -3], [-0.01, 1], [0.01, -1], [0.02, 3]]"
    toggle = f"it: {{type: nonlinear, between: [hand, wall], force_over_distance: {curve}}}"
    prediction = predict(parse_scene(KNOB.format(travel="", links=toggle)))
    assert abs(prediction.here["hand"].place) == pytest.approx(0.0125)
    kinds = [(one.kind, one.is_stable) for one in prediction.regions["hand"]]
    assert kinds == [("free", True), ("held", True), ("snap", True), ("held", True), ("free", True)]
    assert prediction.stable
    assert predict(parse_scene(KNOB.format(travel="", links=toggle)), at=0.001).stable  # a snap is no instability
    straight = "it: {type: nonlinear, between: [hand, wall], force_over_distance: [[-0.02, -4], [0, 0], [0.02, 4]]}"
    assert len(predict(parse_scene(KNOB.format(travel="", links=straight))).regions["hand"]) == 3
    both = f"{wall}\n  soft: {{type: spring, between: [hand, wall], stiffness: 200}}"
    assert predict(parse_scene(KNOB.format(travel="", links=both)), at=0.0).felt[0].stiffness == 1700.0


def test_friction_that_sticks_does_not_move_the_place_where_a_hand_rests() -> None:
    """A spring of 300 N/m rests at 0; a bristle of 800 N/m beside it and a stop 5 mm away change nothing there."""
    links: dict[str, Any] = {
        "spring": {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 300.0, "damping": 1.0},
        "rub": {"type": "friction", "between": ["hand", "wall"], "force": 1.0, "stiffness": 800.0},
        "stop": {"type": "buffer", "between": ["hand", "wall"], "stiffness": 1500.0, "distance": -0.005},
    }
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}} | links
    device = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"}
    scene = parse_scene(json.dumps({"version": 1, "rate": 1000, "device": device, "modules": modules}))
    piece = predict(scene, with_margins=False).here["hand"]
    assert (piece.place, piece.states["stop"]) == (0.0, "apart")


def test_a_stiff_stop_that_shakes_the_hand_makes_the_scene_unstable_wherever_the_hand_is() -> None:
    links = (
        "soft: {type: viscoelastic, between: [hand, wall], stiffness: 200, damping: 1}\n"
        "  stop: {type: buffer, between: [hand, wall], stiffness: 90000, damping: 4, distance: -0.01}"
    )
    scene = parse_scene(KNOB.format(travel="", links=links))
    for at in (None, 0.0, 0.004):
        prediction = predict(scene, at=at)
        assert not prediction.stable
        assert prediction.spectral_radius > 1.0
        assert [one.is_stable for one in prediction.regions["hand"]] == [False, True]
    assert prediction.felt[0].stable


def test_a_peak_beyond_the_force_limit_is_warned_of() -> None:
    for depth, warned in ((9.0, False), (11.0, True)):
        knob = f"it: {{type: detent, between: [hand, wall], pitch: 0.1, depth: {depth}, damping: 4}}"
        scene = parse_scene(KNOB.format(travel="", links=knob))
        found = warnings_about(scene, predict(scene))
        peak = f"hand at -0.025 m: the scene's force is {depth:g} N; the force limit clips it to 10 N."
        assert (peak in found) == warned


def test_a_place_beyond_the_travel_is_an_error() -> None:
    links = "detent: {type: nonlinear, between: [hand, wall], force_over_distance: [[-0.01, -2], [0.01, 2]]}"
    scene = parse_scene(KNOB.format(travel=", travel: [-0.02, 0.02]", links=links))
    with pytest.raises(
        UsageError, match=r"at: found 0.03 m, outside the travel of hand; expected a position from -0.02"
    ):
        predict(scene, at=0.03)


def test_a_hand_that_does_not_reach_a_place_is_where_it_rests() -> None:
    second = (
        "other: {type: device, channel: 1}\n  pad: {type: buffer, between: [other, wall], stiffness: 300, damping: 1}"
    )
    links = f"stop: {{type: buffer, between: [hand, wall], stiffness: 900, damping: 3}}\n  {second}"
    travel = ", travel: [[-0.01, 0.01], [-0.001, 0.001]]"
    found = predict(parse_scene(KNOB.format(travel=travel, links=links)), at=-0.005).here
    assert {name: piece.place for name, piece in found.items()} == {"hand": -0.005, "other": pytest.approx(-0.0005)}


def test_what_repeats_is_listed_in_whole_pieces_and_reached_everywhere() -> None:
    knob = "it: {type: detent, between: [hand, wall], pitch: 0.01, depth: 1, damping: 2}"
    scene = parse_scene(KNOB.format(travel="", links=knob))
    found = predict(scene).regions["hand"]
    assert [one.kind for one in found] == ["snap", "held", "snap"]
    assert [one.piece.low for one in found] == pytest.approx([-0.0075, -0.0025, 0.0025])
    far = predict(scene, at=5.0)
    assert far.here["hand"].place == 5.0
    assert far.felt[0].stiffness == pytest.approx(200.0 * np.pi, rel=1e-9)


def test_around_a_place_the_links_of_what_moves_with_the_hand_are_as_they_rest_there() -> None:
    """A cell behind a gap of 2 mm: the hand presses it from 2 mm on, and the cell gives way by half."""
    links = (
        "c: {type: cell, mass: 0.01, stiffness: 300, damping: 0.5}\n"
        "  pad: {type: buffer, between: [c, hand], stiffness: 300, damping: 1, distance: -0.002}\n"
        "  stop: {type: buffer, between: [wall, c], stiffness: 1000, damping: 1, distance: -0.003}"
    )
    scene = parse_scene(KNOB.format(travel="", links=links))
    of_hand = {at: predict(scene, at=at).poles for at in (0.0, 0.004, 0.012)}
    assert predict(scene, at=0.004).assumptions == (
        "pad is taken as touched: its state where the masses rest",
        "stop is taken as apart: its state where the masses rest",
    )
    linear = {
        0.0: (0.0, 0.0),
        0.004: (300.0, 0.0),  # the cell rests at 1 mm
        0.012: (300.0, 1000.0),  # at (300 * 10 mm + 1000 * 3 mm) / 1600 = 3.75 mm
    }
    for at, (pad, stop) in linear.items():
        text = KNOB.format(
            travel="",
            links="c: {type: cell, mass: 0.01, stiffness: 300, damping: 0.5}\n"
            f"  pad: {{type: viscoelastic, between: [c, hand], stiffness: {pad}, damping: {pad / 300}}}\n"
            f"  stop: {{type: viscoelastic, between: [wall, c], stiffness: {stop}, damping: {stop / 1000}}}",
        )
        np.testing.assert_allclose(of_hand[at], predict(parse_scene(text)).poles, atol=1e-9)
