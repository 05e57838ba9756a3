"""The bridge to Haply's hAPI, in front of a mock board that is made from hAPI's frames and from inverse kinematics:
what is measured, what is put out, and that hapsim's commands feel through it what they predict."""

from __future__ import annotations

import ctypes
import json
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bridged import Bridged, Pushing
from scipy.optimize import brentq

from hapsim.bringup.probe import Leave, judge, open_wire, steps_of
from hapsim.scene import load_scene
from tests.attempts import attempts

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="bridges stand on pseudo-terminals of Linux")

MODELS = {"v3": (0.07, 0.09, 0.038), "v2": (0.07, 0.09, 0.0), "devkit": (0.05, 0.07, 0.02)}
LIMIT = 0.123  # N·m
Pair = ctypes.c_double * 2


class Arms(ctypes.Structure):
    _fields_ = (("proximal", ctypes.c_double), ("distal", ctypes.c_double), ("base", ctypes.c_double))


class Pose(ctypes.Structure):
    _fields_ = (("point", Pair), ("link", Pair * 2), ("lever", Pair))


@pytest.fixture(scope="session")
def library(built_haply_mock: Path) -> ctypes.CDLL:
    found = ctypes.CDLL(str(built_haply_mock / "pantograph.so"))
    found.pantograph_forward.restype = found.pantograph_torques.restype = ctypes.c_bool
    found.pantograph_torques.argtypes = [ctypes.c_void_p, Pair, ctypes.c_double, Pair]
    return found


def forward(library: ctypes.CDLL, model: str, angles: tuple[float, float]) -> Pose | None:
    pose = Pose()
    reached = library.pantograph_forward(
        ctypes.byref(Arms(*MODELS.get(model, (0.07, 0.09, 0.05)))), Pair(*angles), ctypes.byref(pose)
    )
    return pose if reached else None


def torques(library: ctypes.CDLL, pose: Pose, force: tuple[float, float], limit: float) -> tuple[np.ndarray, bool]:
    out = Pair()
    scaled = library.pantograph_torques(ctypes.byref(pose), Pair(*force), limit, out)
    return np.array(out), bool(scaled)


def inverse(model: str, point: tuple[float, float]) -> tuple[float, float]:
    """The angles at which each distal link just reaches the point, by bisection: the left elbow to the left."""
    proximal, distal, base = MODELS[model]

    def beyond(angle: float, arm: int) -> float:
        elbow = arm * base + proximal * math.cos(angle), proximal * math.sin(angle)
        return math.dist(elbow, point) - distal

    towards = [math.atan2(point[1], point[0] - arm * base) for arm in (0, 1)]
    return (
        float(brentq(beyond, towards[0], towards[0] + math.pi, args=(0,), xtol=1e-14)),
        float(brentq(beyond, towards[1] - math.pi, towards[1], args=(1,), xtol=1e-14)),
    )


def poses(model: str) -> Iterator[tuple[float, float]]:
    proximal, distal, base = MODELS[model]
    rng = np.random.default_rng(7)
    for _ in range(50):
        x, y = base / 2 + rng.uniform(-0.4, 0.4) * proximal, rng.uniform(0.35, 0.85) * (proximal + distal)
        yield float(x), float(y)


@pytest.mark.parametrize("model", MODELS)
def test_forward_kinematics_undo_a_numeric_inverse(model: str, library: ctypes.CDLL) -> None:
    for point in poses(model):
        pose = forward(library, model, inverse(model, point))
        assert pose is not None
        assert tuple(pose.point) == pytest.approx(point, abs=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_torques_do_the_work_that_the_force_does(model: str, library: ctypes.CDLL) -> None:
    """Virtual work: a motor's torque is the force's work for each rad, by differences of the forward kinematics."""
    step = 1e-6
    for point in poses(model):
        angles, force = inverse(model, point), (0.7, -1.1)
        pose = forward(library, model, angles)
        assert pose is not None
        found, scaled = torques(library, pose, force, math.inf)
        assert not scaled
        for arm in (0, 1):
            moved = [
                np.array(forward(library, model, (angles[0] + h * (arm == 0), angles[1] + h * (arm == 1))).point)  # type: ignore[union-attr]
                for h in (step, -step)
            ]
            work = float(np.dot(moved[0] - moved[1], force)) / (2 * step)
            assert found[arm] == pytest.approx(work, rel=1e-6, abs=1e-9)


def test_a_force_outside_the_motors_polygon_is_scaled_and_not_turned(library: ctypes.CDLL) -> None:
    for point in poses("v3"):
        pose = forward(library, "v3", inverse("v3", point))
        for direction in np.linspace(0.0, 2.0 * math.pi, 12):
            force = (20.0 * math.cos(direction), 20.0 * math.sin(direction))
            wanted, _ = torques(library, pose, force, math.inf)  # type: ignore[arg-type]
            found, scaled = torques(library, pose, force, LIMIT)  # type: ignore[arg-type]
            assert scaled
            assert np.abs(found).max() == pytest.approx(LIMIT, rel=1e-12)
            np.testing.assert_allclose(found / wanted, LIMIT / np.abs(wanted).max(), rtol=1e-9)


@pytest.mark.parametrize(("model", "angles"), [("v2", (1.0, 1.0)), ("wide", (math.pi, 0.0)), ("v3", (1.0, math.nan))])
def test_angles_at_which_no_force_can_be_divided_have_no_pose(
    model: str, angles: tuple[float, float], library: ctypes.CDLL
) -> None:
    """Elbows in one place, elbows that the distal links do not join, and a number that is none."""
    assert forward(library, model, angles) is None


def test_what_the_host_reads_is_where_the_end_point_is(start_bridged: Callable[..., Bridged]) -> None:
    kit = ("proximal=0.05", "distal=0.07", "base=0.02", "swapped=0")
    for model, options in {"v3": (), "v2": ("base=0",), "devkit": kit}.items():
        bridged = start_bridged("x=0.03", "y=0.08", *options, model=model)
        host = Pushing(bridged.port, (0, 0))
        assert host.run(3)
        assert host.session.samples[-1].counts == pytest.approx((300_000, 800_000), abs=2)
        host.close()


def test_a_positive_force_accelerates_towards_larger_positions(start_bridged: Callable[..., Bridged]) -> None:
    for channel in (0, 1):
        host = Pushing(start_bridged("friction=0").port, (20_000_000 * (channel == 0), 20_000_000 * (channel == 1)))
        assert host.run(20)
        at = np.array([sample.counts for sample in host.session.samples]) * 1e-7
        moved = at[-1] - at[0]
        # 0.2 N on 0.1 kg; the mock moves by 1 ms with each frame of torques, and the first one ends a sample at rest.
        pushed_s = 1e-3 * (len(at) - 2)
        assert moved[channel] == pytest.approx(0.5 * 2.0 * pushed_s**2, rel=2e-3)
        assert abs(moved[1 - channel]) < 2e-3 * abs(moved[channel])
        host.close()


@pytest.mark.thorough
def test_probe_passes_through_the_bridge(start_bridged: Callable[..., Bridged]) -> None:
    """Probe passes in real time; the port, on which a host may block, is that of the Linux board, and a bridge follows
    neither lines nor words. Steps that a busy machine disturbed are repeated."""
    not_seen = {"bridge", "velocities", "accelerations", "acceleration"}
    not_seen |= {"line_stiffness", "line_damping", "line_bounds", "line_missed"}
    not_seen |= {"servo_registers", "servo_brakes"}
    not_seen |= {"limit_cut"}  # the motors give less than the limit of a channel
    steps = ("conversation", "registers", "refusals", "arming", "forces", "watchdog", "host", "push")
    port, again, bad, checks = start_bridged("period=0").port, steps, [], {}
    for _ in attempts():
        with open_wire(port) as wire:
            judgement = judge(wire, leave=Leave(force=1.0, travel=0.02, mass=0.1), steps=steps_of(again, None))
        checks |= {check.name: check for check in judgement.checks if check.step in again}
        bad = [check for check in checks.values() if check.result != "pass" and check.name not in not_seen]
        again = tuple(step for step in steps if any(check.step == step for check in bad))
        if not again:
            break
        if not judgement.released:
            port = start_bridged("period=0").port
    assert not bad, [(check.name, check.found) for check in bad]
    assert "when the bridge ends" in checks["bridge"].found


@pytest.mark.parametrize("channel", [0, 1])
def test_a_measurement_agrees_with_the_prediction(
    channel: int, start_bridged: Callable[..., Bridged], start_hapsim: Callable[..., Any], tmp_path: Path
) -> None:
    """A mass at the end point: the prediction's own device. The mock moves by 1 ms with each frame."""
    links = {
        name: {"type": "viscoelastic", "between": [name[1], f"o{name[1]}"], "stiffness": 200, "damping": 0.5}
        for name in ("kx", "ky")
    }
    modules = {
        **{axis: {"type": "device", "channel": c} for c, axis in enumerate("xy")},
        **{f"o{axis}": {"type": "ground", "position": 0.0} for axis in "xy"},
        **links,
    }
    device = {"clock": "host", "mass": 0.1, "friction": 0.5, "force_limit": 1.5, "origin": "here"}
    scene = tmp_path / "haply.yaml"
    scene.write_text(yaml.safe_dump({"version": 1, "rate": 1000, "device": device, "modules": modules}), "utf-8")
    k = b = False
    predicted, measured = dict[str, float](), dict[str, float]()
    for _ in attempts():  # again where this machine held the bridge up
        bridged = start_bridged()
        host = start_hapsim("measure", scene, "--port", bridged.port, "--channel", channel, "--duration", 1.0, "--json")
        if host.wait() != 0:
            assert "quiet for longer than the watchdog allows" in host.err
            continue
        document = json.loads(host.out)
        predicted, measured = document["predicted"], document["measured"]
        k = measured["k"] == pytest.approx(predicted["k"], rel=1e-4, abs=5 * measured["k_uncertainty"])
        b = measured["b"] == pytest.approx(predicted["b"], rel=1e-3, abs=5 * measured["b_uncertainty"])
        if (k and b) or document["deadline_misses"] == document["lost_frames"] == 0:
            break
    assert k, (measured, predicted)
    assert b, (measured, predicted)


def test_the_first_scene_asks_for_no_more_than_the_motors_give_at_its_pose(library: ctypes.CDLL) -> None:
    device = load_scene(Path(__file__).parents[2] / "configs" / "boards" / "haply.yaml").device
    pose = forward(library, "v3", inverse("v3", device.mass_at))  # type: ignore[arg-type]
    for direction in np.linspace(0.0, 2.0 * math.pi, 72):
        force = (device.force_limit * math.cos(direction), device.force_limit * math.sin(direction))
        assert not torques(library, pose, force, LIMIT)[1]  # type: ignore[arg-type]
