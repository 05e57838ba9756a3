"""Every module's compiled code against a recurrence of its own, written in Python from what its file says.

The hands of `module_scenes.py` take every branch: that they did, each test asserts.
"""

from __future__ import annotations

import itertools
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from hapsim.cordis.modules.nonlinear_links import Frictions, Plectra
from hapsim.prediction.linear import linear_scene

sys.path.insert(0, str(Path(__file__).parent))
from module_scenes import CUTOFF, HANDS, NUMBERS, SAMPLES, SCENES, Array, Bench, Numbers, Run, run_of, scene_with, walk

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


def spring_and_damper(d: Array, K: float, B: float, rate: float) -> Array:
    """Tension, N, by the backward difference; at rest before the first sample."""
    return K * d + B * rate * np.diff(d, prepend=d[0])


def ground(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    took["the ground moved"] += int(np.count_nonzero(np.diff(points.rest["ground"])))
    yield from -spring_and_damper(points.position["ground"] - points.rest["ground"], n.K, n.B, n.rate)


def device(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    yield from -spring_and_damper(points.position["device"] - points.position["other"], n.K, n.B, n.rate)


def other(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    yield from (-force for force in device(points, n, took))


def spring(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    yield from n.K * (n.wall - points.position["spring"])


def damper(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    yield from spring_and_damper(n.wall - points.position["damper"], 0.0, n.B, n.rate)


def backward(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    yield from -spring_and_damper(points.position["backward"] - n.wall, n.K, n.B, n.rate)


def centred(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    d = points.position["centred"] - n.wall
    past = np.concatenate([[d[0], d[0]], d[:-2]])
    yield from -(n.K * d + n.B * n.rate * (d - past) / 2.0)


def filtered(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    d = points.position["filtered"] - n.wall
    kept, v = np.exp(-2.0 * np.pi * CUTOFF / n.rate), 0.0
    for now, before in zip(d, [d[0], *d[:-1]], strict=True):
        v = kept * v + (1.0 - kept) * (now - before) * n.rate
        yield -(n.K * now + n.B * v)


def sensed(points: Run, n: Numbers, _took: Branches) -> Iterator[float]:
    rest = points.rest["ground"]  # which has no sensor
    speed = points.velocity["sensed"] - n.rate * np.diff(rest, prepend=rest[0])
    yield from -(n.K * (points.position["sensed"] - rest) + n.B * speed)


def buffer(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    before = points.position["buffer"][0]
    for x in points.position["buffer"]:
        depth = n.distance - (x - n.wall)
        push = n.K * depth - n.B * n.rate * (x - before)
        before = x
        took["apart" if depth <= 0 else "pushes" if push > 0 else "would hold back"] += 1
        yield push if depth > 0 and push > 0 else 0.0


def nonlinear(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    d = n.wall - points.position["nonlinear"]
    v = n.rate * np.diff(d, prepend=d[0])
    for x, points_of, what in ((d, n.over_distance, "m"), (v, n.over_velocity, "m/s")):
        for piece in np.searchsorted([at for at, _ in points_of], x):
            took[f"piece {piece} over {what}"] += 1
    yield from np.interp(d, *zip(*n.over_distance, strict=True)) + np.interp(v, *zip(*n.over_velocity, strict=True))


def friction(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    reach = n.force / n.bristle
    bent, way, before = 0.0, 0, points.position["friction"][0]
    for x in points.position["friction"]:
        step, before = x - before, x
        if way and np.sign(step) == -way:
            took["turns back and sticks"] += 1
            way = 0
            turned = True
        else:
            turned = False
        bent += step  # the anchor stays; where it slides it is dragged, below
        if way == 0 and n.bristle * abs(bent) > n.static:
            way = 1 if bent > 0 else -1
            took["turns about in one sample" if turned else "breaks away"] += 1
        if way:
            took["slides on" if step else "stands, slid"] += 1
            bent = way * reach
            yield -way * n.force
        else:
            took["sticks"] += 1
            yield -(n.bristle * bent + n.bristle_damping * n.rate * step)


def plectrum(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    released, before = 0.0, n.wall - points.position["plectrum"][0]
    for x in points.position["plectrum"]:
        d = n.wall - x
        step, before = d - before, d
        met = released != 0.0 and (d == 0 or (d > 0) != (released > 0))
        if released and not met:
            took["released"] += 1
            yield 0.0
        elif abs(d) <= n.release:
            took["grips again" if met else "grips"] += 1
            released = 0.0
            yield n.K * d + n.B * n.rate * step
        else:
            took["passes beyond its reach" if met else "releases"] += 1
            released = d
            yield 0.0


def from_rest(n: Numbers, x: float, took: Branches) -> float:
    """How far from the nearest rest of a detent, m."""
    d = x - n.wall
    took["at d = 0" if abs(d) < n.pitch / 2.0 else "elsewhere"] += 1
    return d - n.pitch * float(np.floor(d / n.pitch + 0.5))


def on_flanks(n: Numbers, name: str, points: Run, took: Branches, rise: float, end: float) -> Iterator[float]:
    """A detent whose force is `n.force` at `rise`, and 0 from `end` on."""
    before = points.position[name][0]
    for x in points.position[name]:
        u = from_rest(n, x, took)
        took["rises" if abs(u) <= rise else "falls" if abs(u) <= end else "between"] += 1
        height = min(abs(u) / rise, max((end - abs(u)) / (end - rise), 0.0))
        yield -(np.sign(u) * n.force * height + n.B * n.rate * (x - before))
        before = x


def sine(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    x = points.position["sine"]
    u = np.array([from_rest(n, one, took) for one in x])
    yield from -(n.force * np.sin(2.0 * np.pi * u / n.pitch) + n.B * n.rate * np.diff(x, prepend=x[0]))


def snap(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    yield from on_flanks(n, "snap", points, took, n.pitch / 2.0 * n.sharp / (n.sharp + 1.0), n.pitch / 2.0)


def notch(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    width = n.pitch / n.sharp
    yield from on_flanks(n, "notch", points, took, width / 4.0, width / 2.0)


def pressed(d: Array, n: Numbers, peak: float, drop: float, took: Branches) -> Iterator[float]:
    """What a click pushes its ends apart with."""
    at = np.array([0.0, 0.5, 0.75, 1.0, 1001.0]) * n.travel
    force = np.array([0.0, peak, peak - drop, 1.5 * peak - drop, 1.5 * peak - drop + 1000.0 * n.K * n.travel])
    before = d[0]
    for here in d:
        push = float(np.interp(-here, at, force)) - n.B * n.rate * (here - before)
        took["apart" if here >= 0 else f"part {np.searchsorted(at, -here)}"] += 1
        before = here
        if here < 0 and push < min(0.0, peak - drop):
            took["would hold back"] += 1
            push = min(0.0, peak - drop)
        yield push if here < 0 else 0.0


def click(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    yield from pressed(points.position["click"] - n.wall, n, n.static, n.force, took)


def dome(points: Run, n: Numbers, took: Branches) -> Iterator[float]:
    yield from (-push for push in pressed(n.wall - points.position["dome"], n, n.force, n.static, took))


PRESSED = {"apart", "would hold back", *(f"part {i}" for i in range(1, 5))}
RECURRENCES: dict[str, tuple[Recurrence, set[str]]] = {
    "mass": (mass, set()),
    "ground": (ground, {"the ground moved"}),
    "cell": (cell, {"the rest moved"}),
    "device": (device, set()),
    "other": (other, set()),
    "spring": (spring, set()),
    "damper": (damper, set()),
    "backward": (backward, set()),
    "centred": (centred, set()),
    "filtered": (filtered, set()),
    "sensed": (sensed, set()),
    "buffer": (buffer, {"apart", "pushes", "would hold back"}),
    "nonlinear": (nonlinear, {f"piece {i} over m" for i in range(6)} | {f"piece {i} over m/s" for i in range(5)}),
    "friction": (
        friction,
        {"sticks", "breaks away", "slides on", "stands, slid", "turns back and sticks", "turns about in one sample"},
    ),
    "plectrum": (plectrum, {"grips", "releases", "released", "grips again", "passes beyond its reach"}),
    "sine": (sine, {"at d = 0", "elsewhere"}),
    "snap": (snap, {"at d = 0", "elsewhere", "rises", "falls"}),
    "notch": (notch, {"at d = 0", "elsewhere", "rises", "falls", "between"}),
    "click": (click, PRESSED),
    "dome": (dome, PRESSED),
}


@pytest.mark.parametrize("precision", NUMBERS)
@pytest.mark.parametrize("name", RECURRENCES)
def test_a_module_is_the_recurrence_that_its_file_says(name: str, precision: str, runs: Callable[[str], Run]) -> None:
    recurrence, branches = RECURRENCES[name]
    took: Branches = Counter()
    run = runs(precision)
    expected = np.array(list(recurrence(run, NUMBERS[precision], took)))
    error = float(np.max(np.abs(run.force[name] - expected)) / np.max(np.abs(expected)))
    assert set(took) == branches
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


SWING = 1e-7  # m


@pytest.mark.parametrize(
    ("name", "at"),
    [
        ("spring", 0.0),
        ("damper", 0.0),
        ("backward", 0.0),
        ("buffer", -0.002),
        ("nonlinear", 0.0),
        ("friction", 0.0),
        ("plectrum", 0.0),
        ("sine", 0.0),
        ("snap", 0.0),
        ("notch", 0.0),
        ("click", -0.002),
    ],
)
def test_a_small_swing_meets_the_link_that_the_theory_takes_it_for(name: str, at: float) -> None:
    hands = scene_with(name)
    bench = Bench("double", hands)
    n, hand = NUMBERS["double"], hands.index(name)
    swing = SWING * np.sin(0.3 * np.arange(400))
    position = np.full((400, len(hands)), n.wall)
    position[:, hand] += at + swing
    bench.start(position[0])
    force = np.array([bench.step(x, np.zeros(len(hands)))[hand] for x in position])
    speed = n.rate * np.diff(swing, prepend=swing[0])
    met = np.linalg.lstsq(np.array([swing, speed, np.ones(400)]).T, -force, rcond=None)[0]
    link = linear_scene(bench.scene).links[name]
    assert met[0] == pytest.approx(link.stiffness, rel=1e-6, abs=1e-5)
    assert met[1] == pytest.approx(link.damping, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("name", ["spring", "buffer", "nonlinear", "sine", "snap", "notch", "click", "dome"])
def test_at_rest_a_link_has_the_tension_of_its_law(name: str) -> None:
    """Which the theory writes down by itself. Detents go on for kilometres, right to what a place is rounded by."""
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
