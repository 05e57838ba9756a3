"""Verdicts on scenes in which something moves freely: stable where it is braked, at the limit where it drifts on."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from hapsim import predict
from hapsim.cli.check import _stability
from hapsim.scene import Scene, parse_scene

AT_LIMIT = "at the limit between stable and unstable: something drifts or swings for ever (spectral radius 1)"
TIE, LEASH = {"stiffness": 2000.0, "damping": 5.0}, {"stiffness": 500.0, "damping": 2.0}
RIGHT, THIRD, BALL = (
    {"type": "device", "channel": 1},
    {"type": "device", "channel": 2},
    {"type": "mass", "mass": 0.05},
)
WALL = {"type": "shape", "between": ["hand", "wall"], "form": {"half_plane": [-1, 0]}, "stiffness": 2000, "damping": 5}
DISC = WALL | {"form": {"disc": 0.02}}
WIRE = {"type": "guide", "between": ["hand", "wall"], "through": [[-0.05, 0.0], [0.05, 0.0]], "stiffness": 900.0}
WIRE |= {"damping": 3.0}


def link(first: str, second: str, kind: str = "viscoelastic", **values: float) -> dict[str, Any]:
    return {"type": kind, "between": [first, second], **values}


def scene_of(friction: float, modules: dict[str, Any], space: int = 1, **more: Any) -> Scene:
    hand = {"type": "device", "channel": 0} if space == 1 else {"type": "device", "channels": [0, 1]}
    device = {"mass": 0.2, "friction": friction, "delay": 1, "clock": "lockstep"}
    document = {"version": 1, "rate": 1000, "space": space, "device": device}
    document["modules"] = {"hand": hand, "wall": {"type": "ground"}} | modules
    return parse_scene(yaml.safe_dump(document | more, sort_keys=False), "scene")


def verdict(scene: Scene, at: Any = None) -> str:
    words = _stability(predict(scene, with_margins=False, at=at), False)
    return words.replace("[green]", "").replace("[/green]", "").replace("[yellow]", "").replace("[/yellow]", "")


TIED = {"right": RIGHT, "tie": link("hand", "right", **TIE)}


@pytest.mark.parametrize(
    ("modules", "moves"),
    [
        ({}, "hand moves freely"),
        ({"brake": link("hand", "wall", "damper", damping=2.0)}, "hand moves freely"),
        (TIED, "hand and right move freely together"),
        (TIED | {"third": THIRD, "other": link("right", "third", **TIE)}, "hand, right and third move freely together"),
        ({"right": RIGHT}, "hand moves freely; right moves freely"),
        ({"right": RIGHT, "leash": link("hand", "wall", **LEASH)}, "right moves freely"),
        ({"ball": BALL, "tie": link("hand", "ball", **TIE)}, "hand and ball move freely together"),
        ({"ball": BALL, "leash": link("hand", "wall", **LEASH), "brake": link("hand", "ball", "damper", damping=1.0)},
         "ball moves freely"),
        ({"bar": {"type": "string", "masses": 5, "mass": 0.01, "stiffness": 900.0, "damping": 0.1,
                  "ends": ["free", "free"]}, "tie": link("hand", "bar.2", **TIE)}, "hand and bar move freely together"),
    ],
)  # fmt: skip
def test_what_moves_freely_is_stable_if_it_is_braked(modules: dict[str, Any], moves: str) -> None:
    """A push moves it on, for a way; without any friction, for ever."""
    scene = scene_of(1.0, modules)
    words = verdict(scene)
    assert words.startswith(f"stable ({moves}; the rest 0.9")
    assert predict(scene, with_margins=False).spectral_radius == 1.0
    if not any(one.get("type") == "damper" for one in modules.values()):
        assert verdict(scene_of(0.0, modules)).startswith(AT_LIMIT[:12])


def test_the_rest_is_the_largest_pole_of_what_does_not_rest() -> None:
    prediction = predict(scene_of(1.0, TIED), with_margins=False)
    moving = sorted(abs(pole) for pole in prediction.poles)[:-1]
    assert verdict(scene_of(1.0, TIED)) == f"stable (hand and right move freely together; the rest {moving[-1]:.9g})"


@pytest.mark.parametrize(
    ("modules", "at", "moves"),
    [
        ({}, None, "hand moves freely"),
        ({"edge": WALL}, (0.001, 0.0), "hand moves freely along edge"),
        ({"edge": WALL}, (-0.001, 0.0), "hand moves freely"),
        ({"wire": WIRE}, (0.0, 0.001), "hand moves freely along wire"),
        ({"edge": WALL, "other": WALL | {"form": {"half_plane": [1, 0]}, "between": ["hand", "far"]},
          "far": {"type": "ground", "position": [0.002, 0.0]}}, (0.001, 0.0), "hand moves freely along 90°"),
    ],
)  # fmt: skip
def test_in_the_plane_it_names_the_link_along_which_it_moves(modules: dict[str, Any], at: Any, moves: str) -> None:
    assert verdict(scene_of(1.0, modules, space=2), at).startswith(f"stable ({moves}; the rest 0.99")


def test_a_slide_that_nobody_notices_is_none() -> None:
    """A disc drives a hand off that presses it in by p, in m: e-fold in b/(K p/r) = 1e-5/p s."""
    scene = scene_of(1.0, {"disc": DISC}, space=2)
    for depth in (1e-3, 2e-7, 5e-8, 1e-12):
        prediction = predict(scene, with_margins=False, at=(0.02 - depth, 0.0))
        is_noticed = 1e-5 / depth < 100.0
        assert prediction.verdict_here == ("slides" if is_noticed else "stable"), depth
        assert len(prediction.slides) == int(is_noticed)
        assert is_noticed or verdict(scene, (0.02 - depth, 0.0)).startswith(
            "stable (hand moves freely along disc; the rest"
        )


@pytest.mark.parametrize(
    ("modules", "friction", "words"),
    [
        ({"ball": BALL, "spring": link("ball", "wall", "spring", stiffness=100.0)}, 1.0, AT_LIMIT),  # it swings
        ({"ball": BALL, "leash": link("hand", "wall", **LEASH)}, 1.0, AT_LIMIT),  # it drifts
        ({}, 0.0, AT_LIMIT),
        (TIED | {"third": THIRD, "stiff": link("third", "wall", stiffness=50000.0)}, 1.0, "[red]unstable"),
        ({"ball": BALL, "tie": link("hand", "ball", stiffness=60000.0)}, 1.0, "[red]unstable"),
    ],
)
def test_a_swing_a_drift_or_a_growing_motion_is_not_stable(
    modules: dict[str, Any], friction: float, words: str
) -> None:
    assert verdict(scene_of(friction, modules)).startswith(words)
