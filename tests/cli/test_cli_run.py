"""`hapsim run` and `hapsim measure`: what they print, write and return."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from firmware_protocol.description import Description
from hapsim.cli.live import live_line
from hapsim.cli.output import set_output_units
from hapsim.cli.run_command import show_report, show_run
from hapsim.cli.run_reporter import RunReporter
from hapsim.errors import GuardError
from hapsim.loop.counts import Progress
from hapsim.recording.trace import load_trace
from hapsim.running import run
from hapsim.running.motors import Motors
from hapsim.scene import parse_scene
from hapsim.scene.shipped import shipped_scene
from hapsim.units import LINEAR

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]

RAN = {"rate_hz", "ticks", "deadline_misses", "lost_frames", "crc_errors"}
FIRST_TOUCH = shipped_scene("first_touch.yaml").replace("clock: device ", "clock: lockstep ")


def test_a_run_prints_one_document_with_the_keys_of_the_contract(
    hapsim: Hapsim, scene_file: SceneFile, every_scene: str
) -> None:
    words = ["--unstable"] if every_scene == "unstable" else []
    answer = hapsim("run", scene_file(every_scene), "--duration", 0.5, "--json", *words)
    assert answer.status == 0
    document = answer.document
    assert document.keys() >= RAN
    assert (document["ticks"], document["rate_hz"], document["ending"]) == (500, 1000, "done")


def test_a_run_is_reported_as_a_table(hapsim: Hapsim, scene_file: SceneFile) -> None:
    answer = hapsim("run", scene_file("spring"), "--duration", 0.25)
    assert answer.status == 0
    rows = [[cell.strip() for cell in line.strip("│").split("│")] for line in answer.out.splitlines() if "│" in line]
    assert ["ended", "done"] in rows
    assert ["virtual time  s", "0.249"] in rows  # from the first position to the last
    assert ["ticks", "250"] in rows


@pytest.fixture(scope="module")
def report() -> Any:
    """Report of a run without a fault."""
    return run(parse_scene(FIRST_TOUCH), duration=0.05).report


def shown(report: Any, **changes: Any) -> str:
    """Returns the printed text of a report with some changed fields."""
    console = Console(record=True, width=200)
    show_report(console, replace(report, **changes))
    return console.export_text()


def test_every_counter_of_a_run_has_a_row_with_its_own_number(report: Any) -> None:
    counters = [
        field.name
        for field in fields(report)
        if type(getattr(report, field.name)) is int and field.name not in ("ticks", "deadline_misses")
    ]
    counts = {name: 100_001 << at for at, name in enumerate(counters)}
    told = shown(report, **counts)
    assert [name for name, count in counts.items() if not re.search(rf"\b{count}\b", told)] == []


def test_a_position_that_does_not_answer_is_reported_once_each_time_and_in_both_reports(
    report: Any, capsys: Any
) -> None:
    sentence = "the position of hand has not changed by one count for 0.2 s although force acted: sensor or cable? [x]"
    assert f"Warning: {sentence}." in shown(report, frozen=sentence)
    line = Console(record=True, width=200)
    show_run(line, replace(report, frozen=sentence))
    assert f"Warning: {sentence}." in line.export_text()
    lines: list[Progress] = []
    reporter = RunReporter(lines.append, "", "auto", None)
    for frozen in ("", sentence, sentence, "", sentence):
        reporter.observer.running(Progress("running", ticks=9, frozen=frozen))
    assert capsys.readouterr().err.count(sentence) == 2
    assert len(lines) == 5
    console = Console(record=True, width=200)
    show_report(console, replace(report, frozen=sentence), 0, reporter.reported)
    assert sentence not in console.export_text()  # it was printed while it ran


def test_an_unknown_motor_is_reported_with_its_device(capsys: Any) -> None:
    session: Any = SimpleNamespace(
        motors=Motors((), Description("it", 1e3, 7, 2047, (1e-6,), (1e-3,), (5.0,)), "no test has shown it")
    )
    RunReporter(lambda _: None, "", "auto", device="left").observer.arming(session)
    assert capsys.readouterr().err == "left: no test has shown it.\n"


@pytest.mark.parametrize(("count", "is_normal"), [(0, False), (2, True), (40, False)])
def test_a_few_frames_refused_by_the_device_are_reported_as_normal(report: Any, count: int, is_normal: bool) -> None:
    told = shown(report, rejected_by_device=count)
    assert ("frames refused by the device" in told) == (count > 0)
    assert ("(a few at arming and disarming are normal)" in told) == is_normal


@pytest.mark.parametrize(
    ("counts", "sentence"),
    [
        ({"lost_frames": 10, "crc_errors": 10, "rejected_by_device": 9}, ""),
        ({"lost_frames": 282, "crc_errors": 100, "rejected_by_device": 129}, "22 % of the positions were lost and 229"),
        ({"lost_frames": 282}, "22 % of the positions were lost: look at cable"),
        ({"crc_errors": 11}, "11 frames were refused: look at cable"),
        ({"rejected_by_device": 11}, "11 frames were refused: look at cable"),
    ],
)
def test_a_wire_that_loses_or_spoils_more_than_a_few_frames_is_reported(
    report: Any, counts: dict[str, int], sentence: str
) -> None:
    told = shown(report, ticks=1000, **counts)
    assert sentence in told
    assert ("`hapsim frames PORT`" in told) == bool(sentence)
    assert ("hapsim doctor" in told) == (counts.keys() == {"lost_frames"})


@pytest.mark.parametrize(
    ("rate", "latest", "marked"),
    [(970.0, 1e-3, "(97.0 % of 1000)"), (1030.0, 1e-3, "(103.0 % of 1000)"), (985.0, 1e-3, ""), (970.0, 0.1, "")],
)
def test_a_rate_that_is_surely_another_than_was_asked_for_is_marked(
    report: Any, rate: float, latest: float, marked: str
) -> None:
    lateness = replace(report.lateness_s, max=latest)
    told = shown(report, virtual_time=False, rate_hz=rate, duration_s=2.0, lateness_s=lateness)
    assert f"{rate:.2f}" in told
    assert ("% of 1000)" in told) == bool(marked)
    assert marked in told


@pytest.mark.parametrize(("elapsed", "told"), [(0.002, "running 0.0 s ·"), (0.3, "running 0.3 s · 7165.5 Hz ·")])
def test_the_live_line_shows_a_rate_once_it_is_one_and_no_minus_before_a_zero(elapsed: float, told: str) -> None:
    set_output_units(LINEAR)
    console = Console(file=io.StringIO(), width=200)
    with live_line(console) as tell:
        tell(
            Progress(
                "running", elapsed_s=elapsed, rate_hz=7165.5, force=(-0.0004, -0.25), position=(-1e-6, 0.0015), ticks=2
            )
        )
    assert console.file.getvalue().startswith(f"{told} +0.00 mm +0.000 N, +1.50 mm -0.250 N")  # type: ignore[attr-defined]


@pytest.mark.parametrize("ending", ["npz", "csv"])
def test_a_run_writes_its_record(hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path, ending: str) -> None:
    record = tmp_path / f"trace.{ending}"
    assert hapsim("run", scene_file("two_hands"), "--duration", 0.1, "--record", record, "--json").status == 0
    if ending == "npz":
        assert load_trace(record).force.shape == (100, 2)
    else:
        assert len(record.read_text(encoding="utf-8").splitlines()) == 101


def test_a_measurement_sees_dry_friction_and_leaves_it_out_of_b(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "hapkit.yaml"
    assert hapsim("new", "--board", "hapkit", path).status == 0
    text = path.read_text("utf-8").replace("clock: device", "clock: lockstep")
    path.write_text(text.replace("  quantum:", "  coulomb: 0.05\n  quantum:"), "utf-8")
    out = hapsim("measure", path).words
    document = hapsim("measure", path, "--json").document
    assert "The device has dry friction, as its motion shows" in out
    assert document["measured"]["b"] == pytest.approx(document["predicted"]["b"], rel=0.1)  # 2.1 N·s/m with it


@pytest.mark.parametrize("name", ["spring", "unstable", "channel_3", "damper", "free", "mass", "hand_in_hand"])
def test_every_scene_can_be_measured_without_a_traceback(hapsim: Hapsim, scene_file: SceneFile, name: str) -> None:
    words = ["--unstable"] if name == "unstable" else []
    told = hapsim("measure", scene_file(name), *words)
    assert told.status == 0
    assert "What the hand feels" in told.out
    assert "nan" not in told.out
    document = hapsim("measure", scene_file(name), "--json", *words).document
    assert (document["predicted"] is None) == (name in ("mass", "hand_in_hand"))


def test_a_measurement_leaves_picture_numbers_and_record(hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path) -> None:
    picture, data, record = (tmp_path / name for name in ("p[1].svg", "d.csv", "r.npz"))
    words = ("--picture", picture, "--data", data, "--record", record)
    told = hapsim("measure", scene_file("spring"), *words)
    assert told.status == 0
    assert str(picture) in told.out
    assert picture.read_text(encoding="utf-8").startswith("<?xml")
    assert data.read_text(encoding="utf-8").count("\n") > 100
    assert load_trace(record).sample.size == 2048


def test_on_the_mock_nothing_is_reported_of_the_wire_of_the_port_that_the_scene_names(
    hapsim: Hapsim, scene_file: SceneFile
) -> None:
    path = scene_file("spring", port="/dev/ttyUSB77", baud=9600)
    assert hapsim("check", path, "--json").document["wire_time"]["of"] == "port"
    for command in (("run", "--duration", 0.1), ("measure",)):
        answer = hapsim(*command, path, "--mock")
        assert answer.status == 0
        assert "baud" not in answer.out + answer.err


def test_a_guard_that_stops_the_force_is_status_4_with_a_document_and_a_record(
    hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path
) -> None:
    record = tmp_path / "trace.npz"
    answer = hapsim("run", scene_file("no_number"), "--duration", 1, "--json", "--record", record)
    assert answer.status == 4
    assert "not a finite number" in answer.err
    assert "Traceback" not in answer.err
    assert "RuntimeWarning" not in answer.err
    assert answer.document["ending"] == "force not finite"
    assert answer.document["exit_status"] == 4
    assert load_trace(record).report.ending == "force not finite"


def test_a_scene_that_diverges_on_the_mock_is_ended_as_before_a_hand(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "stiff.yaml"
    path.write_text(FIRST_TOUCH.replace("stiffness: 2000,", "stiffness: 40000,"), encoding="utf-8")
    answer = hapsim("run", path, "--unstable", "--duration", 20, "--json")
    assert answer.status == answer.document["exit_status"] == 4
    assert answer.document["ending"] == "scene diverging"
    assert "`hapsim check` reports what would make the scene stable" in answer.err


@pytest.mark.parametrize("limit", [1e-3, 1e-9, 1e-12])
def test_a_hand_that_hardly_moves_is_measured_or_refused_in_words(
    hapsim: Hapsim, scene_file: SceneFile, limit: float
) -> None:
    answer = hapsim("measure", scene_file("spring", force_limit=limit))
    assert answer.status in (0, 2), answer.err
    assert "defect" not in answer.err


def test_a_force_limit_beyond_what_the_mock_gives_is_reported_and_costs_no_resolution(
    hapsim: Hapsim, scene_file: SceneFile
) -> None:
    answer = hapsim("measure", scene_file("spring", force_limit=1e12), "--json")
    assert "Warning: device.force_limit: found 1e+12 N, more than 250 N: devices render 0.2 to 50 N.\n" in answer.err
    predicted, measured = answer.document["predicted"], answer.document["measured"]
    assert measured["k"] == pytest.approx(predicted["k"], rel=1e-6)
    assert measured["b"] == pytest.approx(predicted["b"], rel=1e-5)


@pytest.mark.parametrize("command", [["run", "--duration", 0.05], ["measure"]])
def test_a_record_that_exists_is_replaced_only_with_overwrite(
    hapsim: Hapsim, scene_file: SceneFile, tmp_path: Path, command: list[Any]
) -> None:
    record, scene = tmp_path / "trace.npz", scene_file("spring")
    record.write_text("mine", encoding="utf-8")
    refused = hapsim(*command, scene, "--record", record)
    assert (refused.status, refused.sentence) == (2, f"{record}: the file exists; --overwrite replaces it\n")
    assert record.read_text(encoding="utf-8") == "mine"
    assert hapsim(*command, scene, "--record", record, "--overwrite", "--json").status == 0
    assert load_trace(record).report.ending == "done"


def test_a_dead_sensor_is_named_once_by_a_warning_or_by_the_error() -> None:
    failure = GuardError(
        "scene: the run ended normally after 9 ticks, without force: ", "it stands still", "; released"
    )
    failure.sensors = {"frozen": 1}
    assert failure.shortened({"wrong_sensor"}) == str(failure)
    short = failure.shortened({"frozen"})
    assert "it stands still" not in short
    assert "a warning above names the sensor; released" in short
