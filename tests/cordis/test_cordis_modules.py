"""Every module's compiled code against a recurrence of its own, written in Python from what its file says.

The hands of `module_scenes.py` take every branch: that they did, each test asserts.
"""

from __future__ import annotations

import itertools
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.modules.nonlinear_links import Frictions, Plectra

sys.path.insert(0, str(Path(__file__).parent))
from module_scenes import (
    HANDS,
    NUMBERS,
    SAMPLES,
    SCENES,
    Array,
    Bench,
    Numbers,
    Run,
    run_of,
    scene_of,
    scene_with,
    walk,
)

from tests.link_formulas import tension_of

#: What forces may differ by, over the largest force of the module, in double and in single precision. A mass and a cell
#: carry what was rounded on from sample to sample.
WITHIN = {"double": 1e-12, "single": 1e-6}
WITHIN_CARRIED_ON = {"double": 1e-12, "single": 2e-4}


@pytest.fixture(scope="module")
def runs() -> Callable[[str], Run]:
    """The run of each precision, done once."""
    done: dict[str, Run] = {}

    def run(precision: str) -> Run:
        if precision not in done:
            done[precision] = run_of(precision)
        return done[precision]

    return run


# The recurrences. Each takes what went in, and yields the force on the hand, sample by sample, telling its branches.

Branches = Counter[str]
Recurrence = Callable[[Run, Numbers, Branches], Iterator[float]]


def moving(points: Run, n: Numbers, hold: float, held_at: Array | None) -> Iterator[float]:
    """A hand and a mass with a spring between them; the mass held at a place that may move. By velocities."""
    name = "mass" if held_at is None else "cell"
    home = np.full(SAMPLES, n.wall) if held_at is None else held_at
    x, v = n.wall, 0.25
    before, home_before = x - v / n.rate, home[0]
    for hand, rest in zip(points.position[name], home, strict=True):
        pulled = n.soft * (x - hand)
        own = -hold * (x - rest) - hold / n.K * n.B * n.rate * ((x - rest) - (before - home_before))
        yield pulled
        before, home_before = x, rest
        v += (own - pulled) / n.mass / n.rate
        x += v / n.rate


def mass(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    return moving(points, n, 0.0, None)


def cell(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    took["the rest moved"] += int(np.count_nonzero(np.diff(points.rest["cell"])))
    return moving(points, n, n.K, points.rest["cell"])


def of_a_link(name: str) -> Recurrence:
    """The force on a hand by the formula of its link."""

    def recurrence(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
        link = scene_of("double" if n is NUMBERS["double"] else "single", scene_with(name)).links[
            "device" if name == "other" else name
        ]
        at = {"wall": np.full(SAMPLES, n.wall), "moved": points.rest["ground"]}
        first, second = (at[end] if end in at else points.position[end.removeprefix("h_")] for end in link.between)
        d = first - second
        growth = np.diff(d, prepend=d[0])
        faster = points.velocity[name] / n.rate - np.diff(points.position[name], prepend=points.position[name][0])
        now = iter(faster)
        tension = tension_of(link, n.rate, lambda: float(next(now)))
        if "moved" in link.between:
            took["the ground moved"] += int(np.count_nonzero(np.diff(points.rest["ground"])))
        for one, step in zip(d, growth, strict=True):
            before = dict(getattr(tension, "memory", {}))
            force = tension(one, step)
            if link.type in BRANCHES:
                took.update(
                    BRANCHES[link.type](link, one, step * n.rate, force, before, getattr(tension, "memory", {}))
                )
            yield -force if link.between[0] == f"h_{name}" else force

    return recurrence


# The branches that a link takes in a sample: d, by how much it grew, the tension, what it remembered and remembers.

Memory = dict[str, float]
Told = Iterator[str]


def of_buffer(link: Any, d: float, _speed: float, force: float, *_: Memory) -> Told:
    yield "apart" if d >= link.distance else "pushes" if force < 0.0 else "would hold back"


def of_nonlinear(link: Any, d: float, speed: float, *_: Any) -> Told:
    for x, points, what in ((d, link.force_over_distance, "m"), (speed, link.force_over_velocity, "m/s")):
        yield f"piece {np.searchsorted([at for at, _ in points], x)} over {what}"


def of_friction(_link: Any, _d: float, speed: float, _force: float, before: Memory, after: Memory) -> Told:
    turned = before["way"] * speed < 0.0
    if turned:
        yield "turns back and sticks"
    if after["way"] and (turned or not before["way"]):
        yield "turns about in one sample" if turned else "breaks away"
    yield ("slides on" if speed else "stands, slid") if after["way"] else "sticks"


def of_plectrum(_link: Any, d: float, _speed: float, _force: float, before: Memory, after: Memory) -> Told:
    met = before["side"] != 0.0 and not before["side"] * d > 0.0
    if before["side"] and not met:
        yield "released"
    elif after["side"]:
        yield "passes beyond its reach" if met else "releases"
    else:
        yield "grips again" if met else "grips"


def of_held(link: Any, d: float, before: Memory, after: Memory) -> Told:
    k = after["place"]
    yield (
        "at first" if not before else "stays" if k == before["place"] else "moves on" if k > before["place"] else "back"
    )
    if link.places:
        u, is_last = d - link.places[k], {0: -1.0, len(link.places) - 1: 1.0}.get(k, 0.0)
        free = "within the dead zone" if abs(u) <= link.dead_zone else ""
        yield free or ("at a stop" if is_last * u > 0.0 else "held" if k in link.only else "silent")


def of_detent(link: Any, d: float, _speed: float, _force: float, before: Memory, after: Memory) -> Told:
    if link.is_held:
        yield from of_held(link, d, before, after)
        return
    yield "at d = 0" if abs(d) < link.pitch / 2.0 else "elsewhere"
    if link.shape != "sine":
        u = abs(d - link.pitch * np.floor(d / link.pitch + 0.5))
        rise = link.width / 4.0 if link.shape == "notch" else 0.5 * link.pitch * link.sharpness / (link.sharpness + 1.0)
        yield "rises" if u <= rise else "falls" if u <= link.width / 2.0 else "between"


def of_click(link: Any, d: float, _speed: float, force: float, *_: Memory) -> Told:
    at = np.array([0.0, link.peak_at, 0.5 * (1.0 + link.peak_at), 1.0]) * link.travel
    yield "apart" if d >= 0.0 else f"part {np.searchsorted(at, -d)}"
    if d < 0.0 and force >= max(0.0, link.drop - link.peak):
        yield "would hold back"


BRANCHES: dict[str, Callable[..., Told]] = {
    "buffer": of_buffer,
    "nonlinear": of_nonlinear,
    "friction": of_friction,
    "plectrum": of_plectrum,
    "detent": of_detent,
    "click": of_click,
}
PRESSED = {"apart", "would hold back", *(f"part {i}" for i in range(1, 5))}
HELD = {"stays", "moves on", "back"}
TOOK: dict[str, set[str]] = {
    "ground": {"the ground moved"},
    "sensed": {"the ground moved"},
    "cell": {"the rest moved"},
    "buffer": {"apart", "pushes", "would hold back"},
    "nonlinear": {f"piece {i} over m" for i in range(6)} | {f"piece {i} over m/s" for i in range(5)},
    "friction": {"sticks", "breaks away", "slides on", "stands, slid", "turns back and sticks"}
    | {"turns about in one sample"},
    "plectrum": {"grips", "releases", "released", "grips again", "passes beyond its reach"},
    "sine": {"at d = 0", "elsewhere"},
    "snap": {"at d = 0", "elsewhere", "rises", "falls"},
    "notch": {"at d = 0", "elsewhere", "rises", "falls", "between"},
    "held": HELD,
    "placed": {*HELD, "within the dead zone", "at a stop", "held", "silent"},
    "click": PRESSED,
    "dome": PRESSED,
}
RECURRENCES: dict[str, Recurrence] = {name: of_a_link(name) for name in HANDS} | {"mass": mass, "cell": cell}


@pytest.mark.parametrize("precision", NUMBERS)
@pytest.mark.parametrize("name", RECURRENCES)
def test_a_module_is_the_recurrence_that_its_file_states(name: str, precision: str, runs: Callable[[str], Run]) -> None:
    took: Branches = Counter()
    run = runs(precision)
    expected = np.array(list(RECURRENCES[name](run, NUMBERS[precision], took)))
    error = float(np.max(np.abs(run.force[name] - expected)) / np.max(np.abs(expected)))
    took.pop("at first", None)  # once
    assert set(took) == TOOK.get(name, set())
    assert all(count >= 5 for count in took.values()), took
    assert np.max(np.abs(expected)) > 0.5
    assert error <= (WITHIN_CARRIED_ON if name in ("mass", "cell") else WITHIN)[precision]


@pytest.mark.parametrize("precision", NUMBERS)
def test_what_is_not_a_number_comes_out_as_such_whatever_state_a_module_is_in(precision: str) -> None:
    rng = np.random.default_rng(21)
    position = np.array([walk(rng, precision) for _ in HANDS]).T.copy()
    states: Counter[tuple[str, float]] = Counter()
    for last, hands in itertools.product(rng.integers(30, SAMPLES, 60), SCENES):
        bench, own = Bench(precision, hands), [HANDS.index(name) for name in hands]
        nothing = np.full(len(hands), np.nan)
        bench.start(position[last - 30, own])
        for n in range(last - 30, last):
            bench.step(position[n, own], np.zeros(len(hands)))
        for part in bench.program.parts:
            if isinstance(part.numbers, Frictions):
                states["friction", float(part.numbers.sliding[0])] += 1
            elif isinstance(part.numbers, Plectra):
                states["plectrum", float(part.numbers.side[0])] += 1
        assert np.all(np.isnan(bench.step(nothing, nothing))), states
    assert set(states) == {(name, state) for name in ("friction", "plectrum") for state in (-1.0, 0.0, 1.0)}


@pytest.mark.parametrize("name", ["spring", "buffer", "nonlinear", "sine", "snap", "notch", "click", "dome"])
def test_at_rest_a_link_has_the_tension_of_its_law(name: str) -> None:
    """The tension at rest equals the theory's law. Detents extend for kilometres, up to the rounding of a position."""
    hands = scene_with(name)
    bench, n, hand = Bench("double", hands), NUMBERS["double"], hands.index(name)
    link = bench.scene.links[name]
    sign = 1.0 if link.between[0] == f"h_{name}" else -1.0
    law, rng = link.law(), np.random.default_rng(22)
    near = rng.uniform(-0.05, 0.05, 150)
    far = rng.uniform(-1e5, 1e5, 50) if link.type == "detent" else near[:50]
    met = []
    for d in (*near, *far):
        position = np.full(len(hands), n.wall)
        position[hand] += sign * d
        bench.start(position)
        met.append(-sign * bench.step(position, np.zeros(len(hands)))[hand])
    expected = law.tension(np.array([*near, *far]))
    assert met[:150] == pytest.approx(expected[:150], rel=1e-9, abs=1e-9)
    assert met[150:] == pytest.approx(expected[150:], rel=1e-9, abs=1e-6)
    assert np.max(np.abs(expected)) > 0.5
