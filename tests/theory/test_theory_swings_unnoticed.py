"""A scene that merely trembles may be armed: none may that does more than that somewhere else, or later."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hapsim import predict
from hapsim.prediction import surely_shaken_by
from hapsim.scene import Scene
from tests import one_hand
from tests.contact_scenes import Motion

NARROW = [[-0.05, -15.02], [-1e-6, -0.02], [1e-6, 0.02], [0.05, 15.02]]  # 20 000 N/m over 2 µm, 300 N/m beside
CAP = {"type": "cell", "mass": 0.1, "stiffness": 50000.0, "damping": 20.0}


def table(points: list[Any], first: str = "hand", second: str = "wall") -> dict[str, Any]:
    return {
        "type": "nonlinear",
        "between": [first, second],
        "force_over_distance": [[float(x) for x in p] for p in points],
    }


def spring(first: str, second: str, stiffness: float, damping: float = 0.0) -> dict[str, Any]:
    return {"type": "viscoelastic", "between": [first, second], "stiffness": stiffness, "damping": damping}


def scene_of(modules: dict[str, Any], quantum: float = 1e-4, **device: Any) -> Scene:
    own = {"mass": 0.1, "friction": 3.0, "force_limit": 10.0} | device
    return one_hand.scene_of(modules, device=own, mock={"quantum": quantum})


def on_a_cap(points: list[Any] = NARROW) -> dict[str, Any]:
    return {"cap": CAP, "curve": table(points, "hand", "cap")}


def alternating(mean: float, steep: float, pieces: int, width: float) -> list[tuple[float, float]]:
    """Pieces of this mean slope, of which every other is as steep as that."""
    x = width * (np.arange(pieces + 1) - 0.5 * pieces)
    slopes = np.where(np.arange(pieces) % 2 == 1, steep, 2.0 * mean - steep)
    force = np.concatenate([[0.0], np.cumsum(slopes * width)])
    return list(zip(x.tolist(), (force - np.interp(0.0, x, force)).tolist(), strict=True))


ROOF = {
    "roof": {"type": "ground", "position": 0.005},
    "b": {"type": "cell", "mass": 0.02, "stiffness": 400.0, "damping": 0.1, "position": -0.012, "rest": 0.0},
    "stop": {"type": "buffer", "between": ["roof", "b"], "stiffness": 90000.0},
    "finger": {"type": "buffer", "between": ["hand", "b"], "stiffness": 500.0, "damping": 1.0, "distance": -0.002},
}
OWN = [[-0.05, -15], [0.009, 2.7], [0.009002, 2.74], [0.0142, 4], [0.0143, 5], [0.05, 15]]
EDGE = [[-0.05, -14.5], [0, 0], [0.01999, 6.94], [0.02001, 7.06], [0.06, 18.66]]
LIMIT = 2016.5  # N/m, the largest stable stiffness of this hand
FAST = [[-10.0, -3880.3], [-0.3, -0.3], [0.3, 0.3], [10.0, 3880.3]]


def hidden(at: int) -> list[list[float]]:
    """300 unstable pieces of 2 µm, and one of 0.2 mm before that with this number."""
    points = [[0.0, 0.0]]
    for piece in range(300):
        wide = [(3e-4, 300.0), (2e-4, 20000.0), (3e-4, 300.0)] if piece == at else []
        for width, slope in (*wide, (2e-6, 20000.0 + piece), (1e-4, 10.0)):
            points.append([points[-1][0] + width, points[-1][1] + width * slope])
    middle = points[len(points) // 2]
    return [[x - middle[0], force - middle[1]] for x, force in points]


def rough() -> list[tuple[float, float]]:
    """300 pieces of 20 µm at 1680 N/m, and in the middle one of 2 µm at 6000."""
    count, width, k, steep = 150, 20e-6, 1680.0, 6000.0
    x = np.arange(-count, count + 1) * width
    force = k * x + (np.arange(-count, count + 1) % 2) * 1e-4
    points = [(a, f) for a, f in zip(x.tolist(), force.tolist(), strict=True) if abs(a) > 1e-9]
    points = sorted([*points, (9e-6, k * 9e-6), (11e-6, k * 9e-6 + 2e-6 * steep)])
    return [(a, f + 2e-6 * (steep - k) * (a > 11e-6)) for a, f in points]


MORE_THAN_TREMBLES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "another hand": (
        on_a_cap() | {"hand2": {"type": "device", "channel": 1}, "stiff": spring("hand2", "wall", 4000.0)},
        {},
    ),
    "another part that drives itself": (
        on_a_cap()
        | {
            "other": {"type": "cell", "mass": 0.1, "stiffness": 400.0},
            "drive": {"type": "nonlinear", "between": ["other", "wall"], "force_over_velocity": [[-10, 10], [10, -10]]},
        },
        {},
    ),
    "a state without a rest": (on_a_cap() | ROOF, {}),
    "one of more pieces than are looked at": ({"curve": table(hidden(150))}, {"force_limit": 20.0}),
    "the next of these": ({"curve": table(hidden(151))}, {"force_limit": 20.0}),
    "a piece under the device's own spring": ({"curve": table(OWN)}, {"stiffness": 500.0}),
    "larger motions, in narrow pieces": (
        {"curve": table(alternating(1.004 * LIMIT, 1.9 * LIMIT, 401, 2.5e-6))},
        {"force_limit": 20.0},
    ),
    "larger motions, slowly": (
        {"curve": table(alternating(1.01 * LIMIT, 1.9 * LIMIT, 401, 2.5e-6))},
        {"force_limit": 20.0},
    ),
    "a damper that is fast": (
        on_a_cap(rough()) | {"damper": {"type": "nonlinear", "between": ["hand", "cap"], "force_over_velocity": FAST}},
        {"friction": 6.0, "force_limit": 5.0},
    ),
}


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("name", MORE_THAN_TREMBLES)
def test_a_scene_that_does_more_than_tremble_is_refused(name: str) -> None:
    modules, device = MORE_THAN_TREMBLES[name]
    assert surely_shaken_by(scene_of(modules, **device)) is not None


def test_a_rest_is_in_the_middle_of_its_piece() -> None:
    """At its edge the swing is a fifth as large; on the mock 91 µm."""
    scene = scene_of({"curve": table(EDGE)}, quantum=5e-5)
    shaking = surely_shaken_by(scene)
    assert shaking is not None
    assert shaking.swing is not None
    assert shaking.swing.most == pytest.approx(91e-6, rel=0.1)


def test_a_hand_that_trembles_where_it_rests_may_be_armed_as_one_that_does_elsewhere() -> None:
    aside = [[x + 0.004, force + 0.8] for x, force in NARROW]
    for points in (NARROW, aside):
        scene = scene_of({"curve": table(points)})
        prediction = predict(scene, with_margins=False)
        assert prediction.trembles == ("hand",)
        assert surely_shaken_by(scene) is None
    assert surely_shaken_by(scene_of(on_a_cap())) is None


def test_what_drifts_away_is_no_swing() -> None:
    """Pressed on the bottom of a click, a hand swings by 6.4 mm; where it gives way, it drifts off by 75 mm in the same
    time, at constant speed: no swing."""
    click = {"type": "click", "between": ["hand", "cap"], "travel": 0.001, "peak": 2.0, "drop": 3.0, "bottom": 20000.0}
    scene = scene_of({"cap": CAP, "click": click})
    (swing,) = predict(scene, with_margins=False).judge.swings.values()
    assert swing is not None
    pressed, cap = 5.0, -5.0 / CAP["stiffness"]
    motion = Motion(scene, {"hand": np.array([cap - 0.00125]), "cap": np.array([cap])}, held=-pressed)
    motion.push("hand", np.array([0.01]))
    way = []
    for _ in range(6000):
        motion.step()
        way.append(motion.now["hand"])
    assert float(np.ptp(way[-1000:])) == pytest.approx(swing.most, rel=0.02)


def test_what_dies_out_is_no_swing() -> None:
    """Faster than 0.1 m/s the damper is too steep, but no kick at rest gets there."""
    damper = {"type": "nonlinear", "between": ["hand", "wall"]}
    damper |= {"force_over_velocity": [[-0.101, -0.5], [-0.1, -0.1], [0.1, 0.1], [0.101, 0.5]]}
    scene = scene_of({"damper": damper, "spring": spring("hand", "wall", 300.0, 1.0)})
    assert predict(scene, with_margins=False).judge.swings == {"hand": None}
    assert surely_shaken_by(scene) is not None


def test_a_piece_of_no_width_is_no_trouble() -> None:
    prediction = predict(scene_of(on_a_cap([[-5e-13, -1e-9], [5e-13, 1e-9]])), with_margins=False)
    assert [one.felt for one in prediction.parts]


def test_of_many_parts_few_are_simulated() -> None:
    drive = {"type": "nonlinear", "force_over_velocity": [[-1, 0.1], [1, -0.1]]}
    cells = {f"c{i}": {"type": "cell", "mass": 0.1, "stiffness": 5000.0} for i in range(20)}
    modules = cells | {f"d{i}": drive | {"between": [f"c{i}", "wall"]} for i in range(20)}
    modules |= {
        f"b{i}": {"type": "buffer", "between": ["wall", f"c{i}"], "stiffness": 9.0, "distance": -1.0} for i in range(20)
    }
    assert (
        len(predict(scene_of(modules | {"t": spring("hand", "wall", 300.0, 1.0)}), with_margins=False).judge.swings)
        <= 4
    )
