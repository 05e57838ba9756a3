"""`hapsim run` and its report."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapsim.cli import output
from hapsim.cli.before_arming import predict_before_arming, predict_devices
from hapsim.cli.command_options import (
    DeviceOptions,
    Json,
    Realtime,
    RecordOptions,
    Unstable,
    Watch,
    flag,
    option,
    print_written,
    require_file,
    require_watchable,
    scene_name,
    seconds,
)
from hapsim.cli.live import LiveOptions, live_line
from hapsim.cli.output import output_units
from hapsim.cli.run_reporter import RunReporter, print_unsaved
from hapsim.device.open_connection import on_device
from hapsim.documents import pick
from hapsim.errors import HapsimError, UsageError
from hapsim.measuring.trace_quality import kept_rate
from hapsim.number_format import listed, percent, plural
from hapsim.running.reconnecting import keep_running, observe_all
from hapsim.running.service import Notifier
from hapsim.running.status import AUTO, RunState, path_for, serve_status
from hapsim.running.watch import WatchedFile
from hapsim.stopping import undisturbed

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.loop.histogram import Spread
    from hapsim.loop.realtime import PrivilegeResult
    from hapsim.recording.trace import Report
    from hapsim.running.reconnecting import Lifetime
    from hapsim.scene import Scene


@dataclass
class ServiceOptions:
    """Options of long runs."""

    reports: Path | None = option(
        "DIR",
        "Directory for reports of runs that a guard or the device ended. The newest 20 are kept "
        "[default: ~/.local/state/hapsim/reports, or none with the mock]",
    )
    watch: Watch = False
    reconnect: bool = flag("--reconnect", "Wait for a lost device, and continue when it is back.")
    status: str | None = option("PATH", "Unix socket for `hapsim status`, or auto: one named after the port.")
    log: str = option("FORM", "Format of standard error: text, or json with one line per event.", default="text")

    def choose_log(self) -> None:
        """Sets the format of standard error. Raises UsageError for an unknown format."""
        if self.log not in ("text", "json"):
            raise UsageError(f"--log: found '{self.log}', expected text or json")
        output.log_as_json(self.log == "json")

    def serving(
        self, state: RunState, port: str | None, idle_priority: bool
    ) -> contextlib.AbstractContextManager[None]:
        """Returns a context in which the status is served, if --status is given."""
        if self.status is None:
            return contextlib.nullcontext()
        path = path_for(port) if self.status == AUTO else Path(self.status)
        return serve_status(path, lambda: output.document(state.document()) + "\n", idle_priority=idle_priority)


@dataclass
class SoundOptions:
    """Output of the scene's sound."""

    sound: bool = flag("--sound", "Play the scene's sound on a sound card.")
    sound_device: str | None = option(
        "NAME", "Sound card: name or number listed by `hapsim sound` [default: the system's]"
    )
    volume: float | None = option("DB", "Volume in dB, where 0 is full scale [default: 0]")
    latency: float | None = option("MS", "Target latency from position to loudspeaker in ms [default: 15]")
    sound_file: Path | None = option("FILE.wav", "Write the sound to this file. No sound card is needed.")

    def values(self, record: RecordOptions) -> dict[str, Any]:
        """Returns the options of `start`. Raises UsageError where the file exists or --sound is missing."""
        names = ("--sound-device", self.sound_device), ("--volume", self.volume), ("--latency", self.latency)
        if given := [name for name, value in names if value is not None and not self.sound]:
            raise UsageError(f"{given[0]} needs --sound")
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
    duration: float | None = seconds("Duration in seconds [default: until interrupted]"),
    record: RecordOptions,
    sound: SoundOptions,
    realtime: Realtime = False,
    service: ServiceOptions,
    live: LiveOptions,
    unstable: Unstable = False,
    portable: bool = flag("--portable", "Run the loop in plain Python, as systems other than Linux do: more jitter."),
    json: Json = False,
) -> None:
    """Run a scene with its device, or with the built-in mock."""
    service.choose_log()
    if service.watch:
        require_file(device.scene, "--watch")
    notifier = Notifier(service.reconnect)
    with notifier.notify_failures():
        scene = device.load()
        _require_options(scene, service, live, portable)
        kind = live.transport_kind(device, scene)
        options = {
            "duration": duration,
            "transport": kind,
            "realtime": realtime,
            "portable": portable,
            "unstable": unstable,
            "reports": service.reports,
            "judges_energy": True,
            "keep": False,
            "lsl": live.lsl,
            "on_warning": output.print_message,
            **sound.values(record),
        }
        place = os.path.abspath(device.scene) if scene.path else scene_name(device.scene)
        if not scene.ports:
            record.require_writable()
            warnings = predict_before_arming(device.scene, on_device(scene, kind), unstable)
    if scene.ports:
        _run_devices(place, scene, record, live, options, json)
    else:
        _run_device(device, place, scene, record, service, live, options, warnings, notifier, json)


def _run_device(
    device: DeviceOptions,
    place: str,
    scene: Scene,
    record: RecordOptions,
    service: ServiceOptions,
    live: LiveOptions,
    options: dict[str, Any],
    warnings: list[str],
    notifier: Notifier,
    json: bool,
) -> None:
    """Runs a scene of one device, with these options of `start`, through lost devices if `service` reconnects. Prints
    how it ended. `warnings`: those printed already."""
    kind, portable = options["transport"], options["portable"]
    port = scene.device.port if kind == "auto" else None
    state, idle_priority = RunState(place, port, scene.rate, scene.device.motions(scene.channels)), not portable
    with (
        notifier.notify_failures(),
        service.serving(state, port, idle_priority),
        live.serving(scene, place, idle_priority) as hub,
        live_line(output.stderr()) as show,
    ):
        file = WatchedFile(device.scene, scene) if service.watch else None
        reporter = RunReporter(show, port or "", kind, file, warnings, hub.publish if hub else lambda *_: None)
        lifetime = keep_running(
            scene,
            observe_all(state.observer, notifier.observer, reporter.observer, *([hub.observer] if hub else [])),
            reconnect=service.reconnect,
            can_go_on=live.serves_page,
            record=record.record,
            on_progress=show,
            **options,
            **(hub.options if hub else {}),
        )
        if hub:
            hub.ended(lifetime.failure)
    notifier.stopping(lifetime.failure or "")
    with undisturbed():
        reporter.keep_unsaved(place)
        _show(lifetime, reporter, warnings, json)
        _raise_failure(lifetime.failure, reporter.reported)


def _require_options(scene: Scene, service: ServiceOptions, live: LiveOptions, portable: bool) -> None:
    """Raises UsageError for an option that does not go with one device, or with several."""
    alone: dict[str, Any] = {"--watch": service.watch, "--reconnect": service.reconnect}
    alone |= {"--status": service.status, "--portable": portable}
    if scene.ports and (given := [name for name, value in alone.items() if value]):
        devices = f"found several devices, {listed(scene.ports)}"
        raise UsageError(f"{given[0]}: {devices}, expected one: leave it out, or add --device")
    require_watchable(scene, service.watch)
    if live.serve_device is not None and not scene.ports:
        raise UsageError(f"--serve-device: found '{live.serve_device}' in a run of one device, expected none")


def _run_devices(
    place: str, scene: Scene, record: RecordOptions, live: LiveOptions, options: dict[str, Any], json: bool
) -> None:
    """Runs a scene with several devices, and prints a report for each."""
    from hapsim.cli.run_devices import DevicesRun, record_files, use_units

    files, warnings = record_files(record, scene), predict_devices(scene.path or place, scene, options["unstable"])
    served = live.serve_device or scene.leader or ""
    with live.serving(scene.at_port(served), place, idle_priority=True) as hub:
        reporters = {name: RunReporter(lambda _: None, "", options["transport"], device=name) for name in scene.ports}
        devices = DevicesRun(scene, {name: one.observer for name, one in reporters.items()}, hub, served)
        session = devices.run(options | {"record": record.record})
    reported = set[str]().union(*(one.reported for one in reporters.values()))
    reports = {name: trace.report for name, trace in session.traces.items()}
    with undisturbed():
        print_unsaved(session.scene, place)
        for name, report in reports.items():
            _log_end(report, device=name)
        if json:
            found = {name: pick(report, "*") for name, report in reports.items()}
            document = {"devices": found, "records": files, "warnings": warnings}
            print(output.document(document | output.failure_document(devices.failure)))
        else:
            for name, report in reports.items():
                use_units(session.ports[name].scene)
                output.stdout().print(f"\n{name}", style="bold", end="")
                show_report(output.stdout(), report, reported=reported)
            _print_files(Trace=files, Sound=filter(None, [options["sound_file"]]))
        _raise_failure(devices.failure, reported)


def _raise_failure(failure: HapsimError | None, reported: Container[str]) -> None:
    """Prints why a run failed, without what was reported during it, and exits with the status of that."""
    if failure is not None:
        failure.args = (failure.shortened(reported),)
    output.exit_if_failed(failure)


def _show(lifetime: Lifetime, reporter: RunReporter, warnings: list[str], json: bool) -> None:
    _log_end(lifetime.report, reconnections=lifetime.reconnections)
    if json:
        print(output.document(lifetime_document(lifetime, reporter.grants) | {"warnings": warnings}))
        return
    in_error = set(lifetime.failure.sensors if lifetime.failure else ())
    show_report(output.stdout(), lifetime.report, lifetime.reconnections, reporter.reported | in_error)
    _print_files(Trace=lifetime.records, Sound=lifetime.sound_files)


def _log_end(report: Report, **about: Any) -> None:
    if (log := output.json_log()) is not None:
        ended = f"the run ended after {report.ticks} ticks: {report.ending}"
        log.write("info", "ended", ended, ticks=report.ticks, ending=report.ending, **about)


def _print_files(**files: Iterable[Path]) -> None:
    for what, each in files.items():
        for file in each:
            print_written(what, file if file.exists() else None)


_GRIP_S = 1.0  # a hand takes no longer for another grip: an older mass may no longer be that
_MASS_KNOWN, _LITTLE_EXPLAINED = 0.1, 0.9  # relative uncertainty and share of the motion: a warning beyond either
_NORMAL_REFUSALS = 9  # of the device, at arming and disarming
_FEW = 0.01  # of the positions
_OFF_RATE = 0.02  # of the rate, from which a hand feels another damping


def show_report(out: Console, report: Report, reconnections: int = 0, reported: Container[str] = ()) -> None:
    """Prints the report of a run as a table. `reconnections`: of its device; `reported`: kinds of sentences about
    sensors that were printed already."""
    out.print()
    out.print(output.table("The run", ("", "result"), _rows(report, reconnections), show_header=False))
    _warn_of_the_wire(out, report, reported)


def show_run(out: Console, report: Report) -> None:
    """Prints the report of a run in one line, and problems of the wire."""
    misses = plural(report.deadline_misses, "deadline miss", "deadline misses")
    out.print(
        f"The run: {report.ending}, {report.ticks} ticks in {report.duration_s:.3g} s of {_time(report)} at "
        f"{report.rate_hz:.6g} Hz{_off_rate(report)}, {misses}; --explain prints the report"
    )
    _warn_of_the_wire(out, report)


def _rows(report: Report, reconnections: int) -> Iterator[tuple[str, str]]:
    yield "ended", report.ending
    yield f"{_time(report)}  s", f"{report.duration_s:.3f}"
    yield "ticks", str(report.ticks)
    if reconnections:
        yield "reconnections", str(reconnections)
    yield "rate  Hz", f"{report.rate_hz:.2f}{_off_rate(report)}"
    share = report.deadline_misses / report.ticks if report.ticks else 0.0
    yield "deadline misses", f"{report.deadline_misses} ({100.0 * share:.2f} %)"
    if report.age_samples.max is not None:
        at_most = "at most " if report.deadline_misses else ""
        yield "oldest force  samples", f"{at_most}{report.age_samples.max:.0f}"
    if not report.virtual_time:
        yield "lateness  µs", _spread_in_us(report.lateness_s)
        yield "exchange  µs", _spread_in_us(report.exchange_s)
    if report.parameter_changes:
        yield "changes taken", str(report.parameter_changes)
    if refused := report.rejected_by_device or 0:
        normal = " (a few at arming and disarming are normal)" if refused <= _NORMAL_REFUSALS else ""
        yield "frames refused by the device", f"[yellow]{refused}[/yellow]{normal}"
    for label, count in report.shown("row"):
        yield label, f"[yellow]{count}[/yellow]"
    if report.sound_frames:
        yield "frames of the sound", str(report.sound_frames)
    if report.resampling_ppm is not None:
        yield "device's clock by the sound card's  ppm", f"{report.resampling_ppm:+.1f}"
    if report.sound_latency_s is not None:
        p50, p99 = (f"{1e3 * one:.1f}" for one in report.sound_latency_s)
        yield "position to loudspeaker  ms", f"{p50} (99 %: {p99})"
    for channel, mass in enumerate(report.estimated_mass_kg):
        if mass is not None:
            yield (
                f"estimated mass, channel {channel}  {output_units(channel).name('kg')}",
                _estimated_mass(report, channel, mass),
            )
    if report.released is False:
        yield "force released", "[yellow]not confirmed[/yellow]"


def _time(report: Report) -> str:
    return "virtual time" if report.virtual_time else "real time"


def _warn_of_the_wire(out: Console, report: Report, reported: Container[str] = ()) -> None:
    """Prints advice if a sensor was wrong, if no force held the hand, or if the wire lost or damaged more than a few
    frames."""
    sentences = {kind: getattr(report, kind) for kind in ("frozen", "wrong_sensor", "beyond_limit")}
    for sentence in [one for kind, one in sentences.items() if one and kind not in reported]:
        out.print(f"Warning: {sentence}.", style="yellow", markup=False)
    positions = report.ticks + report.lost_frames
    refused_there = report.rejected_by_device or 0
    refused = report.crc_errors + (refused_there if refused_there > _NORMAL_REFUSALS else 0)
    if not positions or max(report.lost_frames, refused) <= _FEW * positions:
        return
    problems = [f"{_share(report.lost_frames / positions)} of the positions were lost"] if report.lost_frames else []
    problems += [f"{refused} frames were refused"] if refused else []
    held_up = "" if refused or report.garbage_bytes else ", and whether this machine was held up (`hapsim doctor`)"
    out.print(
        f"[yellow]{' and '.join(problems)}: look at cable, baud rate and interference{held_up}. `hapsim frames PORT`, "
        "while nothing runs, shows what arrives.[/yellow]"
    )


def _estimated_mass(report: Report, channel: int, mass: float) -> str:
    """Returns the mass with its uncertainty, and a note if the motion hardly shows it."""
    units = output_units(channel)
    if channel >= len(report.estimated_mass_uncertainty_kg):
        return units.number(mass, "kg", 4)  # a record of an earlier version
    uncertainty, explained = report.estimated_mass_uncertainty_kg[channel] or 0.0, report.mass_explained[channel] or 0.0
    note = ""
    if uncertainty > _MASS_KNOWN * mass:
        note = " [yellow](not known: no force moved the hand clearly, or others moved it more)[/yellow]"
    elif explained < _LITTLE_EXPLAINED:
        note = f" [yellow](the forces explain {_share(explained)} of the latest motion)[/yellow]"
    elif (age_s := dict(enumerate(report.mass_age_s)).get(channel) or 0.0) > _GRIP_S:
        note = f" [yellow](of {age_s:.3g} s before the end: no motion showed it later)[/yellow]"
    return f"{units.number(mass, 'kg', 4)} ± {units.number(uncertainty, 'kg', 2)}{note}"


def _share(share: float) -> str:
    return percent(share) if share < 0.995 else "Nearly all"


def _off_rate(report: Report) -> str:
    """Returns a note beside the kept rate if it certainly differs from the nominal rate."""
    asked, kept = report.nominal_rate_hz, kept_rate(report)
    if kept is None or not kept.differs_from(asked) or abs(kept.rate_hz / asked - 1.0) < _OFF_RATE:
        return ""
    return f" [yellow]({100.0 * kept.rate_hz / asked:.1f} % of {asked:g})[/yellow]"


def _spread_in_us(spread: Spread) -> str:
    if spread.p50 is None or spread.p99 is None or spread.max is None:
        return "–"
    return f"{spread.p50 * 1e6:.0f} median, {spread.p99 * 1e6:.0f} at 99 %, {spread.max * 1e6:.0f} maximum"


def lifetime_document(lifetime: Lifetime, grants: Sequence[PrivilegeResult] = ()) -> dict[str, Any]:
    """Returns the document of `hapsim run --json`: the report of all sessions, and the reconnections."""
    return {
        **pick(lifetime.report, "*"),
        **({"realtime": grants} if grants else {}),
        **pick(lifetime, "reconnections interruptions records sound_files"),
        **output.failure_document(lifetime.failure),
    }
