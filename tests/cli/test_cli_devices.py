"""Commands on scenes of several devices."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.cli.run_devices import DevicesRun
from hapsim.live.hub import Hub
from hapsim.loop.counts import Progress
from hapsim.running.joint_session import JointSession
from hapsim.running.motors import Motors
from hapsim.running.reconnecting import RunObserver
from hapsim.scene import load_scene
from tests.port_scenes import TWO, two_devices

Hapsim = Callable[..., Any]


@pytest.fixture
def two(tmp_path: Path) -> Path:
    """A scene of two devices, in virtual time."""
    path = tmp_path / "two.yaml"
    path.write_text(TWO + "mocks:\n  left: {hand: {force: 1}}\n", encoding="utf-8")
    return path


def test_a_run_has_a_live_line_a_record_and_a_report_for_each(hapsim: Hapsim, two: Path, tmp_path: Path) -> None:
    record = tmp_path / "x.trace"
    answer = hapsim("run", two, "--duration", 0.2, "--record", record)
    assert answer.status == 0
    assert "left running" in answer.err
    assert "right running" in answer.err
    assert answer.out.count("The run") == 2
    for name in ("left", "right"):
        assert f"x.{name}.trace" in answer.out.replace("\n", "")
        replayed = hapsim("replay", tmp_path / f"x.{name}.trace")
        assert "all forces are identical" in replayed.out.replace("\n", " ")
        other = hapsim("replay", tmp_path / f"x.{name}.trace", "--scene", two)
        assert "differ" not in other.out
    assert "exists; --overwrite replaces it" in hapsim("run", two, "--duration", 0.2, "--record", record).err


def test_its_document_has_a_report_for_each(hapsim: Hapsim, two: Path) -> None:
    document = hapsim("run", two, "--duration", 0.1, "--json").document
    assert {*document} >= {"devices", "records", "warnings"}
    assert [one["ending"] for one in document["devices"].values()] == ["done", "done"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--watch"], "--watch: found several devices, left and right, expected one"),
        (["--reconnect"], "--reconnect: found several devices"),
        (["--portable"], "--portable: found several devices"),
        (["--port", "/dev/null"], "--port: found '/dev/null', expected the port of a device, such as left=/dev/"),
        (["--port", "left=/dev/null,rihgt=/dev/zero"], "--port: found 'rihgt=/dev/zero', expected the port of a"),
        (["--port", "left=/dev/null,right=/dev/../dev/null"], "the port of left too"),
        (["--device", "middle"], "found the device 'middle', expected one of this scene (left, right)"),
        (["--device", "left", "--watch"], "--watch: found --device left too"),
    ],
)
def test_an_option_that_does_not_fit_is_refused(hapsim: Hapsim, two: Path, options: list[str], message: str) -> None:
    refusal = hapsim("run", two, "--duration", 0.1, *options).refusal
    assert message in refusal.replace("\n", " ")


def test_a_device_alone_is_run_predicted_measured_and_identified(hapsim: Hapsim, two: Path) -> None:
    alone = "--device", "right"
    assert hapsim("run", two, "--duration", 0.1, "--json", *alone).document["ending"] == "done"
    predicted = hapsim("check", two, "--json", *alone).document["predicted"]
    assert predicted["k"] == pytest.approx(2080.43946, abs=1e-4)  # the spring to a hand that holds still
    measured = hapsim("measure", two, "--json", *alone).document["measured"]
    assert measured["k"] == pytest.approx(2080.43946, rel=1e-6)


def test_identify_writes_into_the_section_of_the_device(hapsim: Hapsim, two: Path) -> None:
    two.write_text(
        two.read_text("utf-8").replace("right: {clock: lockstep, mass: 0.2", "right: {clock: lockstep, mass: 0.21")
    )
    two.write_text(two.read_text("utf-8") + "  right: {mass: 0.2}\n")
    assert hapsim("identify", two, "--device", "right", "--write").status == 0
    scene = load_scene(two)
    assert scene.devices["right"].masses(1)[0] == pytest.approx(0.2, rel=1e-5)
    assert scene.devices["left"].mass == 0.2


def test_an_unstable_scene_is_refused_and_with_unstable_warned_of(hapsim: Hapsim, two: Path) -> None:
    two.write_text(two.read_text("utf-8").replace("2000", "3450"), encoding="utf-8")
    refused, run = (hapsim("run", two, "--duration", 0.1, *more) for more in ([], ["--unstable"]))
    assert refused.status == 2
    assert "two.yaml: not armed: the scene is predicted unstable" in refused.err.replace("\n", " ")
    assert "Warning" not in refused.err
    assert run.status == 0
    assert run.err.replace("\n", " ").count("the scene is predicted unstable") == 1


def test_a_warning_before_arming_and_unsaved_values_are_printed(
    hapsim: Hapsim, two: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def of_an_unknown_motor(scene: Any, _connection: Any, description: Any) -> Motors:
        return Motors((), description, f"the motor of {scene.device_name} is not known", (0,))

    def change(session: Any, _timeout: float) -> bool:
        session.set({"spring.stiffness": 1500.0})
        session.stop()
        return wait(session, None)

    wait = JointSession.wait
    two.write_text(TWO, encoding="utf-8")
    monkeypatch.setattr("hapsim.running.session.motors_of", of_an_unknown_motor)
    monkeypatch.setattr(JointSession, "wait", change)
    answer = hapsim("run", two)
    for name in ("left", "right"):
        assert f"the motor of {name} is not known" in answer.err
    assert "not saved: spring.stiffness." in answer.err.replace("\n", " ")


@pytest.mark.parametrize("command", [("couple",), ("identify",), ("chart", "force"), ("doctor",)])
def test_a_command_of_one_device_asks_which(hapsim: Hapsim, two: Path, command: tuple[str, ...]) -> None:
    answer: Any = hapsim(*command, two)
    assert answer.status == 2
    assert "name one, such as --device left" in answer.err.replace("\n", " ")


def test_a_page_shows_one_device_and_changes_a_link_at_both() -> None:
    scene = two_devices()
    hub, stops, shown = Hub(scene.at_port("right")), list[Callable[[], None]](), list[Any]()

    def change(_: Progress) -> None:
        if hub.session is not None and not shown:
            hub.set({"spring.stiffness": 1500.0}).result(20.0)
            shown.append((hub.session.label, [*hub.session.parameters]))
            stops[0]()

    observers = {"left": RunObserver(), "right": RunObserver(begun=stops.append, running=change)}
    session = DevicesRun(scene, observers, hub, "right").run({})
    ((label, parameters),) = shown
    assert label == "right (mock in memory)"
    assert {"spring.stiffness", "mock.hand.force"} <= {*parameters}
    links = [one.scene.links["spring"] for one in session.ports.values()]
    assert [link.stiffness for link in links] == [1500.0, 1500.0]  # type: ignore[attr-defined]
    assert hub.phase == "ended"
    assert {event.device for event in hub.events} <= {"", "right"}
