"""The states that contacts, plectra, tables and detents of masses can be in, against simulation of what is said."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest
import yaml

from hapsim import predict, start
from hapsim.errors import UsageError
from hapsim.prediction import Prediction, reach, surely_shaken_by, warnings_about
from hapsim.prediction.reach import options_of
from hapsim.prediction.states import MOST_STATES
from hapsim.running.run import run_in_memory
from hapsim.scene import Scene, parse_scene
from hapsim.scene.shipped import shipped_scene
from hapsim.theory import Network
from hapsim.theory.network import poles_of, proves_stability
from tests import thorough
from tests.contact_scenes import begun, contact_scene, growths_within, judged_unstable, unsnapped_states
from tests.piecewise_scenes import as_scene, random_scene, springs_in_regions, springs_in_states

SEEDS = range(thorough.points(1, 4))
HAND = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
GRIP = {"type": "plectrum", "stiffness": 1200.0, "damping": 1.5, "release": 0.002}
BALL = {"ball": {"type": "cell", "mass": 0.1, "stiffness": 400.0}}
FINGER = {"type": "buffer", "between": ["hand", "ball"], "stiffness": 500.0, "damping": 8.0, "distance": 0.01}
DRIVE = {"type": "nonlinear", "between": ["ball", "wall"], "force_over_velocity": [[-1.0, 1.0], [1.0, -1.0]]}

NOTCHES = ("in a notch", "at the edge of a notch", "between notches")


def scene_of(modules: dict[str, Any], mock: dict[str, Any] | None = None, **device: Any) -> Scene:
    device = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"} | device
    document = {"version": 1, "rate": 1000, "device": device, "mock": mock or {}, "modules": HAND | modules}
    return parse_scene(yaml.safe_dump(document), "scene")


def predicted(modules: dict[str, Any], **device: Any) -> Prediction:
    return predict(scene_of(modules, **device), with_margins=False)


def found(prediction: Prediction) -> set[str]:
    """Each state of a scene with one part, its words in the order of its links."""
    (states,) = prediction.states.parts
    return {", ".join(option.state for option in state.values()) for state in states}


@pytest.mark.parametrize("seed", SEEDS)
def test_the_prediction_of_each_state_is_how_a_motion_within_it_goes_on(seed: int) -> None:
    """Simulated for four seconds; states that a snap leaves, and growth by less than 1e-4 a sample, aside."""
    scene = contact_scene(seed)
    prediction = predict(scene, with_margins=False)
    states = unsnapped_states(prediction)
    for state, growth in zip(states, growths_within(scene, states, 4000), strict=True):
        if judged_unstable(prediction, state):
            assert growth > 1.0, state
        elif prediction.stable_as_taken:
            assert growth < 1.0 + 1e-4, state


@pytest.mark.parametrize("seed", SEEDS)
def test_where_every_state_is_stable_no_random_push_grows(seed: int) -> None:
    scene = contact_scene(seed)
    motion = begun(scene, np.random.default_rng(seed), 20)
    early = motion.most_energy(1000)
    motion.most_energy(3000)
    if predict(scene, with_margins=False).stable:
        assert (motion.most_energy(1000) <= 4.0 * early + 1e-9).all()


class TestAResonatorUnderABuffer:
    def test_that_drives_itself_is_unstable_while_the_finger_is_off(self) -> None:
        scene = scene_of(BALL | {"drive": DRIVE, "finger": FINGER})
        prediction = predict(scene)
        assert prediction.stable_as_taken
        assert not prediction.stable
        (growing,) = prediction.states.growing
        assert (growing.module, growing.state) == ("ball", "finger is apart")
        assert growing.growth == pytest.approx(1.0 + 0.5 * 1.0 / 0.1 * 1e-3, rel=1e-4)  # exp(-b/2m T), b = -1 N·s/m
        assert surely_shaken_by(scene) == growing
        assert prediction.spectral_radius == growing.growth
        with pytest.raises(UsageError, match=r"the motion of ball grows by 0\.5 % per sample while finger is apart"):
            start(scene, duration=0.1, unstable=False)


class TestContactsThatCannotActTogether:
    @staticmethod
    def plectra(apart: float, stiffness: float = 1200.0) -> dict[str, Any]:
        cell = {"type": "cell", "mass": 0.05, "stiffness": 2000.0, "damping": 0.5}
        cells = {f"cell{i}": cell | {"rest": i * apart} for i in range(3)}
        grip = GRIP | {"stiffness": stiffness}
        return cells | {f"pick{i}": grip | {"between": ["hand", f"cell{i}"]} for i in range(3)}

    def test_plectra_on_cells_further_apart_than_they_reach(self) -> None:
        """Twice the way of 10 N on 2000 N/m, and 2 mm of release: cells reach 12 mm to each side, so 24 mm apart two
        can grip. (Each alone is stable, all three together are not.)"""
        together, alone = predicted(self.plectra(0.0, 2000.0)), predicted(self.plectra(0.05, 2000.0))
        assert not together.stable
        assert alone.stable
        assert found(alone) == {
            "released, released, released",
            "gripping, released, released",
            "released, gripping, released",
            "released, released, gripping",
        }
        assert len(found(predicted(self.plectra(0.0239)))) == 6  # neighbours together, but not the outer ones
        assert len(found(predicted(self.plectra(0.0241)))) == 4
        words = [one for one in alone.assumptions if "pick1" in one]
        assert words[0].startswith("pick1 is taken as released: it cannot be gripping with ")

    def test_a_travel_that_does_not_reach_a_cell(self) -> None:
        assert found(predicted(self.plectra(0.05), travel=[-0.01, 0.06])) == {
            "released, released, released",
            "gripping, released, released",
            "released, gripping, released",
        }

    def test_parts_that_no_link_joins_are_counted_apart(self) -> None:
        cells = {f"cell{i}": {"type": "cell", "mass": 0.05, "stiffness": 2000.0, "damping": 0.5} for i in range(8)}
        stops = {f"stop{i}": GRIP | {"between": [f"cell{i}", "wall"]} for i in range(8)}
        prediction = predicted(cells | stops)
        assert [len(states) for states in prediction.states.parts] == [2] * 8
        assert prediction.states.count == 16
        assert not prediction.states.unjudged


def test_states_that_are_too_many_are_never_called_stable() -> None:
    """Eleven contacts of one hand that can all act together, 2048 states: of those found some are judged."""
    cells = {f"cell{i}": {"type": "cell", "mass": 0.05, "stiffness": 2000.0, "damping": 0.5} for i in range(11)}
    touch = {"type": "buffer", "stiffness": 10.0, "damping": 0.1}
    scene = scene_of(cells | {f"touch{i}": touch | {"between": ["hand", f"cell{i}"]} for i in range(11)})
    prediction = predict(scene, with_margins=False)
    assert prediction.states.count == MOST_STATES < 2048
    assert 0 < prediction.states.unjudged < MOST_STATES
    assert prediction.stable_as_taken
    assert not prediction.stable
    assert not prediction.is_judged
    assert surely_shaken_by(scene) is None  # it may run, with a warning
    assert [one for one in warnings_about(scene, prediction) if "not every state of the contacts was judged" in one]


def test_a_law_s_pieces_are_the_states_of_its_link() -> None:
    modules = {
        "ball": {"type": "mass", "mass": 0.1},
        "bow": {"type": "friction", "between": ["hand", "ball"], "force": 1.0, "stiffness": 100.0},
        "ridge": {"type": "detent", "between": ["hand", "ball"], "pitch": 0.01, "depth": 1.0, "shape": "notch"},
        "curve": {
            "type": "nonlinear",
            "between": ["hand", "ball"],
            "force_over_distance": [[0.0, 0.0], [0.01, 1.0], [0.02, 2.0], [0.03, 0.0]],
        },
    }
    links = scene_of(modules).links
    states = {name: [(one.state, one.linear.stiffness) for one in options_of(links[name].law())] for name in links}
    assert states["bow"] == [("stuck", 100.0), ("sliding", 0.0)]
    assert [stiffness for _, stiffness in states["ridge"]] == pytest.approx([-800.0, 800.0, -800.0, 0.0])
    assert [stiffness for _, stiffness in states["curve"]] == pytest.approx([0.0, 100.0, 100.0, -200.0, 0.0])


@pytest.mark.parametrize("seed", range(40))
def test_masses_that_are_reported_not_to_grow_have_no_pole_outside_of_the_circle(seed: int) -> None:
    draw = np.random.default_rng(seed)
    masses, links = int(draw.integers(1, 6)), int(draw.integers(1, 10))
    mass, step = 10.0 ** draw.uniform(-3, 0, masses), 1e-3
    ends = draw.integers(-1, masses, (links, 2))
    most = 10.0 ** draw.uniform(-2.0, 0.3) * mass.min() / step**2
    stiffness, damping = most * draw.uniform(0, 1, links), most * step * draw.uniform(0, 0.5, links)
    none = np.zeros(0)
    network = Network(1.0 / step, none, none, 1.0, "zoh", "ideal", mass, ends, stiffness, damping)
    radius = np.abs(poles_of(network)).max()
    if proves_stability(network):
        assert radius < 1.0 + 1e-6  # double poles at rest round to the root of a digit
    stiff = Network(1.0 / step, none, none, 1.0, "zoh", "ideal", mass, [[0, -1]], [4.1 * mass[0] / step**2], [0.0])
    assert not proves_stability(stiff)
    assert np.abs(poles_of(stiff)).max() > 1.0


@pytest.mark.parametrize("seed", range(20))
def test_the_states_of_a_hand_that_moves_nothing_else_are_its_regions(seed: int) -> None:
    """400 of them: `tools/bench/verdicts`."""
    scene = as_scene(random_scene(seed))
    assert springs_in_states(scene) == springs_in_regions(scene)


def test_a_detent_of_many_periods_is_in_each_piece_next_to_a_stop() -> None:
    """The stop is six pitches away. Two detents whose rests are half a pitch apart are never both in a notch's middle
    piece, but where one of them has another pitch, they are, some periods away."""
    ball = {"ball": {"type": "mass", "mass": 0.05}}
    hold = {"type": "viscoelastic", "between": ["hand", "ball"], "stiffness": 500.0, "damping": 0.5}
    notches = {"type": "detent", "between": ["ball", "wall"], "pitch": 0.004, "depth": 0.5, "shape": "notch"}
    stop = {"type": "buffer", "between": ["ball", "wall"], "stiffness": 1000.0, "distance": -0.025}
    modules = ball | {"hold": hold, "notches": notches | {"sharpness": 4}}
    beside = {f"{where}, {stop}" for where in NOTCHES for stop in ("apart", "touched")}
    assert found(predicted(modules | {"stop": stop})) == beside
    other = {"half": {"type": "ground", "position": 0.002}}
    for pitch, inside in ((0.004, False), (0.0045, True)):
        second = modules["notches"] | {"between": ["ball", "half"], "pitch": pitch}
        assert ("in a notch, in a notch" in found(predicted(modules | other | {"second": second}))) == inside


def test_a_search_for_states_that_takes_too_long_is_given_up_and_nothing_called_stable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reach, "_MOST_TRIES", 2_000)
    pitches = {f"d{i}": 0.01 + 1e-3 * i for i in range(9)}
    ball = {"ball": {"type": "cell", "mass": 0.05, "stiffness": 20.0, "damping": 2.0}}
    deep = {"type": "detent", "between": ["ball", "wall"], "depth": 0.01, "shape": "notch", "sharpness": 100.0}
    prediction = predicted(ball | {name: deep | {"pitch": pitch} for name, pitch in pitches.items()})
    assert prediction.states.count < MOST_STATES
    assert prediction.states.unjudged
    assert not prediction.stable


def on_a_rod(snap: dict[str, Any], speed: float = 0.0) -> Scene:
    """A ball that moves on a snap, on a rod of 1500 N/m in the hand, which begins with this speed (m/s)."""
    rod = {"type": "viscoelastic", "between": ["hand", "ball"], "stiffness": 1500.0, "damping": 0.5}
    ball = {"ball": {"type": "mass", "mass": 0.05}, "rod": rod, "snap": snap | {"between": ["ball", "wall"]}}
    return scene_of(ball, mock={"initial": {"velocity": speed}}, mass=0.1)


class TestAnOscillationNextToASnap:
    CLICKS: ClassVar = {
        "type": "detent",
        "pitch": 0.004,
        "depth": 1.5,
        "shape": "snap",
        "sharpness": 2.0,
        "damping": 0.1,
    }

    def test_across_the_periods_of_a_detent_is_found_and_the_loop_shows_it(self) -> None:
        shaking = surely_shaken_by(on_a_rod(self.CLICKS))
        assert shaking is not None
        assert shaking.growth == pytest.approx(1.001476, abs=1e-6)
        assert shaking.state == "snap is swept across its period"
        for speed, swings in ((0.3, False), (0.6, True)):
            force = run_in_memory(on_a_rod(self.CLICKS, speed), duration=4.0).force[-100:]
            assert (np.abs(force).max() > 9.9) == swings

    def test_across_longer_periods_than_a_hand_s_speed_takes_it_is_none(self) -> None:
        """33.8 Hz with 1 m/s are 9.4 mm from end to end."""
        for pitch, is_judged in ((0.0093, True), (0.0095, False)):
            notches = self.CLICKS | {"pitch": pitch, "depth": 1.5 * pitch / 0.004}
            growing = {one.state for one in predict(on_a_rod(notches), with_margins=False).states.growing}
            assert ("snap is swept across its period" in growing) == is_judged

    def test_within_the_snap_is_not_excused_by_its_faster_real_pole(self) -> None:
        """A table that falls once, without periods to sweep across."""
        points = [[-0.02, -20.0], [0.009, 2.25], [0.011, -2.25], [0.04, 20.0]]
        toggle = {"type": "nonlinear", "force_over_distance": points}
        growths = {one.state: one.growth for one in predict(on_a_rod(toggle), with_margins=False).states.growing}
        assert growths["snap is piece 2"] == pytest.approx(1.00556, abs=1e-5)

    @pytest.mark.parametrize("at", [None, 0.0019])
    def test_next_to_a_detent_counts_if_it_grows_in_the_mean_over_its_pieces(self, at: float | None) -> None:
        """Between the ridges of the güiro the hand's pair grows, less than it decays in a groove; at any place."""
        guiro = predict(parse_scene(shipped_scene("guiro")), with_margins=False, at=at)
        assert guiro.stable
        assert guiro.judge.shaking is None
        wide = self.CLICKS | {"pitch": 0.012, "depth": 4.5}
        growing = {one.state for one in predict(on_a_rod(wide), with_margins=False).states.growing}
        assert growing == {"snap is between notches"}  # no hand swings across 12 mm at its 33.8 Hz


class TestALeverWithASnapInTheMiddle:
    TABLE: ClassVar = {"type": "nonlinear", "force_over_distance": [[-0.006, -2], [-0.002, 1], [0.002, -1], [0.006, 2]]}

    def lever(self, between: list[str], stiffness: float = 1000.0, speed: float = 0.0) -> Scene:
        """A lever on a spring; its snap, or the spring, is on the wall."""
        other = ["lever", "wall"] if between[0] == "hand" else ["hand", "lever"]
        rod = {"type": "viscoelastic", "between": other, "stiffness": stiffness, "damping": 2.0}
        air = {"type": "damper", "between": ["lever", "wall"], "damping": 1.0}
        lever = {"type": "mass", "mass": 0.05}
        modules = {"lever": lever, "rod": rod, "air": air, "snap": self.TABLE | {"between": between}}
        return scene_of(modules, mock={"initial": {"velocity": speed}})

    @pytest.mark.parametrize("between", [["lever", "wall"], ["hand", "lever"]])
    def test_is_stable_wherever_it_is_taken(self, between: list[str]) -> None:
        for at in (None, 0.0, 0.004):
            prediction = predict(self.lever(between), with_margins=False, at=at)
            assert prediction.stable
            assert prediction.stable_as_taken
            assert prediction.judge.shaking is None
        taken = predict(self.lever(between), with_margins=False)
        assert taken.spectral_radius < 1.0
        assert "snap is taken as piece 1: nothing rests where its force falls" in taken.assumptions
        for speed in (0.1, 0.4, 1.0):
            x = run_in_memory(self.lever(between, speed=speed), duration=4.0).position
            assert np.ptp(x[-1000:]) < 0.1 * np.ptp(x[-2000:-1000]) + 1e-6

    def test_on_a_spring_too_stiff_for_the_loop_is_not(self) -> None:
        assert surely_shaken_by(self.lever(["lever", "wall"], stiffness=1e5)) is not None


def test_what_moves_where_the_scene_begins_reaches_further() -> None:
    """A ball that flies at 1 m/s on 3000 N/m gets 2.6 mm further than the 6.7 mm of twice the force limit."""
    wall = {"stop": {"type": "ground", "position": 0.01}}
    ball = {"type": "cell", "mass": 0.02, "stiffness": 3000.0, "damping": 0.05}
    bump = {"type": "buffer", "between": ["stop", "ball"], "stiffness": 1000.0, "distance": 0.001}
    hold = {"type": "viscoelastic", "between": ["hand", "ball"], "stiffness": 500.0, "damping": 0.1}
    links = wall | {"bump": bump, "hold": hold}
    assert found(predicted(links | {"ball": ball})) == {"apart"}
    assert found(predicted(links | {"ball": ball | {"velocity": 1.0}})) == {"touched", "apart"}
    assert found(predicted(links | {"ball": ball | {"position": 0.003}})) == {"touched", "apart"}


def test_a_mass_that_a_spring_ties_to_the_hand_gets_wherever_the_hand_does() -> None:
    ball = {"type": "mass", "mass": 0.02}
    bump = {"type": "buffer", "between": ["ball", "wall"], "stiffness": 1000.0, "distance": -0.5}
    hold = {"type": "viscoelastic", "between": ["hand", "ball"], "stiffness": 5000.0, "damping": 0.1}
    assert found(predicted({"ball": ball, "bump": bump, "hold": hold})) == {"touched", "apart"}


def test_a_hand_with_dampers_of_two_kinds_is_judged_by_the_network_in_each_state() -> None:
    """The hand's stop is too stiff with its backward damper, but not with the sensed one of the spring."""
    spring = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 300.0, "damping": 2.0}
    stop = {"type": "buffer", "between": ["wall", "hand"], "stiffness": 20000.0, "damping": 150.0, "distance": -0.005}
    prediction = predicted({"spring": spring | {"damper": "sensed"}, "stop": stop})
    assert not prediction.judge.regions
    assert prediction.judge.shaking is not None
    calm = predicted({"spring": spring | {"damper": "sensed"}, "stop": stop | {"stiffness": 2000.0, "damping": 10.0}})
    assert calm.stable
    assert found(calm) == {"touched", "apart"}


def test_more_contacts_of_a_part_than_64_are_not_judged() -> None:
    stops = {f"stop{i}": {"type": "ground", "position": 0.01 * i} for i in range(65)}
    bumps = {f"bump{i}": {"type": "buffer", "between": ["ball", f"stop{i}"], "stiffness": 1.0} for i in range(65)}
    prediction = predicted({"ball": {"type": "cell", "mass": 1.0, "stiffness": 100.0}} | stops | bumps)
    assert not prediction.states.is_complete
    assert not prediction.stable


def test_friction_slides_where_its_ends_get_further_than_its_bristle_reaches() -> None:
    """A cell on 1000 N/m gets 20 mm to each side by twice the force limit."""
    cell = {"cell": {"type": "cell", "mass": 0.1, "stiffness": 1000.0, "damping": 0.5}}
    hold = {"type": "viscoelastic", "between": ["hand", "cell"], "stiffness": 500.0, "damping": 0.5}
    rub = {"type": "friction", "between": ["cell", "wall"], "force": 1.0, "damping": 0.1}
    for stiffness, states in ((20.0, {"stuck"}), (30.0, {"stuck", "sliding"})):
        assert found(predicted(cell | {"hold": hold, "rub": rub | {"stiffness": stiffness}})) == states


def test_a_snap_drives_a_mass_on_and_is_no_instability_but_what_grows_faster_is() -> None:
    """A scraper's tip on ridges: between two it is driven on, at some 1.2 per sample."""
    modules = {
        "tip": {"type": "mass", "mass": 0.01},
        "gourd": {"type": "cell", "mass": 0.05, "stiffness": 5000.0, "damping": 1.0},
        "scraper": {"type": "viscoelastic", "between": ["hand", "tip"], "stiffness": 400.0, "damping": 0.3},
        "ridges": {"type": "detent", "between": ["tip", "gourd"], "pitch": 0.004, "depth": 0.4, "shape": "snap"},
    }
    prediction = predicted(modules)
    assert found(prediction) == {"in a notch", "between notches"}
    assert prediction.stable
    stop = {"type": "buffer", "between": ["gourd", "wall"], "stiffness": 250000.0, "distance": -0.001}
    growing = {one.state for one in predicted(modules | {"stop": stop}).states.growing}
    assert {one for one in growing if "stop is touched" in one and "between notches" in one}


class TestADamperThatIsSteeperWhileItMoves:
    @staticmethod
    def damper(slow: float, fast: float, at: str = "wall") -> dict[str, Any]:
        """Returns a damper of `slow` N·s/m up to 10 mm/s, and of `fast` from there to 1 m/s."""
        way = 0.01 * slow + 0.99 * fast
        curve = [[-1.0, -way], [-0.01, -0.01 * slow], [0.01, 0.01 * slow], [1.0, way]]
        spring = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 300.0, "damping": 1.0}
        return {
            "damper": {"type": "nonlinear", "between": ["hand", at], "force_over_velocity": curve},
            "spring": spring,
        }

    def test_is_unstable_while_it_is_fast_and_the_loop_shows_it(self) -> None:
        """The kernel's motion from 50 mm/s: it dies out, or is driven to the force limit."""
        for fast, stable in ((20.0, True), (400.0, False)):
            scene = scene_of(self.damper(2.0, fast), mock={"initial": {"velocity": 0.05}})
            prediction = predict(scene)
            assert prediction.stable_as_taken
            assert prediction.stable == stable
            assert (surely_shaken_by(scene) is None) == stable
            trace = run_in_memory(scene, duration=1.0)
            assert (np.abs(trace.force[-100:]).max() < 1.0) == stable
        assert [one.state for one in prediction.states.growing] == ["damper is fast"]

    def test_a_spring_that_needs_it_is_unstable_faster_than_its_table(self) -> None:
        """The kernel's motion from 0.5 m/s swings between the force limits; with a table up to 1 m/s it dies out."""
        for most, stable in ((0.1, False), (1.0, True)):
            damper = {"type": "nonlinear", "between": ["hand", "wall"]}
            damper |= {"force_over_velocity": [[-most, -15.0 * most], [most, 15.0 * most]]}
            spring = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 6000.0}
            mock = {"initial": {"velocity": 0.5}}
            scene = scene_of({"damper": damper, "spring": spring}, mock=mock, mass=0.1, friction=3.0, force_limit=50.0)
            prediction = predict(scene)
            assert prediction.stable_as_taken
            assert prediction.stable == stable
            trace = run_in_memory(scene, duration=2.0)
            assert (np.abs(trace.force[-100:]).max() < 1.0) == stable
            states = [one.state for one in prediction.states.growing]
            assert states == ([] if stable else ["damper is faster than its table"])

    @pytest.mark.parametrize(
        ("points", "dampings"),
        [
            ([[-1.2, -0.3], [-0.1, -0.3], [0.1, 0.3], [1.2, 0.3]], [0.3]),  # flattens
            ([[-2.0, -6.0], [2.0, 6.0]], []),  # straight
            ([[-2.0, -3.0], [-0.5, -0.5], [0.5, 0.5], [2.0, 3.0]], [5.0 / 3.0]),  # only steeper
            ([[-0.5, -1.0], [-0.2, -1.0], [0.2, 1.0], [0.5, 1.0]], [1.0]),  # ends before 1 m/s
            ([[-2.0, -2.0], [-0.5, -0.1], [-0.1, -0.5], [0.1, 0.5], [0.5, 0.1], [2.0, 2.0]], [0.2]),  # falls, and rises
            ([[-2.0, -8.0], [0.0, 0.0], [0.1, 0.2], [2.0, 0.2]], [4.0, 2.1]),  # brakes more one way: the mean of both
            ([[-1.0, -5.0], [0.0, -3.0], [1.0, -1.0]], []),  # a force beside it does not brake
        ],
    )  # fmt: skip
    def test_its_other_dampings_are_the_steepest_and_the_least_of_force_over_speed(
        self, points: list[list[float]], dampings: list[float]
    ) -> None:
        law = scene_of({"it": self.damper(0.0, 0.0)["damper"] | {"force_over_velocity": points}}).links["it"].law()
        assert [*law.dampings_at(1.0)] == pytest.approx(dampings)


@pytest.mark.parametrize(("own", "snaps"), [(300.0, 0), (100.0, 1)])
def test_a_snap_that_the_devices_own_spring_holds_is_none(own: float, snaps: int) -> None:
    curve = {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": [[-0.01, 2.0], [0.01, -2.0]]}
    assert predict(scene_of({"curve": curve}, stiffness=own), with_margins=False, at=0.0).judge.snaps == snaps
