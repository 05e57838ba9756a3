"""Live changes add to a running scene what they say they add, and never more than the tank has."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol.compiled import new_record
from hapsim.cordis.offline import start, update_parameters
from hapsim.cordis.program import Program, compile_scene, parameter_values, positions_of
from hapsim.cordis.stored_energy import TANK, StoredEnergy, Tank, evaluate
from hapsim.loop.guards.energy_guard import SWINGS
from hapsim.running.session import Session
from hapsim.scene import Scene, parse_scene

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools" / "bench"))

from changes import Outcome, changed_while_it_runs, dragged, pumped, spring
from energy_guard import passive_scenes

Array = NDArray[np.float64]
LIMIT, REFILL = 0.2, 0.02  # J, J/s: by default, of 10 N
CAPACITY, TAKEN = 1.0, 0.03  # J, of the tanks of programs that no loop runs


def within_the_tank(outcome: Outcome) -> bool:
    return outcome.spent <= LIMIT + REFILL * outcome.position.size * 1e-3 + 1e-9


def test_a_modulation_that_pumps_is_slowed_and_ends_no_run() -> None:
    outcome, given = pumped(0.65, 2.0)
    assert outcome.ending == "done"
    assert outcome.slowed > 0
    assert within_the_tank(outcome)
    assert given < 0.4


def test_an_adversary_gets_no_more_than_the_page_states() -> None:
    """A spring beyond passivity that is stiff whenever the hand comes back, and soft when it goes."""
    before, seconds, declared = [0.0, False], 2.5, 1.0

    def act(session: Session, _sample: int) -> None:
        io = session._loop.record.io
        position = float(io.position_counts[0] * io.position_scale[0])
        comes_back = position * (position - before[0]) < 0.0
        before[0] = position
        if comes_back != before[1]:
            before[1] = comes_back
            session.set({"touch": {"stiffness": 1900.0 if comes_back else 100.0}}, over=0.0)

    outcome = changed_while_it_runs(spring(100.0, friction=2.0 * declared), seconds, act)
    assert within_the_tank(outcome)
    assert LIMIT < given(outcome, declared) < 2.0 * LIMIT + REFILL * seconds


def test_what_a_scene_gave_is_not_forgotten_where_changes_add_and_take_away() -> None:
    """A spring that gives energy by itself, stiffer for a few samples at the end of each swing: what the rise added the
    fall takes away, and no more."""
    before, left = [0.0, 0.0], [0]

    def act(session: Session, _sample: int) -> None:
        io = session._loop.record.io
        position = float(io.position_counts[0] * io.position_scale[0])
        turns = (position - before[0]) * (before[0] - before[1]) < 0.0
        before[:] = position, before[0]
        left[0] = 4 if turns else left[0] - 1
        if left[0] in (4, 1):
            session.set({"touch": {"stiffness": 3000.0 if turns else 2000.0}}, over=0.0)

    outcome = changed_while_it_runs(spring(2000.0, friction=1.5, velocity=0.3), 10.0, act)
    assert outcome.ending == "scene diverging"
    assert LIMIT < given(outcome, 1.0) < LIMIT + outcome.spent + 0.01  # the work of a sample


def given(outcome: Outcome, declared: float) -> float:
    """J: the most that the force has given by then, beyond what the declared friction (N·s/m) takes."""
    step = np.diff(outcome.position)
    acted = np.concatenate([[0.0], np.clip(outcome.asked, -10.0, 10.0)[:-2]])  # a sample late
    return float(np.cumsum(acted * step - declared * step**2 * 1e3).max())


def test_what_nothing_links_to_a_hand_adds_nothing() -> None:
    cell = {"type": "cell", "mass": 0.1, "stiffness": 50.0, "rest": 0.0, "position": 0.2}
    pinned = {"type": "spring", "between": ["cell", "wall"], "stiffness": 100.0}

    def act(session: Session, sample: int) -> None:
        session.set({"cell": {"stiffness": 50.0 + sample}, "pinned": {"stiffness": 100.0 + sample}}, over=0.0)

    outcome = changed_while_it_runs(spring(cell=cell, pinned=pinned), 0.1, act)
    assert (outcome.ending, outcome.spent, outcome.slowed) == ("done", 0.0, 0)


def test_a_change_acts_at_the_next_sample_and_one_without_energy_left_holds_up_no_stop() -> None:
    """A wall that shall be half a metre away at once."""
    ticks, wall = [], []

    def act(session: Session, sample: int) -> None:
        if sample == 50:
            session.set({"wall": {"position": 0.5}}, over=0.0)
        if sample == 150:
            wall.append(float(session._loop.program.parameters.values[0]))
            session.stop()
        if sample in (50, 150):
            ticks.append(int(session._loop.state.ticks))

    outcome = changed_while_it_runs(spring(velocity=0.0), 10.0, act)
    assert outcome.ending == "stopped"
    assert 0.0 < wall[0] < 0.4
    assert not outcome.asked[: ticks[0]].any()
    assert outcome.asked[ticks[0]] > 1.0
    assert outcome.position.size <= ticks[1] + 2
    assert within_the_tank(outcome)


def test_the_parameters_of_a_slowed_change_stay_in_step() -> None:
    seen = []

    def act(session: Session, sample: int) -> None:
        if sample == 50:
            session.set({"wall": {"position": 0.5}, "touch": {"stiffness": 600.0}}, over=0.01)
        seen.append(session._loop.program.parameters.values.copy())

    changed_while_it_runs(spring(velocity=0.0), 0.3, act)
    wall, stiffness = (np.array(seen)[:, :2]).T
    share = wall / 0.5
    assert 0.05 < share[-1] < 0.95
    assert (np.diff(share) >= 0.0).all()
    assert stiffness == pytest.approx(400.0 + share * 200.0)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("adopts", [False, True])
def test_no_slider_and_no_adoption_stops_a_run_on_a_passive_scene(adopts: bool) -> None:
    for number, drawn in enumerate(passive_scenes(3, seed=9)):
        assert dragged(drawn.scene, 25, number, adopts).ending == "done"


def test_a_stiffness_that_moves_the_crossing_of_the_limit_is_no_swing() -> None:
    """20 N/m while the force first reaches its limit of 1.12 N, at 56 mm; 160 N/m from then on, at 7 mm."""
    document = json.loads(spring(20.0, friction=0.12, velocity=0.6).model_dump_json(exclude_none=True))
    document["device"] |= {"friction": 0.12, "force_limit": 1.12}

    def act(session: Session, sample: int) -> None:
        if sample == 315:  # the hand passes the wall
            session.set({"touch": {"stiffness": 160.0}}, over=0.0)

    outcome = changed_while_it_runs(parse_scene(json.dumps(document)), 3.5, act)
    assert (outcome.ending, outcome.why) == ("done", "")
    cut = np.abs(outcome.asked) > 1.12
    assert np.count_nonzero(np.diff(cut.astype(int)) == 1) >= SWINGS


def test_an_adopted_scene_is_slowed_where_it_has_too_much_energy() -> None:
    """A mass of 1 kg half a metre away, on a spring to the hand: 12.5 J."""
    ball: dict[str, Any] = {"type": "mass", "mass": 1.0, "position": 0.5}
    loaded = spring(ball=ball, tied={"type": "spring", "between": ["hand", "ball"], "stiffness": 100.0})

    def act(session: Session, sample: int) -> None:
        if sample == 50:
            session.adopt(loaded, 0.01)

    outcome = changed_while_it_runs(spring(velocity=0.0), 1.0, act)
    assert outcome.ending == "done"
    assert outcome.slowed > 100
    assert within_the_tank(outcome)


# The energy alone, of programs that no loop runs.


def accounted(scene: Scene, hand: float) -> tuple[Program, Any]:
    """Returns the program, started with the hand at 0 and then moved to `hand`, and its TANK."""
    program, tank = compile_scene(scene), new_record(TANK)
    kept = Tank(tank, capacity_j=CAPACITY, refill_j=0.0)
    program.stored = StoredEnergy(program, scene, kept, scene.device.force_limit)
    start(program, np.zeros(1))
    positions_of(program)[0][0] = hand
    return program, tank


def linked(**modules: Any) -> Scene:
    document = json.loads(spring().model_dump_json(exclude_none=True))
    del document["modules"]["touch"]
    document["device"]["force_limit"] = 1000.0
    document["modules"] |= modules
    return parse_scene(json.dumps(document))


X = 0.03
BETWEEN = {"between": ["hand", "wall"]}
CELL = {"cell": {"type": "cell", "mass": 0.1, "stiffness": 50.0}}
TIED = CELL | {"tied": {"type": "spring", "between": ["hand", "cell"], "stiffness": 10.0}}
CUP = {"cup": {"type": "proxy", "mass": 0.1, "hand": "hand", "stiffness": 50.0, "position": 0.01}}
HELD = {"between": ["cup", "wall"]}


def link(kind: str, **values: Any) -> dict[str, Any]:
    return {"a": BETWEEN | {"type": kind} | values}


@pytest.mark.parametrize(
    ("modules", "change", "added"),
    [
        (link("spring", stiffness=100.0), {"a": {"stiffness": 300.0}}, 100.0 * X**2),
        (link("spring", stiffness=300.0), {"a": {"stiffness": 100.0}}, -100.0 * X**2),
        (link("viscoelastic", stiffness=100.0, damping=1.0), {"wall": {"position": 0.01}}, 50.0 * (0.02**2 - X**2)),
        (link("buffer", stiffness=100.0, distance=0.0), {"a": {"distance": 0.05}}, 50.0 * 0.02**2),
        (link("buffer", stiffness=100.0), {"a": {"stiffness": 900.0}}, 0.0),
        (link("buffer", between=["wall", "hand"], stiffness=100.0), {"a": {"stiffness": 300.0}}, 100.0 * X**2),
        (link("plectrum", stiffness=100.0, release=0.1), {"a": {"stiffness": 300.0}}, 100.0 * X**2),
        (link("friction", force=4.0, stiffness=100.0), {"a": {"stiffness": 120.0}}, 10.0 * X**2),
        (TIED, {"cell": {"rest": 0.02}}, 25.0 * 0.02**2),
        (TIED, {"tied": {"stiffness": 20.0}}, 5.0 * X**2),
        (CELL | link("damper", damping=1.0), {"a": {"damping": 2.0}, "cell": {"rest": 1.0}}, 0.0),
        (CUP, {"cup": {"stiffness": 250.0}}, 100.0 * (X - 0.01) ** 2),
        (
            CUP | {"held": HELD | {"type": "spring", "stiffness": 100.0}},
            {"held": {"stiffness": 300.0}},
            100.0 * 0.01**2,
        ),
        (CUP | {"held": HELD | {"type": "buffer", "stiffness": 100.0}}, {"held": {"distance": 0.05}}, 50.0 * 0.04**2),
    ],
)
def test_a_change_adds_its_energy(modules: dict[str, Any], change: dict[str, dict[str, float]], added: float) -> None:
    scene = linked(**modules)
    program, tank = accounted(scene, X)
    tank.level = CAPACITY - TAKEN
    document = json.loads(scene.model_dump_json(exclude_none=True))
    for name, values in change.items():
        document["modules"][name] |= values
    for samples in (5, 1):
        program.parameters.post(parameter_values(parse_scene(json.dumps(document))), samples)
        for _ in range(samples):
            update_parameters(program)
    assert float(tank.spent) == pytest.approx(added, abs=1e-12)
    assert float(tank.level) == pytest.approx(CAPACITY - max(TAKEN + added, 0.0), abs=1e-12)


def stored_of(program: Program) -> float:
    here, before = positions_of(program)
    return float(evaluate(program.record.parameters.stored, here.ctypes.data, before.ctypes.data, 0))


def test_of_a_spring_at_a_hand_no_more_counts_than_the_force_limit_gives_back() -> None:
    scene = spring(2000.0)  # N/m, and 10 N
    program, _ = accounted(scene, X)
    way = np.linspace(0.0, X, 100_001)
    work = np.sum(np.minimum(2000.0 * 0.5 * (way[1:] + way[:-1]), 10.0) * np.diff(way))
    assert stored_of(program) == pytest.approx(work, rel=1e-6)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_stiff_string_stores_what_its_stretch_and_its_bending_do(precision: str) -> None:
    gut = {"type": "string", "masses": 5, "mass": 0.01, "stiffness": 30.0, "bending": 7.0, "position": 0.1}
    bow = {"type": "spring", "between": ["hand", "gut.2"], "stiffness": 11.0}
    scene = linked(gut=gut, bow=bow).model_copy(update={"precision": precision})
    program, _ = accounted(scene, X)
    here, before = positions_of(program)
    places = [program.numbers[f"gut.{i}"] for i in range(5)]
    here[places] = x = 0.1 + np.random.default_rng(1).uniform(-0.02, 0.02, 5)
    before[places] = x
    ends = np.concatenate([[0.1], x, [0.1]])
    stored = 15.0 * np.sum(np.diff(ends) ** 2) + 3.5 * np.sum(np.diff(ends, 2) ** 2) + 5.5 * (X - x[2]) ** 2
    assert stored_of(program) == pytest.approx(stored, rel=1e-6)
    before[places] = x - 0.001
    assert stored_of(program) == pytest.approx(stored + 5 * 0.5 * 0.01 * 1.0**2, rel=1e-5)


def test_a_curve_stores_the_area_below_it() -> None:
    curve = [[-0.01, -2.0], [0.0, 0.0], [0.02, 1.0], [0.05, 5.0]]
    scene = linked(a=BETWEEN | {"type": "nonlinear", "force_over_distance": curve})
    for hand in (0.0, 0.013, X, 0.07, -0.005, -0.03):
        way = np.linspace(0.0, hand, 100_001)
        tension = np.interp(way, *np.array(curve).T)
        program, _ = accounted(scene, hand)
        assert stored_of(program) == pytest.approx(np.sum(0.5 * (tension[1:] + tension[:-1]) * np.diff(way)), abs=1e-9)


def area_below(push: Callable[[Array], Array], to: Array) -> Array:
    """J: the integral of `push` (N over m) from 0 to each place, above its least."""
    way = np.union1d(np.linspace(-0.08, 0.08, 100_001), to)
    push_there = push(way)
    sums = np.concatenate([[0.0], np.cumsum(0.5 * (push_there[1:] + push_there[:-1]) * np.diff(way))])
    return np.asarray(np.interp(to, way, sums) - sums.min())


def detent_force(d: Array, pitch: float, depth: float, shape: str, sharpness: float = 2.0) -> Array:
    if shape == "sine":
        return np.asarray(depth * np.sin(2.0 * np.pi * d / pitch))
    s, u = sharpness, np.remainder(d / pitch + 0.5, 1.0) - 0.5
    at = [0.0, 0.5 * s / (s + 1.0), 0.5] if shape == "snap" else [0.0, 0.25 / s, 0.5 / s]
    return np.asarray(depth * np.sign(u) * np.interp(abs(u), at, [0.0, 1.0, 0.0]))


def click_force(
    d: Array, travel: float, peak: float, drop: float, bottom: float, most: float, peak_at: float = 0.5
) -> Array:
    """Returns the force that pulls the ends together: pressed where d < 0."""
    last = 1.5 * peak - drop
    points = [0.0, peak, peak - drop, last, last + 100.0 * bottom]
    push = np.interp(-d, [0.0, peak_at * travel, 0.5 * (1.0 + peak_at) * travel, travel, travel + 100.0], points)
    return -np.where(-d > travel, np.minimum(push, most), push)


DETENT = {"pitch": 0.007, "depth": 0.4}
SHARP = DETENT | {"sharpness": 3.0}
CLICK = {"travel": 0.02, "peak": 1.0, "drop": 0.6, "bottom": 400.0}
DOME = CLICK | {"drop": 4.0}


PITCHED = {"pitch": 0.03, "depth": 0.9, "hold_until": 0.8, "dead_zone": 0.002}
PLACED = {"places": [-0.05, -0.02, 0.06], "depth": 0.9, "hold_until": 0.7, "dead_zone": 0.002, "stop": 40.0}


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(
    ("values", "change"),
    [
        *((PITCHED, {key: value}) for key, value in (("pitch", 0.031), ("depth", 0.5), ("dead_zone", 0.004))),
        *((PLACED, {key: value}) for key, value in (("hold_until", 1.1), ("stop", 70.0), ("depth", 2.0))),
        (PLACED | {"only": [1]}, {"depth": 2.0}),
    ],
)
def test_a_change_of_a_detent_that_holds_adds_what_its_place_then_stores(
    values: dict[str, Any], change: dict[str, Any]
) -> None:
    link_of = BETWEEN | {"type": "detent", "damping": 0.3}
    before, after = linked(a=link_of | values), linked(a=link_of | values | change)
    added = []
    for hand in np.linspace(-0.09, 0.09, 19) + 1e-4:
        rests = np.array(values.get("places", values.get("pitch", 0.0) * np.arange(-5, 6)))
        place = int(np.argmin(abs(rests - hand)))

        def stored(numbers: dict[str, Any], place: int = place, hand: float = hand) -> float:
            at = np.array(numbers.get("places", numbers.get("pitch", 0.0) * np.arange(-5, 6)))
            u, way, zone = hand - at[place], np.diff(at), numbers["dead_zone"]
            is_stop = place == (len(at) - 1 if u > 0.0 else 0)
            if is_stop and "stop" in numbers:
                stiffness = numbers["stop"]
            elif "only" in numbers and place not in numbers["only"]:
                return 0.0
            else:
                stiffness = numbers["depth"] / (numbers["hold_until"] * way[place - (u < 0.0)] - zone)
            return float(0.5 * stiffness * max(abs(u) - zone, 0.0) ** 2)

        program, tank = accounted(before, float(hand))
        start(program, np.array([hand]))
        assert stored_of(program) == pytest.approx(stored(values), abs=1e-12)
        tank.level = CAPACITY - TAKEN
        program.parameters.post(parameter_values(after), 1)
        update_parameters(program)
        added.append(stored(values | change) - stored(values))
        assert float(tank.spent) == pytest.approx(added[-1], abs=1e-12), hand
    assert np.max(np.abs(added)) > 1e-4


@pytest.mark.thorough(keep=6)
@pytest.mark.parametrize(
    ("kind", "more", "values", "change"),
    [
        *(("detent", {"shape": "sine"}, DETENT, {field: value}) for field, value in (("pitch", 0.011), ("depth", 0.9))),
        *(
            ("detent", {"shape": shape}, SHARP, {field: value})
            for shape in ("snap", "notch")
            for field, value in (("pitch", 0.011), ("depth", 0.1), ("sharpness", 1.2))
        ),
        *(
            ("click", {}, values, {field: value})
            for values in (CLICK, DOME)
            for field, value in (("travel", 0.03), ("peak", 2.0), ("drop", 1.7), ("bottom", 900.0), ("peak_at", 0.3))
        ),
    ],
)
def test_a_change_of_a_detent_or_a_click_adds_the_area_that_it_changes(
    kind: str, more: dict[str, str], values: dict[str, float], change: dict[str, float]
) -> None:
    limit = 5.0
    link_of = BETWEEN | {"type": kind, "damping": 0.3} | more
    modules = {"before": linked(a=link_of | values), "after": linked(a=link_of | values | change)}
    scenes = {
        name: one.model_copy(update={"device": one.device.model_copy(update={"force_limit": limit})})
        for name, one in modules.items()
    }
    hands = np.array([-0.07, -0.0231, -0.0171, -0.0123, -0.0039, -0.0007, 0.0012, 0.0031, 0.0042, 0.0123])

    def stored(numbers: dict[str, float]) -> Array:
        if kind == "detent":
            return area_below(lambda d: detent_force(d, **numbers, **more), hands)  # type: ignore[arg-type]
        return area_below(lambda d: click_force(d, **numbers, most=limit), hands)

    expected = stored(values | change) - stored(values)
    assert np.max(np.abs(expected)) > 1e-4
    for hand, added in zip(hands, expected, strict=True):
        program, tank = accounted(scenes["before"], hand)
        tank.level = CAPACITY - TAKEN
        program.parameters.post(parameter_values(scenes["after"]), 1)
        update_parameters(program)
        assert float(tank.spent) == pytest.approx(added, abs=2e-8), hand
