"""`hapsim run`."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapsim.cli.live import live_line
from hapsim.cli.live_options import LiveOptions
from hapsim.cli.options import (
    DeviceOptions,
    Json,
    Realtime,
    RecordOptions,
    Unstable,
    Watch,
    flag,
    on_port,
    option,
    require_file,
    say_written,
    scene_name,
    seconds,
)
from hapsim.cli.output import complain, document, json_log, log_as_json, stderr, stdout, warn
from hapsim.cli.run_report import lifetime_document, show_report
from hapsim.device.ports import is_new
from hapsim.errors import UsageError
from hapsim.loop.beside import Beside
from hapsim.prediction import Prediction, predict, warnings_about
from hapsim.prediction.force_bounds import refused_slew
from hapsim.progress import Progress
from hapsim.running.reconnecting import RunObserver, keep_running, together
from hapsim.running.requirements import why_not_armed
from hapsim.running.service import Notifier
from hapsim.running.status import AUTO, RunState, path_for, telling
from hapsim.running.watch import WatchedFile
from hapsim.stopping import undisturbed

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult
    from hapsim.running import Session
    from hapsim.running.reconnecting import Lifetime
    from hapsim.scene import Scene

_LOOK_S = 0.05  # how often the scene's file is looked at


@dataclass
class ServiceOptions:
    """What a run does that goes on for long."""

    reports: Annotated[
        Path | None,
        option(
            "DIR",
            "Directory for the report of a run that a guard or the device ends, the newest 20 "
            "[default: ~/.local/state/hapsim/reports, for a device on a port]",
        ),
    ] = None
    watch: Watch = False
    reconnect: Annotated[bool, flag("--reconnect", "Wait for a lost device, and continue when it is back.")] = False
    status: Annotated[
        str | None,
        option("PATH", "Report the status at this unix socket, for `hapsim status`; auto: named by the port."),
    ] = None
    log: Annotated[str, option("FORM", "Form of standard error: text, or json, one line for each event.")] = "text"

    def choose_log(self) -> None:
        """Writes standard error in the form that is asked for. Raises UsageError for another form."""
        if self.log not in ("text", "json"):
            raise UsageError(f"--log: found '{self.log}', expected text or json")
        log_as_json(self.log == "json")

    def serving(self, state: RunState, port: str | None, gives_way: bool) -> contextlib.AbstractContextManager[None]:
        """Returns a context in which the status is served, if that is asked for."""
        if self.status is None:
            return contextlib.nullcontext()
        path = path_for(port) if self.status == AUTO else Path(self.status)
        return telling(path, lambda: document(state.document()) + "\n", gives_way=gives_way)


@dataclass
class SoundOptions:
    """Where the scene's sound goes."""

    sound: Annotated[bool, flag("--sound", "Play the scene's sound on a sound card.")] = False
    sound_device: Annotated[
        str | None,
        option("NAME", "Sound card, by a name or a number of `hapsim sound` [default: the system's]."),
    ] = None
    volume: Annotated[float | None, option("DB", "Volume in dB; 0 is full scale [default: 0]")] = None
    latency: Annotated[
        float | None, option("MS", "Time from a position to the loudspeaker in ms, if it can be had [default: 15]")
    ] = None
    sound_file: Annotated[
        Path | None, option("FILE.wav", "Write the sound, also without a sound card and in virtual time.")
    ] = None

    def values(self, record: RecordOptions) -> dict[str, Any]:
        """Returns the options of `start`. Raises UsageError where the file exists or --sound is missing."""
        names = ("--sound-device", self.sound_device), ("--volume", self.volume), ("--latency", self.latency)
        if given := [name for name, value in names if value is not None and not self.sound]:
            raise UsageError(f"{given[0]}: found no --sound, which plays the scene's sound; expected both")
        if self.sound_file is not None:
            record.require_free(self.sound_file)
        values: dict[str, Any] = {
            "sound": self.sound,
            "sound_file": self.sound_file,
            "sound_device": self.sound_device or "",
        }
        if self.latency is not None:
            values["latency_s"] = 1e-3 * self.latency
        if self.volume is not None:
            values["volume_db"] = self.volume
        return values


def run(
    device: DeviceOptions,
    *,
    duration: Annotated[float | None, seconds("Duration in seconds [default: until interrupted]")] = None,
    record: RecordOptions,
    sound: SoundOptions,
    realtime: Realtime = False,
    service: ServiceOptions,
    live: LiveOptions,
    unstable: Unstable = False,
    portable: Annotated[
        bool, flag("--portable", "Run the loop in plain Python: more jitter, no Linux needed.")
    ] = False,
    json: Json = False,
) -> None:
    """Run a scene with its device, or with the built-in mock."""
    service.choose_log()
    if service.watch:
        require_file(device.scene, "--watch")
    notifier = Notifier(service.reconnect)
    with notifier.told_of_failures():
        scene, kind = device.load(), device.kind()
        record.require_writable()
        playing = sound.values(record)
        warnings = predict_before_arming(device.scene, with_mock(scene, kind), unstable)
    port = scene.device.port if kind == "auto" else None
    place = os.path.abspath(device.scene) if scene.path else scene_name(device.scene)
    state, gives_way = RunState(place, port, scene.rate, scene.device.motions(scene.channels)), not portable
    told, status, served = notifier.told_of_failures(), service.serving, live.serving
    with told, status(state, port, gives_way), served(scene, place, gives_way) as hub, live_line(stderr()) as tell:
        reporter = _Reporter(tell, port or "", kind, WatchedFile(device.scene) if service.watch else None)
        lifetime = keep_running(
            scene,
            together(state.observer, notifier.observer, reporter.observer, *([hub.observer] if hub else [])),
            reconnect=service.reconnect,
            record=record.record,
            duration=duration,
            transport=kind,
            keep=False,
            reports=service.reports,
            realtime=realtime,
            portable=portable,
            unstable=unstable,
            judges_energy=True,
            on_progress=tell,
            on_warning=complain,
            **playing,
            **(hub.options if hub else {}),
        )
        if hub:
            hub.ended(lifetime.failure)
    notifier.stopping(lifetime.failure or "")
    with undisturbed():
        _show(lifetime, reporter.grants, warnings, json)
        if lifetime.failure is not None:
            complain(lifetime.failure)
            raise typer.Exit(lifetime.failure.exit_status)


def with_mock(scene: Scene, kind: Any) -> Scene:
    """Returns the scene to predict: without its port, and so without a wire, if the mock of this process is used.
    `kind`: the TransportKind."""
    return scene if kind == "auto" else on_port(scene, None)


def predict_before_arming(path: str, scene: Scene, unstable: bool) -> list[str]:
    """Predicts the scene of this file and prints its warnings; returns them. Raises UsageError if the scene is surely
    unstable and `unstable` is False, or if its slew limit is too slow for the mock."""
    if why := refused_slew(scene):
        raise UsageError(why)
    prediction = predict(scene, with_margins=False)
    require_stable(path, scene, prediction, unstable)
    return print_warnings(scene, prediction)


def require_stable(path: str, scene: Scene, prediction: Prediction, unstable: bool) -> None:
    """Raises UsageError if the scene of this file is surely predicted unstable and `unstable` is False."""
    why = "" if unstable else why_not_armed(scene_name(path), scene, prediction)
    if why:
        raise UsageError(why)


def print_warnings(scene: Scene, prediction: Prediction) -> list[str]:
    """Prints the warnings of a prediction before the scene runs, and returns them."""
    warnings = warnings_about(scene, prediction)
    for warning in warnings:
        warn(warning, "prediction")
    return warnings


def _show(lifetime: Lifetime, grants: Sequence[PrivilegeResult], warnings: list[str], json: bool) -> None:
    log, report = json_log(), lifetime.report
    if log is not None:
        ended = f"the run ended after {report.ticks} ticks: {report.ending}"
        log.say("info", "ended", ended, ticks=report.ticks, ending=report.ending, reconnections=lifetime.reconnections)
    if json:
        print(document(lifetime_document(lifetime, grants) | {"warnings": warnings}))
        return
    show_report(stdout(), report, lifetime.reconnections)
    for file in lifetime.records:
        say_written("Trace", file if file.exists() else None)
    for file in lifetime.sound_files:
        say_written("Sound", file if file.exists() else None)


class _Reporter:
    """Reports that a run has started, and what becomes of edits of its scene while it runs."""

    def __init__(self, tell: Callable[[Progress], None], port: str, kind: Any, file: WatchedFile | None) -> None:
        """`tell`: shows progress. `port`: "" for the mock. `kind`: the TransportKind. `file`: the one to follow."""
        self._tell, self._port, self._kind, self._file = tell, port, kind, file
        self.grants: list[PrivilegeResult] = []
        self._is_placed = False  # whether the position at arming has been looked at
        self._is_frozen = False  # whether a position stood still at the last look

    @property
    def observer(self) -> RunObserver:
        """What calls this."""
        return RunObserver(
            arming=self._meet,
            started=self._started,
            running=self._running,
            waiting=lambda: self._tell(Progress("waiting", self._port)),
            tell=lambda event, sentence: complain(sentence, event, "info" if event == "reconnected" else "warning"),
        )

    def _meet(self) -> None:
        """Reports of a device that answers for the first time what has not been judged yet."""
        if self._port and is_new(self._port):
            complain(
                f"First run at {self._port}: `hapsim probe {self._port} --push 0.5`, or `hapsim identify`, judges "
                "whether its motor pushes the right way. Hold it loosely until then.",
                "new device",
                "info",
            )

    def _started(self, session: Session) -> None:
        """The device is armed. From now on the file is followed, in a thread of its own."""
        self.grants, self._is_placed = session.grants, False
        if (log := json_log()) is not None:
            log.say("info", "armed", f"the device is armed; {session.scene.path or 'the scene'} runs")
        for grant in session.grants:
            word = "granted" if grant.granted else "denied"
            sentence = f"{word} {grant.privilege}: {grant.detail}"
            complain(sentence, word, "info" if grant.granted else "warning", **vars(grant))
        if self._file is not None:
            file = self._file
            Beside(lambda: self._follow(file, session), session.gives_way)

    def _running(self, progress: Progress) -> None:
        """Shows progress; and reports, once for each arming, that the device was armed outside its travel, and each
        time that a position stands still while force acts."""
        if progress.phase in ("running", "ended") and progress.ticks > 0 and not self._is_placed:
            self._is_placed = True
            if progress.faded_ticks == progress.ticks:
                places = ", ".join(f"{one:.6g}" for one in progress.position)
                complain(
                    f"the device was armed outside device.travel (it is at {places} m): there the force fades, and is "
                    "zero beyond the band. Move it within, or say with device.origin where its zero is",
                    "outside",
                    "warning",
                )
        if progress.frozen and not self._is_frozen:
            complain(progress.frozen, "frozen", "warning")
        self._is_frozen = bool(progress.frozen)
        self._tell(progress)

    def _follow(self, file: WatchedFile, session: Session) -> None:
        while not session.wait(_LOOK_S):
            news = file.look(session)
            if news is None:
                continue
            if news.refused:
                complain(f"{news.refused}\nNothing was changed.", "refused", "warning")
            for change in news.changed:
                complain(f"changed: {change}", "changed", "info")
            if news.changed:
                scene = with_mock(session.scene, self._kind)
                print_warnings(scene, predict(scene, with_margins=False))
