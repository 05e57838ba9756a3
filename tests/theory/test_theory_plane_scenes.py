"""Predictions of scenes in the plane: reference figures, a simulation of a slide, and finite differences."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim import predict
from hapsim.cordis.offline import start, ticks
from hapsim.cordis.program import compile_scene
from hapsim.errors import UsageError
from hapsim.prediction import surely_shaken_by, unlikely
from hapsim.prediction.plane_geometry import Plane
from hapsim.prediction.predict_plane import PlanePrediction
from hapsim.scene import Scene

REFERENCE = 1.1e-9  # of figures with nine decimals
DEVICE = {"mass": 0.2, "friction": 1.0, "force_limit": 10.0, "clock": "lockstep"}
HAND = {"type": "device", "channels": [0, 1]}
POST = {"type": "ground", "position": [0.03, 0.0]}
DISC = {"type": "shape", "between": ["hand", "post"], "form": {"disc": 0.02}, "stiffness": 2000.0, "damping": 5.0}
EDGE = DISC | {"form": {"half_plane": [-1.0, 0.0]}}
RUB = {"friction_coefficient": 0.3, "bristle_stiffness": 1000.0, "bristle_damping": 2.0}


def plane(device: dict[str, Any] | None = None, **modules: Any) -> Scene:
    """A scene at 1 kHz with a hand and a post."""
    every = {"hand": HAND, "post": POST} | modules
    return Scene.model_validate(
        {"version": 1, "rate": 1000.0, "space": 2, "device": DEVICE | (device or {}), "modules": every}
    )


def felt_at(scene: Scene, x: float, y: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The felt matrices with the hand at a place."""
    (one,) = predict(scene, at=(x, y)).parts
    return one.felt.k, one.felt.b


PRESSED_DISC = (0.011, 0.0)
PRESSED_EDGE = (0.031, 0.0)


@pytest.mark.parametrize(
    ("disc", "at", "k", "b"),
    [
        (DISC, PRESSED_DISC, (2080.439463958, -105.328041658), (3.020774022, 1.158643213)),
        (DISC | {"side": "inside"}, (0.009, 0.0), (2080.439463958, 95.185098565), (3.020774022, 0.856694249)),
        (EDGE, PRESSED_EDGE, (2080.439463958, 0.0), (3.020774022, 1.0)),
        (EDGE | RUB, PRESSED_EDGE, (2080.439463958, 1014.435834031), (3.020774022, 1.503365494883)),
        (DISC | RUB, PRESSED_DISC, (2080.439463958, 908.240980727), (3.020774022, 1.666214325)),
    ],
)
def test_a_hand_feels_a_surface_as_the_reference_has_it(disc: Any, at: Any, k: Any, b: Any) -> None:
    """Round from outside, in a ring, flat, and with friction that sticks."""
    found = felt_at(plane(disc=disc), *at)
    for matrix, expected in zip(found, (k, b), strict=True):
        assert matrix == pytest.approx(np.diag(expected), abs=REFERENCE)


def test_masses_that_move_each_other_are_felt_as_the_reference_has_them() -> None:
    """Two edges at right angles, on a device whose mass is a matrix."""
    flat = {"x": EDGE | {"form": {"half_plane": [1.0, 0.0]}}, "y": EDGE | {"form": {"half_plane": [0.0, 1.0]}}}
    flat["y"] |= {"stiffness": 800.0, "damping": 2.0}
    scene = plane({"mass": [[0.2, 0.05], [0.05, 0.3]]}, **flat)
    prediction = predict(scene, at=(0.029, -0.001))
    k, b = felt_at(scene, 0.029, -0.001)
    assert k == pytest.approx(np.array([[2084.173923226, -5.697022493], [-5.696440096, 808.687595188]]), abs=REFERENCE)
    assert b == pytest.approx(np.array([[3.02151507, -0.005667347], [-0.001394268, 1.809042967]]), abs=6e-9)
    poles = [pole for pole in prediction.poles if pole.imag > 0.0]
    assert poles == pytest.approx([0.995734798 + 0.051264131j, 0.986512821 + 0.103735424j], abs=REFERENCE)


def slide_growth(start: float, until: float) -> float:
    """Growth in a sample of the way that a hand has slid off a disc, once that is `until`, m. A steady 2 N pushes it
    onto the disc, whose force is sampled, held and a sample late; its mass moves exactly."""
    m, b, T, K, B, R = 0.2, 1.0, 1e-3, 2000.0, 5.0, 0.02
    decay = math.exp(-b * T / m)
    drift, gain = (1.0 - decay) * m / b, (T - (1.0 - decay) * m / b) / b
    x, v = np.array([-0.019, start]), np.zeros(2)
    held, before, ways = np.array([-2.0, 0.0]), x.copy(), []
    while abs(x[1]) < until:
        n = x / np.hypot(*x)
        force = -(K * (np.hypot(*x) - R) + B * (n @ (x - before)) / T) * n
        acts = held + np.array([2.0, 0.0])
        before, held = x.copy(), force
        x, v = x + drift * v + gain * acts, decay * v + (1.0 - decay) / b * acts
        ways.append(x[1])
    return ways[-1] / ways[-2]


def test_a_hand_slides_off_as_fast_as_predicted() -> None:
    """The slide has a real pole, along the surface; a simulation of the whole round surface grows by it."""
    prediction = predict(plane(disc=DISC), at=PRESSED_DISC)
    assert isinstance(prediction, PlanePrediction)
    (slide,) = prediction.slides
    assert (slide.module, prediction.verdict_here, prediction.stable) == ("hand", "slides", False)
    assert slide.pole == pytest.approx(1.020440217, abs=REFERENCE)
    assert slide.angle_deg == pytest.approx(90.0, abs=1e-9)
    assert slide.e_fold_s == pytest.approx(1e-3 / math.log(1.020440217), rel=1e-7)
    assert slide_growth(1e-10, 1e-6) == pytest.approx(slide.pole, abs=1e-9)
    assert slide_growth(1e-8, 2.4e-4) == pytest.approx(1.020439143, abs=5e-7)  # a quarter of a millimetre is not small


def test_a_mass_between_compressed_springs_moves_off() -> None:
    """Two springs of 100 N/m, pressed from 15 mm to 10 mm in a line, drive a mass out of it with -K."""
    spring = {"type": "spring", "stiffness": 100.0, "length": 0.015}
    scene = plane(
        ball={"type": "mass", "mass": 0.05, "position": [0.04, 0.0]},
        far=POST | {"position": [0.05, 0.0]},
        one=spring | {"between": ["ball", "post"]},
        other=spring | {"between": ["ball", "far"]},
    )
    prediction = predict(scene)
    assert isinstance(prediction, PlanePrediction)
    (slide,) = prediction.slides
    half = math.acosh(1.0 + 0.5 * 100.0 * 1e-6 / 0.05)  # of CORDIS's scheme: z - 2 + 1/z = K T²/m
    assert (slide.module, slide.angle_deg) == ("ball", pytest.approx(90.0, abs=1e-6))
    assert slide.pole == pytest.approx(math.exp(half), rel=1e-9)
    assert surely_shaken_by(scene) is None


def test_margins_are_of_what_shakes() -> None:
    """A slide takes nothing from a link's margin, which is that of the same wall on a line."""
    round_off, flat = (predict(plane(disc=one), at=at) for one, at in ((DISC, PRESSED_DISC), (EDGE, PRESSED_EDGE)))
    assert round_off.margins[0].stiffness_factor == pytest.approx(flat.margins[0].stiffness_factor, rel=1e-9)
    assert flat.stable
    hard = EDGE | {"stiffness": 2000.0 * 1.0001 * flat.margins[0].stiffness_factor}
    assert not predict(plane(disc=hard), at=PRESSED_EDGE).stable


def test_a_shape_that_shakes_the_hand_is_found_wherever_it_starts() -> None:
    """A wall too stiff for the loop is refused before it is touched; a slide alone is not."""
    for disc in (DISC, DISC | RUB, DISC | {"side": "inside"}):
        assert surely_shaken_by(plane(disc=disc)) is None
    shaken = surely_shaken_by(plane(disc=DISC | {"stiffness": 8000.0}))
    assert shaken is not None
    assert shaken.module == "hand"
    assert shaken.state.startswith("disc is touched with hand at ")
    assert not predict(plane(disc=DISC | {"stiffness": 8000.0})).stable


def test_walls_that_overlap_are_judged_together() -> None:
    """Each of two edges is stable by itself, both in one place are not; apart by a gap they are."""
    hard = EDGE | {"stiffness": 3500.0}
    other = hard | {"between": ["hand", "far"]}
    far = {"type": "ground", "position": [0.03, 0.0]}
    assert surely_shaken_by(plane(disc=hard)) is None
    shaken = surely_shaken_by(plane(disc=hard, far=far, wall=other))
    assert shaken is not None
    assert shaken.state == "disc is touched, wall is touched with hand at 30.1, 0 mm"
    back = other | {"form": {"half_plane": [1.0, 0.0]}}
    assert surely_shaken_by(plane(disc=hard, far=far | {"position": [0.02, 0.0]}, wall=back)) is None


@pytest.mark.parametrize("radius", [0.0, 0.002, 0.01])
def test_both_walls_of_a_hollow_corner_hold_and_damp_a_hand_pressed_into_it(radius: float) -> None:
    box = DISC | {"form": {"box": [0.1, 0.08]}, "side": "inside", "round": radius}
    scene = plane(box=box)
    assert surely_shaken_by(scene) is None
    depth, edge = 0.001, radius * (1.0 - math.sqrt(0.5))
    x, y = (0.03 + 0.05 - edge + depth * math.sqrt(0.5), 0.04 - edge + depth * math.sqrt(0.5))
    network = predict(scene, at=(x, y)).network
    share = depth / (radius + depth)
    assert sorted(network.stiffness) == pytest.approx(sorted([2000.0, 2000.0 * share]), rel=1e-9)
    assert sorted(network.damping) == pytest.approx(sorted([5.0, 5.0 * share]), rel=1e-9)


@pytest.mark.parametrize("radius", [0.0, 0.002])
def test_a_hand_that_is_pushed_into_a_hollow_corner_comes_to_rest(radius: float) -> None:
    box = DISC | {"form": {"box": [0.1, 0.08]}, "side": "inside", "round": radius}
    document = plane({"clock": "lockstep"}, box=box).model_dump() | {
        "mock": {"initial": {"position": [0.079, 0.039]}, "hand": {"force": [3.0, 3.0]}}
    }
    position = hapsim.run(Scene.model_validate(document), duration=2.0).position
    assert np.ptp(position[-200:], axis=0).max() < 1e-6
    assert 0.0005 < position[-1, 0] - 0.08 + radius * (1.0 - math.sqrt(0.5)) < 0.003


def test_static_stiffness_is_the_change_of_the_force() -> None:
    """Compares it with differences of the static force, in random places among all kinds of links; masses rest."""
    random, checked = np.random.default_rng(5), 0
    box = DISC | {"form": {"polygon": [[-0.02, -0.02], [0.03, -0.01], [0.02, 0.02], [-0.01, 0.01]]}, "round": 0.004}
    lane = {"type": "guide", "between": ["hand", "post"], "through": [[-0.03, 0], [0.0, 0.01], [0.03, 0.03]]}
    for _ in range(60):
        spring = {"type": "spring", "between": ["hand", "post"], "length": random.uniform(0.0, 0.05)}
        scene = plane(
            box=box | {"side": random.choice(["inside", "outside"])},
            lane=lane | {"stiffness": 300.0, "damping": 1.0},
            rope=spring | {"stiffness": random.uniform(50.0, 500.0)},
            ball={"type": "mass", "mass": 0.05, "position": random.uniform(-0.02, 0.02, 2).tolist()},
            tie=spring | {"between": ["ball", "post"], "stiffness": 200.0, "length": 0.01},
            hit={"type": "buffer", "between": ["hand", "ball"], "distance": 0.03, "stiffness": 700.0},
        )
        at = random.uniform(-0.01, 0.06), random.uniform(-0.03, 0.03)
        prediction, there = predict(scene, at=at), Plane(scene)
        assert isinstance(prediction, PlanePrediction)
        if any(math.isinf(one.curvature) for one in prediction.links):
            continue  # its normal is remembered, which a static force does not know

        def force(x: float, y: float, there: Plane = there) -> np.ndarray:
            rest = there.at_rest({"hand": (x, y)})
            assert rest is not None
            ends = [(one, (one.link.between[0] == "hand") - (one.link.between[1] == "hand")) for one in there.at(rest)]
            return -sum(side * one.tension * np.array(one.normal) for one, side in ends)

        step, (x, y) = 1e-7, at
        along_x = (force(x + step, y) - force(x - step, y)) / (2.0 * step)
        along_y = (force(x, y + step) - force(x, y - step)) / (2.0 * step)
        if not prediction.directions[1]:  # the ball rests in one place
            checked += 1
            (one,) = prediction.parts
            found = -np.array([along_x, along_y]).T
            assert found == pytest.approx(one.static_stiffness, rel=1e-5, abs=1e-3)
    assert checked > 10


@pytest.mark.parametrize("way", [1, -1])
def test_sliding_friction_reads_the_pressure(way: int) -> None:
    """Friction that slides is the coefficient times the pressure, along the surface: the rows are its derivative."""
    link = next(one for one in Plane(plane(disc=DISC | RUB)).at({"hand": (0.012, 0.006)}) if one.name == "disc")

    def force(r: np.ndarray) -> np.ndarray:
        away, press = r / np.hypot(*r), 2000.0 * (0.02 - np.hypot(*r))
        return np.asarray(press * away - way * 0.3 * press * np.array([-away[1], away[0]]))

    r, step = np.array([0.012 - 0.03, 0.006]), 1e-8
    K = -np.array([(force(r + step * e) - force(r - step * e)) / (2.0 * step) for e in np.eye(2)]).T
    assert sum(row.stiffness * np.outer(row.pull, row.stretch) for row in link.rows(way)) == pytest.approx(K, rel=1e-6)


def test_a_turn_of_the_frame_changes_no_pole() -> None:
    """Hand, post and ball are turned about position 0 by any angle."""
    rope = {"type": "viscoelastic", "between": ["ball", "post"], "stiffness": 300.0, "damping": 2.0, "length": 0.01}
    spring = rope | {"between": ["hand", "ball"], "length": 0.015}

    def turned(angle: float) -> PlanePrediction:
        def at(x: float, y: float) -> list[float]:
            return [math.cos(angle) * x - math.sin(angle) * y, math.sin(angle) * x + math.cos(angle) * y]

        ball = {"type": "mass", "mass": 0.05, "position": at(0.02, 0.005)}
        scene = plane(disc=DISC, ball=ball, rope=rope, spring=spring, post=POST | {"position": at(0.03, 0.0)})
        found = predict(scene, at=tuple(at(0.012, 0.001)))
        assert isinstance(found, PlanePrediction)
        return found

    as_it_is = turned(0.0)
    for angle in (0.3, 1.2, 2.9, 4.0):
        found = turned(angle)
        for before, after in zip(as_it_is.poles[:8], found.poles[:8], strict=True):
            assert min(abs(after - before), abs(after.conjugate() - before)) < 1e-12
        turn = [(b.angle_deg - a.angle_deg) % 180.0 for a, b in zip(as_it_is.slides, found.slides, strict=True)]
        assert turn == pytest.approx([math.degrees(angle) % 180.0] * len(turn), abs=1e-5)


@pytest.mark.parametrize(
    ("scene", "at", "words"),
    [
        (plane(disc=DISC), 0.03, "at: found 0.03, expected x, y in a scene with space: 2"),
        (
            plane({"travel": [-0.01, 0.02]}, disc=DISC),
            (0.0, 0.03),
            "at: found 0,0.03 m, 0.01 m outside the travel of hand, which goes from -0.01 to 0.02 m and from -0.01 to",
        ),
        (
            plane({"travel": {"disc": 0.04, "center": [0.01, 0.0]}}, disc=DISC),
            (0.04, 0.04),
            r"at: found 0.04,0.04 m, 0.01 m outside the travel of hand, which goes up to 0.04 m from \(0.01, 0\) m",
        ),
    ],
)
def test_a_place_that_is_none_is_refused(scene: Scene, at: Any, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        predict(scene, at=at)


def test_two_coordinates_are_refused_on_a_line() -> None:
    modules = {"hand": {"type": "device", "channel": 0}}
    scene = Scene.model_validate({"version": 1, "rate": 1000.0, "device": DEVICE, "modules": modules})
    with pytest.raises(UsageError, match=r"at: found \(0.0, 0.1\), expected a position in a scene with one coordinate"):
        predict(scene, at=(0.0, 0.1))


@pytest.mark.thorough(keep=7)
@pytest.mark.parametrize(
    "link",
    [
        {"type": "viscoelastic", "stiffness": 300.0},
        {"type": "plectrum", "stiffness": 300.0, "release": 0.004},
        {"type": "friction", "stiffness": 300.0, "force": 1.0},
        {"type": "nonlinear", "force_over_distance": [[-0.01, -3.0], [0.01, 3.0]]},
        {"type": "nonlinear", "force_over_distance": [[-0.01, -3.0], [0.01, 3.0]], "at": 0.0005},
        {"type": "nonlinear", "force_over_distance": [[0.0, -6.0], [0.02, 0.0]], "at": 0.0005},
        {"type": "plectrum", "stiffness": 300.0, "release": 0.05, "at": 0.004},
        *({"type": "spring", "stiffness": 300.0, "length": 0.02, "at": at} for at in (0.00205, 0.00215)),
        *({"type": "buffer", "stiffness": 300.0, "distance": 0.02, "at": at} for at in (0.00205, 0.00215)),
    ],
    ids=lambda link: f"{link['type']} {link.get('at', '')}",
)
def test_what_a_link_holds_across_near_the_place_where_its_ends_meet(link: dict[str, Any]) -> None:
    """As the kernel does in the sample in which the hand moves across a little, before a remembered direction turns."""
    at, way, own = link.get("at", 5e-5), 1e-9, {key: one for key, one in link.items() if key != "at"}
    scene = plane(post=POST | {"position": [0.0, 0.0]}, it=own | {"between": ["hand", "post"]})
    (one,) = Plane(scene).at({"hand": (at, 0.0)})
    assert math.isinf(one.curvature) == (at < 1e-4 + 0.1 * own.get("length", own.get("distance", 0.0)))
    path, force = np.array([[at, 0.0], [at, 0.0], [at, way]]), np.zeros((3, 2))
    program = compile_scene(scene)
    start(program, path[0])
    ticks(program, path, np.zeros_like(path), force, len(path))
    found = sum(row.stiffness * np.outer(row.pull, row.stretch) for row in one.rows())
    assert found[:, 1] == pytest.approx((force[1] - force[2]) / way, abs=0.05)


def test_ends_that_meet_have_no_direction() -> None:
    """A spring with a length whose ends start in one place."""
    spring = {"type": "spring", "between": ["hand", "post"], "stiffness": 100.0, "length": 0.01}
    scene = plane(post=POST | {"position": [0.0, 0.0]}, rope=spring)
    assert [one for one in unlikely(scene) if "modules.rope: hand and post meet at the start" in one]
    assert not unlikely(plane(rope=spring))
