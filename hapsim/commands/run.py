"""`hapsim run`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from hapsim.commands.arguments import (
    Json,
    MockFlag,
    Port,
    Realtime,
    Record,
    SceneFile,
    TransportOption,
    as_played,
    complain,
    load,
    predict_and_warn,
    require_files_writable,
    say_written,
    seconds_above_zero,
    stderr,
    stdout,
    transport_kind,
)

if TYPE_CHECKING:
    from hapsim.errors import RunError
    from hapsim.loop.trace import Report
    from hapsim.realtime import PrivilegeResult
    from hapsim.scene import Scene


def run(
    scene: SceneFile,
    port: Port = None,
    mock: MockFlag = False,
    transport: TransportOption = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", callback=seconds_above_zero, help="Seconds; left out: until stopped.")
    ] = None,
    record: Record = None,
    realtime: Realtime = False,
    watch: Annotated[bool, typer.Option("--watch", help="Follow the scene's file: what is saved is felt.")] = False,
    portable: Annotated[bool, typer.Option("--portable", help="The loop in plain Python: less steady.")] = False,
    json: Json = False,
) -> None:
    """Run SCENE against its device, or against the embedded mock where it names none."""
    from hapsim.console.live import live_line
    from hapsim.console.run_reporter import RunReporter
    from hapsim.console.tables import show_report
    from hapsim.errors import RunError
    from hapsim.running import run as run_scene
    from hapsim.running.signals import undisturbed

    loaded, kind = load(scene, port), transport_kind(mock, transport, port)
    require_files_writable(record=record)

    def warn_about(changed: Scene) -> None:
        predict_and_warn(as_played(changed, kind))

    warn_about(loaded)
    error_console = stderr()
    reporter = RunReporter(error_console, scene if watch else None, warn_about)
    failure: RunError | None = None
    try:
        with live_line(error_console) as tell:
            trace = run_scene(
                loaded,
                duration=duration,
                transport=kind,
                keep=record is not None,
                realtime=realtime,
                portable=portable,
                judges_energy=True,
                on_progress=tell,
                on_start=reporter.started,
                stop_on_signals=True,
            )
    except RunError as error:
        if error.trace is None:
            raise
        failure, trace = error, error.trace
    with undisturbed():
        if record is not None:
            trace.save(record)
        if json:
            _print_run(trace.report, reporter.grants, failure)
        else:
            show_report(stdout(), trace.report)
            say_written(record=record)
    if failure is not None:
        complain(failure)
        raise typer.Exit(failure.exit_status)


def _print_run(report: Report, grants: list[PrivilegeResult], failure: RunError | None) -> None:
    from hapsim.console.as_json import document, failure_document, report_document

    print(document(report_document(report, grants) | failure_document(failure)))
