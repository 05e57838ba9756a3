"""Behind a port, a motor that nothing has shown to be right and that the sign guard cannot judge has a tenth of the
force limit: on a device in plain Python, in virtual time."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from serial.tools import list_ports

from firmware_protocol.description import Description
from hapsim.cli.probe import note_motor
from hapsim.device.connection import Connection
from hapsim.device.known_motors import known_motors, note_motors
from hapsim.errors import GuardError, UsageError
from hapsim.measuring.device_motion import Drive, scene_of
from hapsim.measuring.identify_device import Pusher, bounds_of, identify_device
from hapsim.measuring.measure import measure
from hapsim.replaying.replay import Record, Replay
from hapsim.running import run
from hapsim.running.motors import Motors, motors_of
from hapsim.running.run import run_to_end
from hapsim.scene import Scene

sys.path.append(str(Path(__file__).parents[1] / "probe"))

from virtual_line import PORT, virtual_port

COARSE = 4e-4  # m per count
PULLED = {"hand": 4.0}  # N, from arming on


@pytest.fixture(autouse=True)
def _state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("hapsim.device.known_motors._in_this_process", set())


@pytest.fixture
def numbered(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Gives a port a serial number."""

    def number(serial_number: str, port: str = PORT) -> None:
        found = [SimpleNamespace(device=port, serial_number=serial_number)]
        monkeypatch.setattr(list_ports, "comports", lambda: found)

    return number


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Makes a device, and puts it at PORT."""
    return partial(virtual_port, monkeypatch)


def document(rate: float = 1000.0, kind: str = "viscoelastic", **device: Any) -> dict[str, Any]:
    stiffness = 1.0 if "motion" in device else 2e-3 * rate**2
    link = {"type": kind, "between": ["hand", "wall"], "stiffness": stiffness, "damping": 2.5e-3 * stiffness}
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "touch": link}
    declared = {"port": PORT, "mass": 0.2, "friction": 1.0, "origin": "here", "force_limit": 10.0, **device}
    return {"version": 1, "rate": rate, "device": declared, "modules": modules}


def touching(**values: Any) -> Scene:
    return Scene.model_validate(document(**values))


def pushed(ticks: int = 150, rate: float = 1000.0, **device: Any) -> tuple[float, str, list[str]]:
    """Returns the largest force, N, the report's sentence and the warnings of a run."""
    said: list[str] = []
    scene = touching(rate=rate, **device)
    trace = run(scene, duration=ticks / rate, portable=True, on_warning=said.append)
    return float(np.abs(trace.force).max()), trace.report.unknown_motor, said


def test_an_unknown_motor_that_cannot_be_judged_has_a_tenth_and_a_sentence_names_what_lifts_it(
    device: Callable[..., Any],
) -> None:
    seen = device(rate=1000.0, scale=COARSE, bodies=[PULLED])
    most, reported, said = pushed()
    assert most == pytest.approx(1.0, abs=1e-6)
    assert seen.largest == pytest.approx(1.0, abs=1e-6)
    assert said == [reported]
    assert f"{PORT}: no test has shown that the motor of channel 0 pushes the right way" in reported
    assert "counts of 0.4 mm" in reported
    assert "So the force limit is a tenth, 1 N. Only a device.travel in the scene lifts that" in reported
    assert pushed(travel=(-0.05, 0.05))[1:] == ("", [])
    note_motors(PORT, [0], are_right=True)  # in this process
    most, reported, said = pushed()
    assert most > 2.0
    assert (reported, said) == ("", [])


def test_a_motor_that_can_be_judged_has_the_whole_limit(device: Callable[..., Any]) -> None:
    device(rate=1000.0, bodies=[PULLED])
    assert pushed()[0] > 2.0


def test_a_run_prints_one_line_before_the_device_is_armed(
    device: Callable[..., Any], hapsim: Callable[..., Any], tmp_path: Path
) -> None:
    file, text = tmp_path / "scene.yaml", yaml.safe_dump(document(rate=250.0))
    file.write_text(text, "utf-8")
    device(rate=250.0)
    answer = hapsim("run", file, "--portable", "--duration", 0.1, "--json")
    assert answer.status == 0, (answer.err, answer.document)
    assert answer.document["unknown_motor"] in answer.err.splitlines()
    assert "the sign guard cannot judge it: it samples at less than 500 Hz" in answer.document["unknown_motor"]
    file.write_text(text.replace("250.0", "1000.0"), "utf-8")
    device(rate=1000.0)
    answer = hapsim("run", file, "--portable", "--duration", 0.1, "--json")
    untested = f"{PORT}: no test has shown that the motor of channel 0 pushes the right way: `hapsim probe {PORT}"
    assert untested in answer.err
    assert answer.document["unknown_motor"] == ""
    note_motors(PORT, [0], are_right=True)
    assert "no test" not in hapsim("run", file, "--portable", "--duration", 0.1).err


def test_a_number_is_an_identity_and_a_name_is_none(device: Callable[..., Any], numbered: Callable[..., None]) -> None:
    device(rate=250.0, bodies=[PULLED])
    numbered("A 7/1")
    _, reported, _ = pushed(rate=250.0)
    assert "it samples at less than 500 Hz" in reported
    assert f"`hapsim probe {PORT} --push 1` or `hapsim identify` lifts that, a device.travel" in reported
    note_motors(PORT, [0], are_right=True)
    assert pushed(rate=250.0)[1] == ""
    numbered("another")
    assert pushed(rate=250.0)[1] != ""
    numbered("A 7/1", "/dev/ttyElsewhere")
    assert known_motors("/dev/ttyElsewhere", range(3)) == {0}
    note_motors("/dev/ttyElsewhere", [0, 1], are_right=False)
    assert known_motors("/dev/ttyElsewhere", range(3)) == set()


def test_a_port_without_a_number_is_known_in_this_process_until_it_is_unplugged(tmp_path: Path) -> None:
    port = tmp_path / "tty"
    port.touch()
    note_motors(str(port), [0, 2], are_right=True)
    assert known_motors(str(port), range(4)) == {0, 2}
    assert not list(tmp_path.glob("hapsim/**/*"))
    (tmp_path / "other").touch()
    port.unlink()
    (tmp_path / "other").rename(port)
    assert known_motors(str(port), range(4)) == set()
    note_motors("COM3", [1], are_right=True)  # is no file
    assert known_motors("COM3", [1]) == {1}
    note_motors("COM3", [1], are_right=False)
    assert known_motors("COM3", [1]) == set()


def test_where_nothing_can_be_kept_a_motor_is_known_in_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, numbered: Callable[..., None]
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    numbered("8")
    note_motors(PORT, [0], are_right=True)
    assert known_motors(PORT, [0, 1]) == {0}
    note_motors(PORT, [0], are_right=False)
    assert known_motors(PORT, [0, 1]) == set()


def motors(scene: Scene, *, channels: int = 1, known: tuple[int, ...] = (), behind_port: bool = True) -> Motors:
    port = Connection(None, PORT, lambda: None, behind_port=behind_port)  # type: ignore[arg-type]
    each = (1e-6,) * channels, (1e-4,) * channels, (20.0, 5.0, 20.0, 20.0)[:channels]
    note_motors(PORT, range(4), are_right=False)
    note_motors(PORT, known, are_right=True)
    return motors_of(scene, port, Description("it", scene.rate, 7, 2047, *each))


def two_hands(space: int = 1, **device: Any) -> Scene:
    hands: dict[str, Any] = {f"h{c}": {"type": "device", "channel": c} for c in range(2)}
    if space == 2:
        hands = {"h0": {"type": "device", "channels": [0, 1]}}
    ends = {f"t{h}": {"type": "damper", "between": [h, "g"], "damping": 1} for h in hands}
    modules = hands | ends | {"g": {"type": "ground", "position": [0, 0] if space == 2 else 0.0}}
    whole = {"version": 1, "rate": 400, "space": space, "device": {"port": PORT, "mass": 0.2} | device}
    return Scene.model_validate(whole | {"modules": modules})


def test_the_limit_is_lowered_for_the_hands_of_unknown_motors_alone() -> None:
    least = two_hands().device.force_limit
    assert motors(two_hands(), channels=3).description.force_limit == (0.1 * least, 0.5, 20.0)  # the device's own: 5 N
    assert motors(two_hands(), channels=2, known=(0,)).lowered == (1,)
    assert motors(two_hands(), channels=2, known=(0, 1)) == motors(two_hands(), channels=2, known=(0, 1, 3))
    assert motors(two_hands(), channels=2, known=(0, 1))[2:] == ("", ())
    found = motors(two_hands(travel=(-1, 1)), channels=2, known=(0,))
    assert (found.lowered, found.warning) == ((), "")
    assert f"`hapsim probe {PORT} --push 0.5 --channel 1`" in found.advice
    assert motors(two_hands(), channels=2, behind_port=False)[2:] == ("", ())
    assert motors(two_hands(clock="lockstep"), channels=2)[2:] == ("", ())


def test_a_pair_is_known_if_both_of_its_motors_are(numbered: Callable[..., None]) -> None:
    numbered("9")
    found = motors(two_hands(2), channels=2, known=(0,))
    assert found.lowered == (0, 1)
    assert "motors of channels 0 and 1 push the right way, and the sign guard cannot judge them" in found.advice
    assert "--pair 0,1" in found.advice
    assert motors(two_hands(2), channels=2, known=(0, 1))[2:] == ("", ())


def test_a_wheel_has_its_tenth_in_newton_metres() -> None:
    scene = touching(rate=400.0, motion="rotary", mass=1e-4, force_limit=0.05)
    assert "a tenth, 0.005 N·m. " in motors(scene).warning
    assert motors(scene).description.force_limit == pytest.approx((0.005,))


def test_the_guard_stores_what_it_finds(device: Callable[..., Any], numbered: Callable[..., None]) -> None:
    numbered("it")
    device(rate=1000.0, bodies=[{"v": 0.1}])
    pushed()
    assert known_motors(PORT, range(2)) == {0}
    device(rate=1000.0, bodies=[{"v": 0.1}], faults=["inverted_sign"])
    with pytest.raises(GuardError, match="channel 0 disagree in sign"):
        pushed()
    assert known_motors(PORT, range(2)) == set()


def test_the_travel_guard_forgets_the_motor_that_left_it(
    device: Callable[..., Any], numbered: Callable[..., None]
) -> None:
    numbered("it")
    device(rate=400.0, bodies=[{"v": 0.1}], faults=["inverted_sign"])
    note_motors(PORT, [0, 1], are_right=True)
    with pytest.raises(GuardError, match="out of its travel"):
        pushed(rate=400.0, travel=(-0.03, 0.03), travel_margin=0.01)
    assert known_motors(PORT, range(2)) == {1}


def test_a_measurement_pushes_within_the_lowered_limit_or_is_refused(device: Callable[..., Any]) -> None:
    seen = device(rate=400.0, bodies=[{}])
    run_it, said = partial(run_to_end, portable=True), list[str]()
    with pytest.raises(UsageError, match=r"push: found 2 N, expected at most 1 N\. .*no test has shown"):
        measure(touching(rate=400.0), push=2.0, run=run_it)
    found = measure(touching(rate=400.0), duration=1.0, run=run_it, on_warning=said.append)
    assert found.push_n == pytest.approx(0.25)
    assert found.trace.report.unknown_motor == said[0]
    assert len(said) == 1
    with pytest.raises(UsageError, match=r"1.6 N, more than the force limit of 1 N"):
        measure(touching(rate=400.0, kind="buffer"), at=-0.005, run=run_it)
    assert seen.largest <= 1.0 + 1e-6


def test_identify_keeps_its_own_pushes_and_makes_the_motor_known(
    numbered: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    bounds = bounds_of(touching(), 0, 2.0, 0.005)
    drive = Drive(stiffness=30.0, damping=2.0, force=1.5, half=32)
    assert motors(scene_of(touching(rate=400.0), bounds, 0, drive, 0.0)).lowered == ()
    numbered("it")
    monkeypatch.setattr(Pusher, "find_home", lambda _: None)
    monkeypatch.setattr(Pusher, "grow", lambda _: SimpleNamespace(shape=()))
    monkeypatch.setattr(Pusher, "record", lambda *_: None)
    monkeypatch.setattr(Pusher, "identified", lambda *_: None)
    identify_device(touching())
    assert known_motors(PORT, range(2)) == {0}
    identify_device(touching(), transport="mock")

    def grow(_: object) -> None:
        raise GuardError("motor and position disagree in sign")

    monkeypatch.setattr(Pusher, "grow", grow)
    with pytest.raises(GuardError):
        identify_device(touching(), transport="mock")
    assert known_motors(PORT, range(2)) == {0}
    with pytest.raises(GuardError):
        identify_device(touching())
    assert known_motors(PORT, range(2)) == set()


def test_a_probe_stores_its_result(numbered: Callable[..., None]) -> None:
    numbered("it")
    for results, known in (
        ({"sign": "pass", "mass": "not seen"}, {1}),
        ({"sign": "not seen"}, {1}),
        ({"sign": "pass", "mass": "FAIL"}, set()),
        ({"sign": "pass"}, {1}),
        ({"sign": "FAIL"}, set[int]()),
    ):
        checks = [SimpleNamespace(name=name, result=result, step="push") for name, result in results.items()]
        failed = [check for check in checks if check.result == "FAIL"]
        note_motor(PORT, [1], SimpleNamespace(checks=checks, failed=failed))  # type: ignore[arg-type]
        assert known_motors(PORT, range(3)) == known, results


def test_a_record_with_a_lowered_limit_is_replayed_bit_by_bit(device: Callable[..., Any], tmp_path: Path) -> None:
    device(rate=250.0, bodies=[PULLED])
    trace = run(touching(rate=250.0), duration=0.3, portable=True, record=tmp_path / "run.trace")
    assert np.abs(trace.force).max() == pytest.approx(1.0, abs=1e-6)
    for before, now in Replay(Record(tmp_path / "run.trace")).pieces():
        np.testing.assert_array_equal(before["force_counts"], now["force_counts"])
