"""A steady push of the hand meets the stiffness that the scene says, measured on the mock: with every kind of link,
while a scene changes, and of the mass that is declared or of another."""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from hapsim import predict, run, start
from hapsim.cli.check import check_lines
from hapsim.cli.output import show
from hapsim.errors import DeviceError
from hapsim.prediction import robustness_of
from hapsim.prediction.correction import rendered
from hapsim.running import Session
from hapsim.scene import Buffer, Hand, Initial, Mass, Mock, Scene, Spring, ViscoElastic
from tests import one_hand

PUSH = 2.0  # N
SPAN = {"from": 0.1, "to": 0.4}


def pushed(links: dict[str, Any], *, mock: dict[str, Any] | None = None, **device: Any) -> Scene:
    """A hand that pushes steadily, on links to a wall."""
    given = {"hand": {"force": PUSH}, "quantum": 1e-11} | (mock or {})
    return one_hand.scene_of(links, device={"correction": "predictor"} | device, mock=given)


def touch(stiffness: float, damping: float, **more: Any) -> dict[str, Any]:
    return {"touch": one_hand.touch(stiffness, damping, **more)}


def met(scene: Scene, seconds: float = 2.0) -> float:
    """N/m: the push over where it has brought the hand."""
    return PUSH / float(run(scene, duration=seconds).position[-1, 0])


CHAIN = {
    "m": Mass(mass=0.05),
    "near": ViscoElastic(between=("hand", "m"), stiffness=2000.0, damping=10.0),
    "far": ViscoElastic(between=("m", "wall"), stiffness=3000.0, damping=5.0),
}


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize(
    ("scene", "stiffness"),
    [
        (pushed(touch(2000.0, 5.0)), 2000.0),
        (pushed(touch(20000.0, 40.0)), 20000.0),
        (pushed(touch(100000.0, 60.0)), 100000.0),
        (pushed(touch(20000.0, 40.0, damper="sensed")), 20000.0),
        (pushed(touch(20000.0, 40.0), delay=2.5, sampling="average", stiffness=700.0), 20700.0),
        (pushed(touch(20000.0, 40.0), hold="impulse"), 20000.0),
        (pushed(touch(20000.0, 40.0), mock={"mass": 0.3}), 20000.0),
        (pushed(touch(20000.0, 40.0), mass=SPAN, correction="adaptive", mock={"mass": 0.3}), 20000.0),
        (pushed(touch(8000.0, 40.0) | {"more": Spring(between=("wall", "hand"), stiffness=2000.0)}), 10000.0),
        (pushed({"stop": Buffer(between=("hand", "wall"), stiffness=20000.0, damping=40.0)}), 20000.0),
        (pushed(CHAIN), 1200.0),
    ],
    ids=lambda value: "" if isinstance(value, Scene) else f"{value:g}",
)
def test_a_steady_push_meets_the_stiffness_of_the_scene(scene: Scene, stiffness: float) -> None:
    if isinstance(scene.modules.get("stop"), Buffer):  # it pushes where the hand has gone below the wall
        scene = scene.model_copy(update={"mock": Mock(hand=Hand(force=-PUSH), quantum=1e-11)})
        assert -met(scene) == pytest.approx(stiffness, rel=1e-5)
    else:
        assert met(scene) == pytest.approx(stiffness, rel=1e-5)


def test_before_a_hard_stop_a_soft_spring_asks_for_no_more_than_the_stop() -> None:
    """The share of the push that is right for the spring alone would be many times that of the stop."""
    stop = Buffer(between=("hand", "wall"), stiffness=30000.0, damping=40.0)
    scene = pushed(touch(800.0, 20.0) | {"stop": stop})
    assert -met(scene.model_copy(update={"mock": Mock(hand=Hand(force=-PUSH), quantum=1e-11)})) == pytest.approx(
        30800.0, rel=1e-5
    )
    (port,) = rendered(scene).ports
    K, compliance = port.rendered[0], port.element.observer.compliance
    assert met(scene) == pytest.approx(K / (1.0 - K * compliance), rel=1e-5)  # 4 % less than the spring's own


@pytest.mark.parametrize(("device", "most"), [({}, 20000.0), ({"mass": SPAN, "correction": "adaptive"}, 20000.0)])
def test_a_scene_that_changes_keeps_its_static_stiffness(device: dict[str, Any], most: float) -> None:
    """The estimate of the push is the same; what is made of it follows the parameters along their ramp."""

    def change(session: Session) -> None:
        session.set({"touch": {"stiffness": most, "damping": 40.0}}, over=0.1)

    with start(pushed(touch(500.0, 20.0), **device), duration=2.0, on_arming=change) as session:
        session.wait()
    x = session.trace.position[:, 0]
    assert PUSH / x[-1] == pytest.approx(most, rel=1e-5)
    assert np.abs(np.diff(session.trace.asked_force[150:, 0])).max() < 0.05 * PUSH


@pytest.mark.parametrize("damper", ["backward", "sensed"])
@pytest.mark.parametrize("correction", ["none", "predictor"])
def test_the_noise_of_the_sensor_becomes_as_much_force_as_predicted(correction: str, damper: str) -> None:
    noise = 1e-6
    scene = pushed(touch(3000.0, 20.0, damper=damper), correction=correction, mock={"noise": noise, "seed": 3})
    (felt,) = predict(scene, with_margins=False).felt
    force = run(scene, duration=20.0).asked_force[1000:, 0]
    assert float(np.std(force)) / noise == pytest.approx(robustness_of(felt).noise_gain, rel=0.04)


@pytest.mark.parametrize("correction", ["none", "predictor"])
@pytest.mark.parametrize(("stiffness", "damping"), [(20000.0, 40.0), (60000.0, 60.0)])
def test_the_masses_that_are_stable_are_those_that_it_states(correction: str, stiffness: float, damping: float) -> None:
    (felt,) = predict(pushed(touch(stiffness, damping), correction=correction), with_margins=False).felt
    least, most = robustness_of(felt).stable_masses
    for mass, stable in ((least * 1.03, True), (least * 0.97, False), (most * 0.97, True), (most * 1.03, False)):
        if not math.isfinite(mass) or mass == 0.0:
            continue
        mock = {"mass": mass, "hand": Hand(), "initial": Initial(velocity=1e-3)}
        scene = pushed(touch(stiffness, damping), correction=correction, force_limit=1e5, mock=mock)
        try:
            x = np.abs(run(scene, duration=1.0).position[:, 0])
            grows = x[-300:].max() > x[:300].max()
        except DeviceError:  # it has left the range of the mock's counts
            grows = True
        assert grows != stable, mass


def test_check_prints_static_stiffness_noise_and_masses_in_eighty_columns() -> None:
    scene = pushed(touch(20000.0, 40.0))
    prediction = predict(scene)
    out = Console(file=io.StringIO(), width=80)
    show(out, check_lines(scene, prediction, None, explain=True))
    told = out.file.getvalue()  # type: ignore[attr-defined]
    rows = {row.split("│")[1].strip(): row.split("│")[-2].strip() for row in told.splitlines() if row.count("│") > 3}
    assert rows["static stiffness  N/m"] == "20000"
    assert rows["noise gain  N/m"] == "127158"
    assert rows["stable masses  kg"] == "0.0909 to 4.16"
    assert max(map(len, told.splitlines())) <= 80
