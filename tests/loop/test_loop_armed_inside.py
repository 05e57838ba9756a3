"""A hand that is armed deeper inside a wall than the force limit presses is not thrown out."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.laws import Law, curve_law, line
from hapsim.recording.trace import Trace
from hapsim.running import run
from hapsim.scene import Scene

sys.path.append(str(Path(__file__).parents[1] / "probe"))

from virtual_line import PORT, virtual_port

ENERGY = 0.2  # J, of a force limit of 10 N
BUFFER = {"type": "buffer", "stiffness": 2000, "damping": 5}
TABLE = {"type": "nonlinear", "force_over_distance": [[-0.03, -60], [0.0, 0.0], [0.05, 0.0], [0.08, 60]]}
DISC = {"type": "shape", "form": {"disc": 0.02}, "stiffness": 2000, "damping": 5, "friction_coefficient": 0.2}
PLANE = {"type": "shape", "form": {"half_plane": [1, 0]}, "stiffness": 2000}


def scene_with(wall: dict[str, Any], at: Any, space: int = 1, **parts: Any) -> Scene:
    """A hand at a place, m, of a wall at 0."""
    hand: dict[str, Any] = {"channel": 0} if space == 1 else {"channels": [0, 1]}
    modules = {
        "hand": {"type": "device", **hand},
        "post": {"type": "ground", "position": 0.0 if space == 1 else [0, 0]},
    }
    modules |= {"wall": {"between": ["hand", "post"]} | wall}
    device = {"mass": 0.2, "friction": 1.0, "clock": "lockstep", "force_limit": 10.0} | parts.pop("device", {})
    mock = {"initial": {"position": at}} | parts.pop("mock", {})
    whole = {
        "version": 1,
        "rate": 1000,
        "space": space,
        "device": device,
        "modules": modules | parts.pop("modules", {}),
    }
    return Scene.model_validate(whole | {"mock": mock} | parts)


def played(scene: Scene, duration: float = 0.6, **options: Any) -> tuple[Trace, Any, Any]:
    """Returns the trace, and of every sample the force of all channels, N, and the energy of the motion, J."""
    trace = run(scene, duration=duration, judges_energy=True, **options)
    speed = np.linalg.norm(np.diff(trace.position, axis=0, prepend=trace.position[:1]), axis=1) * trace.rate
    return trace, np.linalg.norm(trace.force, axis=1), 0.5 * 0.2 * speed**2


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize(
    ("wall", "at", "depth", "parts"),
    [
        (BUFFER, -0.02, 0.02, {}),
        (BUFFER, -0.02, 0.02, {"precision": "single"}),
        (BUFFER | {"between": ["post", "hand"], "distance": 0.01}, 0.02, 0.03, {}),
        (BUFFER, -0.05, 0.05, {"scheme": "rk4", "substeps": 4}),
        (TABLE, -0.02, 0.02, {}),
        (TABLE, 0.07, 0.02, {}),
        ({"type": "click", "travel": 0.01, "peak": 5, "drop": 2, "bottom": 3000}, -0.02, 0.02, {}),
        (DISC, [0.0, 0.0], 0.02, {"space": 2}),
        (DISC, [0.006, 0.003], 0.02 - np.hypot(0.006, 0.003), {"space": 2}),
        (DISC | {"side": "inside"}, [0.05, 0.04], np.hypot(0.05, 0.04) - 0.02, {"space": 2}),
        (PLANE, [-0.03, 0.5], 0.03, {"space": 2}),
    ],
)
def test_until_it_is_out_its_force_is_low(wall: dict[str, Any], at: Any, depth: float, parts: dict[str, Any]) -> None:
    trace, force, energy = played(scene_with(wall, at, **parts), 1.2)
    low = trace.report.armed_inside
    assert low.startswith(f"hand was armed {1e3 * depth:.3g} mm inside a contact, at ")
    out = int(np.argmax(np.linalg.norm(trace.asked_force, axis=1) == 0.0))
    assert 20 < out < 1200
    assert force[:out].max() <= 0.1 * ENERGY / depth + 1e-3
    assert force[:out].max() > 0.09 * ENERGY / depth
    assert energy.max() <= 0.1 * ENERGY


def test_a_hand_that_was_out_once_feels_the_whole_wall() -> None:
    hand = {"stiffness": 400, "damping": 2, "position": -0.03}  # draws it back in
    scene = scene_with(BUFFER, -0.02, mock={"initial": {"position": -0.02, "velocity": 3.0}, "hand": hand})
    trace, force, _ = played(scene, 1.0)
    out = int(np.argmax(trace.position[:, 0] > 0.0))
    assert out > 0
    assert force[:out].max() <= 0.1 * ENERGY / 0.02 + 1e-3
    assert force[out:].max() > 5.0


def test_a_hand_between_two_walls_that_overlap_is_out_where_it_has_passed_their_middle() -> None:
    modules = {"other": BUFFER | {"between": ["post", "hand"], "distance": 0.0}}
    trace, force, _ = played(scene_with(BUFFER, -0.02, modules=modules, mock={"hand": {"force": 0.0}}), 0.6)
    assert trace.report.armed_inside.startswith("hand was armed 20 mm inside a contact")
    passed = int(np.argmax(trace.position[:, 0] > 0.0))
    assert passed > 0
    assert force[:passed].max() <= 0.1 * ENERGY / 0.02 + 1e-3
    assert force[passed:].max() > 3.0  # it swings to the other side


def test_a_hand_that_went_through_a_wall_is_reported_at_the_end() -> None:
    """One that presses a little harder than the limit is not."""
    through = {"initial": {"position": 0.03, "velocity": -8.0}}
    trace, *_ = played(scene_with(BUFFER, 0.03, mock=through), 0.1)
    at, asked = trace.position[-1, 0], abs(trace.asked_force[-1, 0])
    assert at < -0.02
    expected = (
        f"hand was at {at:.3g} m when the run ended, where the scene asks for {asked:.3g} N: the force limit of 10"
    )
    assert trace.report.beyond_limit.startswith(expected)
    trace, *_ = played(scene_with(BUFFER, -0.0065), 0.003)
    assert (trace.report.limited_ticks > 0, trace.report.beyond_limit) == (True, "")


def test_the_hand_of_two_that_is_inside_is_the_one_that_is_low() -> None:
    more = {"other": {"type": "device", "channel": 1}, "stop": BUFFER | {"between": ["other", "post"]}}
    scene = scene_with(BUFFER, [-0.001, -0.04], modules=more)
    trace, _, _ = played(scene)
    assert trace.report.armed_inside.startswith("other was armed 40 mm inside a contact, at -0.04 m")
    assert np.abs(trace.force[:, 1]).max() <= 0.1 * ENERGY / 0.04 + 1e-3
    assert np.abs(trace.force[0, 0]) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("wall", "at", "parts"),
    [
        (BUFFER, -0.004, {}),  # 8 N
        (BUFFER, 0.01, {"mock": {"initial": {"position": 0.001, "velocity": -2.0}}}),  # outside, then deep in it
        ({"type": "viscoelastic", "stiffness": 2000, "damping": 5}, -0.02, {}),  # a spring
    ],
)
def test_any_other_hand_feels_what_it_did(wall: dict[str, Any], at: Any, parts: dict[str, Any]) -> None:
    trace, force, _ = played(scene_with(wall, at, **parts))
    assert trace.report.armed_inside == ""
    np.testing.assert_allclose(force[:50], np.minimum(np.abs(trace.asked_force[:50, 0]), 10.0), atol=1e-3)
    assert force.max() > 7.0


def test_without_an_energy_limit_nothing_is_lowered() -> None:
    trace = run(scene_with(BUFFER, -0.02), duration=0.2)
    assert np.abs(trace.force).max() == pytest.approx(10.0)


def test_on_a_port_the_place_is_printed_too(
    hapsim: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen = virtual_port(monkeypatch, rate=1000.0, bodies=[{"x": -0.02}])
    path = tmp_path / "wall.yaml"
    path.write_text(
        f"version: 1\nrate: 1000\ndevice: {{port: {PORT}, mass: 0.2, friction: 1, force_limit: 10}}\n"
        "modules:\n  hand: {type: device, channel: 0}\n  wall: {type: ground}\n"
        "  stop: {type: buffer, between: [hand, wall], stiffness: 2000, damping: 5}\n"
    )
    answer = hapsim("run", path, "--portable", "--duration", 0.5)
    said = (
        "hand was armed 20 mm inside a contact, at -0.02 m. Until it is out once, its force is at most 1 N: move it out"
    )
    assert said in answer.err
    assert seen.largest <= 1.0
    assert 0.5 * 0.2 * seen.fastest**2 < 0.1 * ENERGY


def test_a_table_without_force_on_one_side_or_in_its_middle_is_a_contact() -> None:
    def edges(*knots: tuple[float, float], **more: float) -> dict[str, float]:
        law = curve_law(knots) if not more else Law(knots, (0.0,) * (len(knots) + 1), ("",) * 2, **more)
        return {end: law.knots[knot][0] for end, knot in law.contact_edges.items()}

    assert edges((-1, -2), (0, 0)) == {"low": 0.0}
    assert edges((-1, -2), (0, 0), (1, 0)) == {"low": 0.0}
    assert edges((0, 0), (1, 2)) == {"high": 0.0}
    assert edges((-2, -2), (-1, 0), (1, 0), (2, 3)) == {"low": -1.0, "high": 1.0}
    assert edges((0.5, 0.0), below=100.0) == {"low": 0.5}
    assert edges((0.5, 0.0), beyond=100.0) == {"high": 0.5}
    for spring in (((-1, -2), (1, 2)), ((-1, -2), (0, 0), (1, 2)), ((-1, 2), (0, 0)), ((-1, 0), (0, -3), (1, 0))):
        assert edges(*spring) == {}, spring
    assert line(100.0, 1.0).contact_edges == {}
