"""Runs of an examination; none of them pushes the hand of a device."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from hapsim.cli.doctor import examination_document, show_examination
from hapsim.doctor import examine as examination_module
from hapsim.doctor.examine import Examination, Step, examine
from hapsim.documents import plain
from hapsim.errors import DeviceError, UsageError
from hapsim.loop.counts import Progress
from hapsim.loop.histogram import Histogram
from hapsim.loop.realtime import PrivilegeResult
from hapsim.scene import Scene, load_scene, parse_scene
from hapsim.system_files import SystemFiles

GRANT = PrivilegeResult("SCHED_FIFO", True, "priority 80")
TEXT = """
version: 1
rate: {rate}
device: {{mass: 0.2, force_limit: 7, clock: {clock}{port}}}
modules:
  hand:  {{type: device, channel: 0}}
  wall:  {{type: ground}}
  ball:  {{type: mass, mass: 0.1}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5}}
  hold:  {{type: viscoelastic, between: [hand, ball], stiffness: 100}}
"""


def text(rate: float = 3000.0, clock: str = "host", port: str = "") -> str:
    return TEXT.format(rate=rate, clock=clock, port=f", port: {port}" if port else "")


def scene(rate: float = 3000.0, clock: str = "host", port: str = "") -> Scene:
    return parse_scene(text(rate, clock, port))


@pytest.fixture
def examined(
    monkeypatch: pytest.MonkeyPatch,
    tree: Callable[..., SystemFiles],
    fake_run: Callable[..., Any],
    histogram: Callable[[dict[float, int]], Histogram],
) -> Callable[..., tuple[Examination, Any]]:
    """An examination whose wake-ups and runs are made up, and what ran."""

    def wake_up_latency(rate: float, seconds: float, tell: Any, **options: Any) -> Histogram:
        tell(0.0, "sleep_on_grid")
        tell(seconds, "")
        options["on_grants"]([GRANT] if options["realtime"] else [])
        return histogram({1e-6 * rate: 10})

    monkeypatch.setattr(examination_module, "wake_up_latency", wake_up_latency)

    def call(given: Scene | None, error: Exception | None = None, **options: Any) -> tuple[Examination, Any]:
        run = fake_run()
        run.error = error
        options.setdefault("ask", lambda _trial: None)
        return examine(given, tree=tree(), run=run, **options), run

    return call


def test_without_a_device_every_rate_is_run_on_the_mock_under_either_clock(examined: Callable[..., Any]) -> None:
    examination, run = examined(scene(), rates=(1000.0, 2000.0))
    rates = [1000.0, 2000.0, 3000.0]
    assert [(s.device.clock, s.rate) for s in run.scenes] == [(c, r) for c in ("device", "host") for r in rates]
    assert {options["transport"] for options in run.options} == {"terminal"}
    assert {options["keep"] for options in run.options} == {False}
    assert list(examination.wakeups) == rates
    assert [verdict.answer for verdict in examination.verdicts] == ["yes", "yes", "no"] * 2
    assert examination.best_rates == {"device": 2000.0, "host": 2000.0}
    assert examination.device_failed is None


def test_without_a_scene_the_shipped_one_runs(examined: Callable[..., Any]) -> None:
    examination, run = examined(None, rates=(1000.0, 4000.0))
    assert examination.scene == "first_touch.yaml"
    assert examination.rate_hz == 1000.0
    assert all("touch" in s.modules for s in run.scenes)
    assert "hapsim doctor --realtime" in commands(examination)
    # The made-up wake-ups are 4 ms late, and the made-up system is no real-time one.
    assert any("4 ms late" in advice.found for advice in examination.advice)


def test_a_device_runs_once_at_its_own_rate_and_without_a_force(examined: Callable[..., Any]) -> None:
    examination, run = examined(scene(port="/dev/ttyACM0"), rates=(1000.0,))
    (ran,) = run.scenes
    assert (ran.rate, ran.device.clock, ran.device.port) == (3000.0, "host", "/dev/ttyACM0")
    assert list(ran.modules) == ["hand", "wall", "ball"]
    assert ran.links == {}
    assert ran.device.force_limit < 1e-9
    assert run.options[0]["transport"] == "auto"
    assert list(examination.wakeups) == [1000.0, 3000.0]
    assert examination.best_rates == {}


def test_the_mock_may_be_asked_for_in_the_place_of_a_device(examined: Callable[..., Any]) -> None:
    _, run = examined(scene(port="/dev/ttyACM0"), rates=(1000.0,), transport="mock")
    assert len(run.scenes) == 4
    assert {options["transport"] for options in run.options} == {"terminal"}
    assert all("touch" in s.modules for s in run.scenes)


def test_a_device_that_fails_is_part_of_the_answer(examined: Callable[..., Any]) -> None:
    examination, _ = examined(scene(port="/dev/ttyACM0"), DeviceError("no such port"))
    assert examination.device_failed is not None
    assert examination.device_failed.exit_status == 3
    assert examination.verdicts[0].sentence == "3 kHz: no verdict (no such port)"
    document = plain(examination_document(examination))
    assert (document["error"], document["exit_status"]) == ("no such port", 3)
    assert document["wakeups"]


@pytest.mark.parametrize("steps", [2, 4])
def test_one_that_is_stopped_reports_what_it_measured(
    examined: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, steps: int
) -> None:
    begun: list[object] = []

    def interrupted(body: Callable[..., Any]) -> Callable[..., Any]:
        def call(*words: Any, **options: Any) -> Any:
            begun.append(body)
            if len(begun) > steps:
                raise KeyboardInterrupt
            return body(*words, **options)

        return call

    for name in ("wake_up_latency", "exchanges"):
        monkeypatch.setattr(examination_module, name, interrupted(getattr(examination_module, name)))
    examination, _ = examined(scene(), rates=(1000.0, 2000.0))
    assert (examination.stopped_after, examination.steps, len(begun)) == (steps, 9, steps + 1)
    document = plain(examination_document(examination))
    assert (len(document["wakeups"]), len(document["exchanges"])) == (min(steps, 3), max(steps - 3, 0))
    assert (document["stopped_after_steps"], document["exit_status"]) == (steps, 130)
    assert f"stopped after {steps} of 9 steps" in document["error"]
    console = Console(record=True, width=80)
    show_examination(console, examination)
    told = console.export_text()
    assert ("Exchanges of" in told, "Wake-ups at 3 kHz" in told) == (steps > 3, steps > 2)


def test_one_that_is_stopped_in_its_first_step_has_nothing_to_report(examined: Callable[..., Any]) -> None:
    def interrupt(_step: Step) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        examined(scene(), on_progress=interrupt)


def test_the_device_is_asked_before_anything_is_measured(
    examined: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_answer(trial: Any) -> None:
        raise DeviceError(f"{trial.where}: no answer")

    monkeypatch.setattr(examination_module, "wake_up_latency", lambda *_, **__: pytest.fail("measured before"))
    with pytest.raises(DeviceError, match="/dev/ttyACM0: no answer"):
        examined(scene(port="/dev/ttyACM0"), ask=no_answer)


def test_virtual_time_and_a_scene_that_does_not_fit_its_device_are_refused(examined: Callable[..., Any]) -> None:
    with pytest.raises(UsageError, match="other rate"):
        examined(scene(port="/dev/ttyACM0"), UsageError("other rate"))
    with pytest.raises(UsageError, match="lockstep"):
        examined(scene(clock="lockstep", port="/dev/ttyACM0"))
    with pytest.raises(UsageError, match="loopback"):
        examined(scene(), transport="loopback")
    examination, _ = examined(scene(clock="lockstep"), rates=())
    assert [verdict.clock for verdict in examination.verdicts] == ["device", "host"]


@pytest.mark.parametrize(
    ("rate", "options", "sentence"),
    [
        (3000.0, {"rates": (1000.0, 0.5)}, "--rates: found 0.5 Hz"),
        (3000.0, {"rates": (1000.0, 2e5)}, "--rates: found 200000 Hz"),
        (
            3000.0,
            {"rates": (2000.0, 10.0), "seconds": 0.05},
            "--seconds: found 0.05, expected at least a period of 10 Hz",
        ),
        (10.0, {"rates": (2000.0,), "seconds": 0.05}, "--seconds: found 0.05, expected at least a period of 10 Hz"),
        (2e5, {}, "the scene: rate: found 200000 Hz"),
    ],
)
def test_what_cannot_be_measured_is_refused_before_anything_is(
    examined: Callable[..., Any], rate: float, options: dict[str, Any], sentence: str
) -> None:
    told: list[Step] = []
    with pytest.raises(UsageError, match=sentence):
        examined(scene(rate), on_progress=told.append, **options)
    assert told == []


def test_real_time_is_asked_for_everywhere_and_what_was_granted_is_kept(examined: Callable[..., Any]) -> None:
    examination, run = examined(scene(), rates=(), realtime=True)
    assert examination.grants == (GRANT,)
    assert all(options["realtime"] for options in run.options)
    assert examined(scene(), rates=())[0].grants is None


def test_every_measurement_is_reported_once_it_begins(examined: Callable[..., Any]) -> None:
    told: list[Step] = []

    _, run = examined(scene(), rates=(), on_progress=told.append, seconds=2.0)
    run.options[-1]["on_progress"](Progress("running", elapsed_s=1.0))
    assert told[0] == Step(1, 3, "wake-ups at 3 kHz", 0.0, 2.0, "sleep_on_grid")
    assert told[1] == Step(1, 3, "wake-ups at 3 kHz", 2.0, 2.0, "")
    assert told[2] == Step(3, 3, "exchanges at 3 kHz, clock: host, on the mock", 1.0, 2.0, "")


@pytest.mark.parametrize(
    ("port", "transport", "told"),
    [
        ("", "auto", "'my scene.yaml'"),
        ("/dev/ttyACM0", "auto", "'my scene.yaml' --port /dev/ttyACM0"),
        ("/dev/ttyACM0", "mock", "'my scene.yaml' --mock"),
    ],
)
def test_the_command_it_advises_examines_the_same(
    examined: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, port: str, transport: str, told: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my scene.yaml").write_text(text(port=port), encoding="utf-8")
    examination, _ = examined(load_scene("my scene.yaml"), rates=(), transport=transport)
    assert f"hapsim doctor {told} --realtime" in commands(examination)


def commands(examination: Examination) -> list[str]:
    return [command for advice in examination.advice for command in advice.commands]
