"""`hapsim run`."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapsim.cli.arguments import (
    Json,
    MockFlag,
    Port,
    Realtime,
    Record,
    Reports,
    SceneFile,
    TransportOption,
    Unstable,
    as_played,
    complain,
    load,
    predict_and_warn,
    predict_before_arming,
    require_files_writable,
    say_written,
    seconds_above_zero,
    stderr,
    stdout,
    transport_kind,
)
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult
    from hapsim.running.lifetime import Lifetime
    from hapsim.running.state import RunState


def run(
    scene: SceneFile,
    port: Port = None,
    mock: MockFlag = False,
    transport: TransportOption = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", callback=seconds_above_zero, help="Seconds; left out: until stopped.")
    ] = None,
    record: Record = None,
    reports: Reports = None,
    realtime: Realtime = False,
    watch: Annotated[bool, typer.Option("--watch", help="Follow the scene's file: what is saved is felt.")] = False,
    reconnect: Annotated[
        bool, typer.Option("--reconnect", help="Wait for a device that is lost, and go on once it is back.")
    ] = False,
    status: Annotated[
        str | None,
        typer.Option(
            metavar="PATH", help="Tell the status at this unix socket, for `hapsim status`; auto: by the port."
        ),
    ] = None,
    log: Annotated[
        str, typer.Option(metavar="FORM", help="Standard error: text, or json: a line of JSON for each event.")
    ] = "text",
    unstable: Unstable = False,
    portable: Annotated[bool, typer.Option("--portable", help="The loop in plain Python: less steady.")] = False,
    json: Json = False,
) -> None:
    """Run SCENE against its device, or against the embedded mock where it names none."""
    from hapsim.cli.live import live_line
    from hapsim.cli.run_reporter import RunReporter
    from hapsim.running.notify import Notifier
    from hapsim.running.reconnecting import keep_running, together
    from hapsim.running.signals import undisturbed
    from hapsim.running.state import RunState

    _choose_log(log)
    notifier = Notifier(reconnect)
    with notifier.told_of_failures():
        loaded, kind = load(scene, port), transport_kind(mock, transport, port)
        require_files_writable(record=record)
        warnings = predict_before_arming(scene, as_played(loaded, kind), unstable)
    error_console = stderr()
    reporter = RunReporter(
        error_console, scene if watch else None, lambda changed: predict_and_warn(as_played(changed, kind))
    )
    serves = loaded.device.port if kind == "auto" else None
    state = RunState(os.path.abspath(scene), serves, loaded.rate)
    with notifier.told_of_failures(), _telling(state, status, serves, portable), live_line(error_console) as tell:
        lifetime = keep_running(
            loaded,
            together(state.observer, notifier.observer, reporter.observer(tell, serves or "")),
            reconnect=reconnect,
            record=record,
            duration=duration,
            transport=kind,
            keep=False,
            reports=reports,
            realtime=realtime,
            portable=portable,
            unstable=unstable,
            judges_energy=True,
            on_progress=tell,
            on_warning=complain,
        )
    notifier.stopping(lifetime.failure or "")
    with undisturbed():
        try:
            _show(lifetime, reporter.grants, warnings, json)
        finally:  # even where nobody reads the report: why it failed, and the status, do not depend on it
            if lifetime.failure is not None:
                complain(lifetime.failure)
                raise typer.Exit(lifetime.failure.exit_status)


def _choose_log(log: str) -> None:
    from hapsim.cli.log import use_json_log

    if log not in ("text", "json"):
        raise UsageError(f"--log: found '{log}', expected text or json")
    if log == "json":
        use_json_log()


def _telling(
    state: RunState, status: str | None, port: str | None, portable: bool
) -> contextlib.AbstractContextManager[None]:
    """While open, the status is served to who asks, where that was asked for."""
    if status is None:
        return contextlib.nullcontext()
    from hapsim.cli.as_json import document
    from hapsim.running.status import AUTO, path_for, telling

    path = path_for(port) if status == AUTO else Path(status)
    return telling(path, lambda: document(state.document()) + "\n", gives_way=not portable)


def _show(lifetime: Lifetime, grants: list[PrivilegeResult], warnings: list[str], json: bool) -> None:
    from hapsim.cli.log import json_log

    log, report = json_log(), lifetime.report
    if log is not None:
        ended = f"the run ended after {report.ticks} ticks: {report.ending}"
        log.say("info", "ended", ended, ticks=report.ticks, ending=report.ending, reconnections=lifetime.reconnections)
    if json:
        from hapsim.cli.as_json import document, lifetime_document

        print(document(lifetime_document(lifetime, grants) | {"warnings": warnings}))
        return
    from hapsim.cli.tables import show_report

    show_report(stdout(), lifetime.report, lifetime.reconnections)
    for file in lifetime.records:
        say_written(record=file if file.exists() else None)
