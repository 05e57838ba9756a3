"""A hand in the plane: its stiffness and damping matrices as measured on the mock, beside the theory of the loop with
the links' geometry written out here."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import yaml

import hapsim
from hapsim.errors import UsageError
from hapsim.prediction.predict_impedance import predict_impedance
from hapsim.scene import Scene, parse_scene
from hapsim.theory import Network
from hapsim.theory.network import felt_pair

RATE, CLOSE = 1000, 1e-5
COUPLED = [[0.2, 0.05], [0.05, 0.3]]
DISC = {"type": "shape", "between": ["hand", "post"], "form": {"disc": 0.02}, "stiffness": 2000, "damping": 5}


def scene_of(modules: dict[str, Any], post: list[float], **more: Any) -> Scene:
    """Counts of the position are so fine that a motion of a micron is many of them."""
    device = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"} | more.pop("device", {})
    points = {"hand": {"type": "device", "channels": [0, 1]}, "post": {"type": "ground", "position": post}}
    mock = {"quantum": 1e-11} | more.pop("mock", {})
    document = {"version": 1, "rate": RATE, "space": 2, "device": device, "mock": mock, "modules": points | modules}
    return parse_scene(yaml.safe_dump(document | more, sort_keys=False), "scene")


Row = tuple[list[float], float, float]
"""Direction, stiffness in N/m, damping in N·s/m."""


def across(n: list[float]) -> list[float]:
    return [-n[1], n[0]]


def felt(rows: list[Row], mass: Any = (0.2, 0.2), friction: Any = (1.0, 1.0), held: Any = (0.0, 0.0)) -> Any:
    """Returns the pair that the hand feels. `held`: N/m, of springs beside the device, which no sampling changes."""
    directions, stiffness, damping = zip(*rows, strict=True)
    network = Network(
        rate=RATE, channel_mass=np.array(mass), channel_friction=np.array(friction), delay=1.0, hold="zoh",
        sampling="ideal", point_mass=np.zeros(0), ends=np.zeros((0, 2), int), stiffness=np.array(stiffness),
        damping=np.array(damping), channel_stiffness=np.array(held), rows=np.array(directions),
    )  # fmt: skip
    found = felt_pair(network, most=math.inf)
    assert not found.reason
    return found


def require_alike(measured: Any, expected: Any) -> None:
    """Matrices within CLOSE of their largest number, and within what the measurement says of itself."""
    for name in ("k", "b"):
        found, right = getattr(measured, name), getattr(expected, name)
        assert np.abs(found - right).max() <= CLOSE * np.abs(right).max(), name
        assert (np.abs(found - right) <= 10.0 * getattr(measured, f"{name}_uncertainty")).all(), name


def test_a_ring_holds_the_hand_along_its_surface() -> None:
    measured = hapsim.measure(scene_of({"ring": DISC | {"side": "inside"}}, [-0.02, 0.0]), at=(0.001, 0.0))
    require_alike(measured, felt([([-1.0, 0.0], 2000.0, 5.0), ([0.0, 1.0], 2000.0 * 0.001 / 0.021, 0.0)]))
    stiff, soft = measured.principal
    assert math.sin(stiff.angle) == pytest.approx(0.0, abs=1e-5)
    assert math.degrees(soft.angle) == pytest.approx(90.0, abs=1e-3)
    assert (stiff.k, soft.k) == pytest.approx((2080.439463958, 95.185098565), rel=CLOSE)
    assert (stiff.b, soft.b) == pytest.approx((3.020774022, 0.856694249), rel=3 * CLOSE)
    assert measured.at_m == (0.001, 0.0)


def test_a_hand_that_slides_off_is_reported_with_its_rate() -> None:
    with pytest.raises(UsageError, match=r"the hand slides off along 90°: .*\(friction_coefficient\)") as error:
        hapsim.measure(scene_of({"disc": DISC}, [0.02, 0.0]), at=(0.001, 0.0))
    pole = float(str(error.value).partition("a pole of ")[2].partition(")")[0])
    assert math.log(pole) == pytest.approx(math.log(1.020440217), rel=1e-3)
    assert f"e-fold in {1e3 / (RATE * math.log(pole)):.3g}" in str(error.value)


def test_friction_that_sticks_holds_the_hand_along_a_surface() -> None:
    """The hand comes along the surface and bends the bristle; at its place the bristle is straight again."""
    post, at = [0.02, 0.0], (0.0021, 0.003)
    away = (at[0] - post[0], at[1] - post[1])
    far = math.hypot(*away)
    n = [away[0] / far, away[1] / far]
    measured = hapsim.measure(scene_of({"disc": DISC | {"friction_coefficient": 0.3}}, post), at=at)
    press = 0.02 - far
    rows = [(n, 2000.0, 5.0), (across(n), -2000.0 * press / far, 0.0), (across(n), 1000.0, 5.0)]
    expected = felt(rows)
    stiff, soft = measured.principal
    assert (stiff.k, soft.k) == pytest.approx(tuple(sorted(np.linalg.eigvalsh(expected.k), reverse=True)), rel=CLOSE)


def springs(at: tuple[float, float]) -> tuple[dict[str, Any], list[Row]]:
    """Three springs and their rows: K n n' + B, and (f/L)(1 - n n') for a tension f at a length L."""
    modules: dict[str, Any] = {}
    rows: list[Row] = []
    for i, (x, y, K, B, longer) in enumerate(
        ((0.05, 0.01, 1500, 5, 0.002), (-0.03, 0.02, 900, 3, -0.001), (0, -0.04, 600, 4, 0.003))
    ):
        length = math.hypot(at[0] - x, at[1] - y)
        n = [(at[0] - x) / length, (at[1] - y) / length]
        modules[f"end_{i}"] = {"type": "ground", "position": [x, y]}
        ends = ["hand", f"end_{i}"] if i else [f"end_{i}", "hand"]
        link = {"type": "viscoelastic", "between": ends, "stiffness": K, "damping": B, "length": length - longer}
        modules[f"spring_{i}"] = link
        rows += [(n, float(K), float(B)), (across(n), K * longer / length, 0.0)]
    return modules, rows


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("mass", [0.2, COUPLED])
def test_springs_in_the_plane_and_a_coupled_mass(mass: Any) -> None:
    at = (0.004, 0.003)
    modules, rows = springs(at)
    measured = hapsim.measure(scene_of(modules, [0.0, 0.0], device={"mass": mass, "friction": [1.0, 2.0]}), at=at)
    require_alike(measured, felt(rows, np.array(mass) * np.ones(2) if mass == 0.2 else mass, (1.0, 2.0)))


def test_a_coupled_mass_has_an_impedance_across() -> None:
    scene = scene_of({"disc": DISC}, [0.02, 0.0], device={"mass": COUPLED, "friction": [1.0, 2.0]})
    found = predict_impedance(scene, [5.0, 40.0]).ideal_device
    for one, s in zip(found, 2j * np.pi * np.array([5.0, 40.0]), strict=True):
        np.testing.assert_allclose(one, s * np.array(COUPLED) + np.diag([1.0, 2.0]))


def test_by_default_it_is_measured_where_it_starts() -> None:
    at = (0.004, 0.003)
    modules, rows = springs(at)
    scene = scene_of(modules, [0.0, 0.0], mock={"initial": {"position": list(at)}})
    measured = hapsim.measure(scene)
    assert measured.at_m == at
    require_alike(measured, felt(rows))


def test_places_that_cannot_be_measured_are_refused_in_words() -> None:
    scene = scene_of({"disc": DISC}, [0.02, 0.0])
    with pytest.raises(UsageError, match="no link touches the hand"):
        hapsim.measure(scene, at=(-0.01, 0.0))
    with pytest.raises(UsageError, match="the scene asks for 20 N, more than the force limit of 10 N"):
        hapsim.measure(scene, at=(0.01, 0.0))
    with pytest.raises(UsageError, match=r"at: found 0\.01, expected \(x, y\)"):
        hapsim.measure(scene, at=0.01)
    with pytest.raises(UsageError, match="channel 7: the scene has nothing there"):
        hapsim.measure(scene, channel=7)
    line = scene.model_copy(update={"space": 1})
    with pytest.raises(UsageError, match=r"at: found 0,0\.1, expected one position in a scene with one coordinate"):
        hapsim.measure(line, at=(0.0, 0.1))


@pytest.mark.parametrize(
    ("form", "at", "is_reached"),
    [
        ({"capsule": [[0.0, -0.05], [0.0, 0.05]], "radius": 0.001}, (0.05, 0.0), False),
        ({"disc": 0.02}, (0.049, 0.0), False),
        ({"disc": 0.02}, (0.012, 0.0), True),
        ({"disc": 0.02}, (0.03, 0.0235), True),
    ],
    ids=["through a wall", "behind a disc", "before it", "past its side"],
)
def test_a_place_behind_a_shape_is_refused_before_the_run(
    form: dict[str, Any], at: tuple[float, float], is_reached: bool
) -> None:
    hold = {"type": "viscoelastic", "between": ["hand", "post"], "stiffness": 100.0, "damping": 1.0}
    wall = DISC | {"form": form, "friction_coefficient": 0.5}
    scene = scene_of({"wall": wall, "hold": hold}, [0.03, 0.0], mock={"quantum": 1e-9})
    if is_reached:
        assert hapsim.measure(scene, at=at).at_m == at
        return
    with pytest.raises(UsageError, match="wall is in the way: the hand is led there along a straight line"):
        hapsim.measure(scene, at=at)
