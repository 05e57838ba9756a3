"""`hapsim run`."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from hapsim.cli.as_json import document
from hapsim.cli.live import live_line
from hapsim.cli.options import (
    DeviceOptions,
    Json,
    Realtime,
    RecordOptions,
    Unstable,
    say_written,
    seconds,
)
from hapsim.cli.output import Level, complain, fitted, json_log, stderr, stdout, use_json_log
from hapsim.cli.run_report import lifetime_document, show_report
from hapsim.device.known_devices import is_new
from hapsim.errors import UsageError
from hapsim.loop.realtime.giving_way import Beside
from hapsim.prediction import Prediction, predict, warnings_about
from hapsim.prediction.force_bounds import refused_slew
from hapsim.progress import Progress
from hapsim.running.observers import Notifier, RunState
from hapsim.running.reconnecting import RunObserver, keep_running, together
from hapsim.running.requirements import why_not_armed
from hapsim.running.status import AUTO, path_for, telling
from hapsim.running.watch import WatchedFile
from hapsim.stopping import undisturbed

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult
    from hapsim.running import Session
    from hapsim.running.reconnecting import Lifetime
    from hapsim.scene import Scene

_LOOK_S = 0.05  # how often the scene's file is looked at


def run(
    device: DeviceOptions,
    *,
    duration: Annotated[float | None, seconds("Duration in seconds [default: until interrupted]")] = None,
    record: RecordOptions,
    reports: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Directory for the report of a run that a guard or the device ends, the newest 20 "
            "[default: ~/.local/state/hapsim/reports, for a device on a port]",
        ),
    ] = None,
    realtime: Realtime = False,
    watch: Annotated[bool, typer.Option("--watch", help="Follow the scene's file: apply it when it is saved.")] = False,
    reconnect: Annotated[
        bool, typer.Option("--reconnect", help="Wait for a device that is lost, and continue when it is back.")
    ] = False,
    status: Annotated[
        str | None,
        typer.Option(
            metavar="PATH", help="Report the status at this unix socket, for `hapsim status`; auto: named by the port."
        ),
    ] = None,
    log: Annotated[
        str, typer.Option(metavar="FORM", help="Form of standard error: text, or json, one line for each event.")
    ] = "text",
    unstable: Unstable = False,
    portable: Annotated[
        bool, typer.Option("--portable", help="Run the loop in plain Python: more jitter, no Linux needed.")
    ] = False,
    json: Json = False,
) -> None:
    """Run a scene with its device, or with the built-in mock."""
    _choose_log(log)
    notifier = Notifier(reconnect)
    with notifier.told_of_failures():
        loaded, kind = device.load(), device.kind()
        record.require_writable()
        warnings = predict_before_arming(device.scene, with_mock(loaded, kind), unstable)
    error_console = stderr()
    reporter = RunReporter(
        error_console, device.scene if watch else None, lambda changed: _predict_and_warn(with_mock(changed, kind))
    )
    serves = loaded.device.port if kind == "auto" else None
    state = RunState(os.path.abspath(device.scene), serves, loaded.rate)
    with notifier.told_of_failures(), _telling(state, status, serves, portable), live_line(error_console) as tell:
        lifetime = keep_running(
            loaded,
            together(state.observer, notifier.observer, reporter.observer(tell, serves or "")),
            reconnect=reconnect,
            record=record.record,
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
        _show(lifetime, reporter.grants, warnings, json)
        if lifetime.failure is not None:
            complain(lifetime.failure)
            raise typer.Exit(lifetime.failure.exit_status)


def with_mock(scene: Scene, kind: Any) -> Scene:
    """Returns the scene to predict: without its port, and so without a wire, if the mock of this process is used.
    `kind`: the TransportKind."""
    if kind == "auto":
        return scene
    return scene.model_copy(update={"device": scene.device.model_copy(update={"port": None})})


def predict_before_arming(path: str, scene: Scene, unstable: bool) -> list[str]:
    """Predicts the scene of this file and prints its warnings; returns them. Raises UsageError if the scene is surely
    unstable and `unstable` is False, or if its slew limit is too slow for the mock."""
    if why := refused_slew(scene):
        raise UsageError(why)
    prediction = predict(scene, with_margins=False)
    require_stable(path, scene, prediction, unstable)
    return warn(scene, prediction)


def require_stable(path: str, scene: Scene, prediction: Prediction, unstable: bool) -> None:
    """Raises UsageError if the scene of this file is surely predicted unstable and `unstable` is False."""
    why = "" if unstable else why_not_armed(path, scene, prediction)
    if why:
        raise UsageError(why)


def warn(scene: Scene, prediction: Prediction) -> list[str]:
    """Prints the warnings of a prediction before the scene runs, and returns them."""
    warnings = warnings_about(scene, prediction)
    for warning in warnings:
        complain(warning, "prediction", "warning")
    return warnings


def _predict_and_warn(scene: Scene) -> None:
    warn(scene, predict(scene, with_margins=False))


def _choose_log(log: str) -> None:

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

    path = path_for(port) if status == AUTO else Path(status)
    return telling(path, lambda: document(state.document()) + "\n", gives_way=not portable)


def _show(lifetime: Lifetime, grants: list[PrivilegeResult], warnings: list[str], json: bool) -> None:

    log, report = json_log(), lifetime.report
    if log is not None:
        ended = f"the run ended after {report.ticks} ticks: {report.ending}"
        log.say("info", "ended", ended, ticks=report.ticks, ending=report.ending, reconnections=lifetime.reconnections)
    if json:
        print(document(lifetime_document(lifetime, grants) | {"warnings": warnings}))
        return

    show_report(stdout(), lifetime.report, lifetime.reconnections)
    for file in lifetime.records:
        say_written(record=file if file.exists() else None)


def show_grants(error: Console, grants: Sequence[PrivilegeResult]) -> None:
    """A line for each privilege, granted or denied and why."""
    log = json_log()
    for grant in grants:
        if log is not None:
            word = "granted" if grant.granted else "denied"
            sentence = f"{word} {grant.privilege}: {grant.detail}"
            log.say("info" if grant.granted else "warning", word, sentence, about=sentence, **vars(grant))
            continue
        sign = "[green]granted[/green]" if grant.granted else "[yellow]denied[/yellow] "
        error.print(
            f"{sign} {grant.privilege}: {escape(grant.detail)}", soft_wrap=not error.is_terminal, highlight=False
        )


class RunReporter:
    """Reports that a run has started, and what it makes of edits while it runs. `watched`: the file to follow, if any;
    `about(scene)` says what there is to be said of a changed scene."""

    def __init__(self, error: Console, watched: str | None, about: Callable[[Scene], None]) -> None:

        self._error = error
        self._file = WatchedFile(watched) if watched is not None else None
        self._about = about
        self.grants: list[PrivilegeResult] = []
        self._placed = False  # whether it was looked at where the device was armed

    def started(self, session: Session) -> None:
        """The device is armed. From now on the file is followed, in a thread of its own: nobody waits for it."""

        self.grants, self._placed = session.grants, False
        log = json_log()
        if log is not None:
            log.say("info", "armed", f"the device is armed; {session.scene.path or 'the scene'} runs")
        show_grants(self._error, session.grants)
        if self._file is not None:
            file = self._file
            Beside(lambda: self._follow(file, session), session.gives_way)

    def observer(self, tell: Callable[[Progress], None], port: str) -> RunObserver:
        """What has a run be reported: by sentences, and by `tell` on a live line."""

        return RunObserver(
            arming=lambda: self._meet(port),
            started=self.started,
            running=lambda progress: self._running(progress, tell),
            waiting=lambda: tell(Progress("waiting", port)),
            tell=lambda event, sentence: self._say(event, sentence, "info" if event == "reconnected" else "warning"),
        )

    def _meet(self, port: str) -> None:
        """Says of a device that answers for the first time what it has not shown yet. `port`: empty for the mock."""

        if port and is_new(port):
            self._say(
                "new device",
                f"First run at {port}: `hapsim probe {port} --push 0.5`, or `hapsim identify`, judges whether its "
                "motor pushes the right way. Hold it loosely until then.",
            )

    def _running(self, progress: Progress, tell: Callable[[Progress], None]) -> None:
        """Shows it; and says, once for each arming, where the device was armed outside its travel."""
        if progress.phase == "running" and progress.ticks > 0 and not self._placed:
            self._placed = True
            if progress.faded_ticks == progress.ticks:
                places = ", ".join(f"{one:.6g}" for one in progress.position)
                self._say(
                    "outside",
                    f"the device was armed outside device.travel (it is at {places} m): there the force fades, and is "
                    "zero beyond the band. Move it within, or say with device.origin where its zero is",
                    "warning",
                )
        tell(progress)

    def _follow(self, file: WatchedFile, session: Session) -> None:
        while not session.wait(_LOOK_S):
            news = file.look(session)
            if news is None:
                continue
            if news.refused:
                self._say("refused", f"{news.refused}\nNothing was changed.", "warning")
            for change in news.changed:
                self._say("changed", f"changed: {change}")
            if news.changed:
                self._about(session.scene)

    def _say(self, event: str, text: str, level: Level = "info") -> None:
        log = json_log()
        if log is not None:
            log.say(level, event, text, about=text)
            return
        columns = self._error.width if self._error.is_terminal else None
        self._error.print(fitted(text, columns), soft_wrap=True, highlight=False, markup=False)
