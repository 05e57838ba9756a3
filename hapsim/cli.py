"""The commands. They parse, call, and show; what they show is worked out elsewhere, and imported only when needed."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapsim.chart.commands import app as chart
from hapsim.console.guarded_output import guarded_output, is_full
from hapsim.errors import HapsimError, UsageError

if TYPE_CHECKING:
    from hapsim.cordis.explain import Explanation
    from hapsim.errors import RunError
    from hapsim.loop.trace import Report
    from hapsim.prediction import Prediction
    from hapsim.realtime import PrivilegeResult
    from hapsim.scene import Scene


_INTERRUPTED = 130


def _seconds(value: float | None) -> float | None:
    if value is not None and not 0 < value < float("inf"):
        raise UsageError(f"--duration: found {value:g}, expected a finite number of seconds above 0")
    return value


app = typer.Typer(
    name="hapsim",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(chart)


def _print_version(wanted: bool) -> None:
    if wanted:
        from hapsim.console.version import version_lines

        print("\n".join(version_lines()))
        raise typer.Exit()


@app.callback()
def _about_hapsim(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            is_eager=True,
            callback=_print_version,
            help="Print what a bug report needs.",
        ),
    ] = False,
) -> None:
    """A real-time haptic simulator that tells what stiffness and damping the hand really feels."""


SceneFile = Annotated[str, typer.Argument(metavar="SCENE", help="A scene in YAML, such as configs/first_touch.yaml.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on standard output, nothing else there.")]
Port = Annotated[str | None, typer.Option(metavar="P", help="The device's serial port, in place of the scene's.")]
MockFlag = Annotated[bool, typer.Option("--mock", help="Use the embedded mock even where the scene names a port.")]
TransportOption = Annotated[
    str | None, typer.Option(metavar="KIND", help="Where the mock is: 'loopback' (in memory) or 'terminal'.")
]


Realtime = Annotated[
    bool,
    typer.Option("--realtime", help="Ask the system for what makes a loop steady; tell what it granted and what not."),
]


@app.command()
def run(
    scene: SceneFile,
    port: Port = None,
    mock: MockFlag = False,
    transport: TransportOption = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", callback=_seconds, help="Seconds; left out: until stopped.")
    ] = None,
    record: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the trace: .npz or .csv.")] = None,
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

    loaded = _scene(scene, port)
    _require_writable(record=record)
    _predict_and_warn(loaded)
    error_console = _stderr()
    reporter = RunReporter(error_console, scene if watch else None, _predict_and_warn)
    failure: RunError | None = None
    try:
        with live_line(error_console) as tell:
            trace = run_scene(
                loaded,
                duration=duration,
                transport=_transport_kind(mock, transport, port),
                keep=record is not None,
                realtime=realtime,
                portable=portable,
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
            show_report(_stdout(), trace.report)
            _say(record=record)
    if failure is not None:
        _complain(failure)
        raise typer.Exit(failure.exit_status)


@app.command()
def check(
    scene: SceneFile,
    json: Json = False,
    explain: Annotated[
        bool,
        typer.Option("--explain", help="Compile the scene too: what is kept of it, what that costs."),
    ] = False,
) -> None:
    """Predict, without running: stable or not, what the hand will feel, every mode, the time that the wire takes."""
    from hapsim.prediction import predict

    loaded = _scene(scene)
    with _stderr().status("working out the modes and how much each link may grow"):
        prediction = predict(loaded)
    explanation = _explanation(loaded) if explain else None
    if json:
        from hapsim.console.as_json import document, prediction_document

        compiled = {} if explanation is None else {"compiled": explanation.as_document()}
        print(document({"scene": scene} | prediction_document(prediction) | compiled))
        return
    from hapsim.console.tables import show_prediction

    show_prediction(_stdout(), scene, prediction)
    if explanation is not None:
        from hapsim.console.explained import show_explanation

        show_explanation(_stdout(), explanation)


def _explanation(scene: Scene) -> Explanation:
    from hapsim.cordis.explain import explain

    with _stderr().status("compiling") as status:
        return explain(scene, lambda part: status.update(f"compiling and timing {part}"))


@app.command()
def measure(
    scene: SceneFile,
    port: Port = None,
    mock: MockFlag = False,
    transport: TransportOption = None,
    channel: Annotated[int | None, typer.Option(help="The channel whose hand is rung; left out: the first.")] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", callback=_seconds, help="Seconds; left out: about two.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw the ring-down: .svg, .png, .pdf.")] = None,
    data: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the picture's numbers: .csv.")] = None,
    record: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the trace: .npz or .csv.")] = None,
    json: Json = False,
) -> None:
    """Ring the hand, identify the spring and damper that it felt, and set them beside the prediction.

    It pushes the hand: now and then, to one side and the other, with up to a quarter of the scene's force_limit.
    """
    from hapsim.console.as_json import felt_on
    from hapsim.console.live import live_line
    from hapsim.measuring.measure import measure as measure_scene
    from hapsim.prediction import predict

    loaded = _scene(scene, port)
    _require_writable(picture, data, record)
    if channel is None:
        channel = next(iter(loaded.device_points.values())).channel
    prediction = predict(loaded, with_margins=False)
    felt = felt_on(prediction, channel)
    why = next((prediction.coupled.get(n, "") for n, p in loaded.device_points.items() if p.channel == channel), "")
    if felt is None and (picture is not None or data is not None):
        raise UsageError(
            f"a ring-down is drawn for a hand that is a spring and damper's alone; this one {why}: "
            "leave out --picture and --data"
        )
    _warn(loaded, prediction)
    with live_line(_stderr()) as tell:
        measurement = measure_scene(
            loaded,
            channel=channel,
            duration=duration,
            transport=_transport_kind(mock, transport, port),
            on_progress=tell,
            stop_on_signals=True,
        )
    if record is not None:
        measurement.trace.save(record)
    if picture is not None or data is not None:
        _chart_ring_down(felt, measurement, picture, data)
    if json:
        from hapsim.console.as_json import document, measurement_document

        print(document({"scene": scene} | measurement_document(prediction, measurement, channel)))
    else:
        from hapsim.console.tables import show_assumptions

        show_assumptions(_stdout(), prediction)
        _show_measured(loaded, channel, felt, why, measurement)
        _say(picture, data, record)


@app.command()
def doctor(
    scene: Annotated[
        str | None, typer.Argument(metavar="[SCENE]", help="Its device is tried; left out: the mock.")
    ] = None,
    port: Port = None,
    mock: MockFlag = False,
    seconds: Annotated[
        float, typer.Option(metavar="S", help="For each of its measurements; a longer one sees rarer gaps.")
    ] = 2.0,
    rates: Annotated[
        list[str] | None, typer.Option(metavar="HZ,…", help="Left out: 1000,2000,4000,10000 and the scene's.")
    ] = None,
    realtime: Realtime = False,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw the latenesses: .svg, .png, .pdf.")] = None,
    data: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the picture's numbers: .csv.")] = None,
    json: Json = False,
) -> None:
    """Tell how steady this machine is for a haptic loop, which rates it keeps, and what would help.

    A device that is tried feels no force: the scene runs without its links, every force cut to zero.
    """
    from hapsim.console.doctor import examination_document, examination_line, show_examination
    from hapsim.console.options import numbers
    from hapsim.doctor.examine import RATES_HZ, examine

    if port is not None and scene is None:
        raise UsageError("--port: found no SCENE, expected the scene whose device is at that port")
    _require_writable(picture, data)
    with examination_line(_stderr()) as tell:
        found = examine(
            None if scene is None else _scene(scene, port),
            seconds=seconds,
            rates=tuple(numbers("--rates", rates)) or RATES_HZ,
            realtime=realtime,
            transport=_transport_kind(mock, None, port),
            on_progress=tell,
        )
    if picture is not None or data is not None:
        from hapsim.chart.figure import save_rows
        from hapsim.chart.steadiness import columns, draw_steadiness, steadiness

        curves = steadiness(found)
        if data is not None:
            save_rows(columns(curves), data)
        if picture is not None:
            draw_steadiness(curves, f"How steady this machine is: {found.scene}, {seconds:g} s each", picture)
    if json:
        from hapsim.console.as_json import document

        print(document(examination_document(found)))
    else:
        show_examination(_stdout(), found)
        _say(picture, data)
    if found.device_failed is not None:
        raise typer.Exit(found.device_failed.exit_status)


@app.command()
def mock(
    scene: SceneFile,
    link: Annotated[Path | None, typer.Option(metavar="PATH", help="Also give the port this name (a link).")] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Keep time as hardware does: before every program, where permitted.")
    ] = False,
    json: Json = False,
) -> None:
    """Serve the scene's mock device on a pseudo-terminal of its own; print its path; serve until told to stop."""
    from hapsim.console.live import live_line
    from hapsim.device.mock.command import serve_until_stopped

    loaded = _scene(scene)
    with live_line(_stderr()) as tell:
        serve_until_stopped(loaded, link, _announce_json if json else _announce, tell, realtime)


@app.command("compile")
def compile_(
    scenes: Annotated[
        list[str] | None, typer.Argument(metavar="[SCENE]…", help="What these need; left out: what any scene could.")
    ] = None,
    json: Json = False,
) -> None:
    """Compile now what would be compiled at a first start; it is kept, and nothing is armed or moved."""
    from hapsim.console.live import live_line
    from hapsim.running.preparing import prepare

    loaded = [_scene(path) for path in scenes or ()]
    with live_line(_stderr()) as tell:
        prepared = prepare(loaded, tell)
    if json:
        from hapsim.console.as_json import document

        kept = None if prepared.directory is None else str(prepared.directory)
        print(document({"functions": prepared.functions, "seconds": prepared.seconds, "directory": kept}))
    elif prepared.directory is None:
        print("Compiled, but there is no place to keep it: set XDG_CACHE_HOME to a directory that can be written to.")
    elif prepared.functions:
        print(f"Compiled {prepared.functions} functions in {prepared.seconds:.1f} s; kept in {prepared.directory}")
    else:
        print(f"Nothing to compile: everything is kept in {prepared.directory}")


@app.command()
def ports(json: Json = False) -> None:
    """List the serial ports found."""
    from hapsim.device.serial_port import serial_ports

    found = serial_ports()
    if json:
        from hapsim.console.as_json import document

        print(document({"ports": found}))
        return
    for port in found:
        print(f"{port['port']}\t{port['description']}\t{port['hardware']}")
    if not found:
        _stderr().print("No serial port was found. `hapsim mock SCENE` serves a device without hardware.")


@app.command()
def new(path: Annotated[Path, typer.Argument(help="Where to write it.")] = Path("scene.yaml")) -> None:
    """Write a first scene to begin from."""
    from hapsim.shipped import shipped_scene

    if path.exists():
        raise UsageError(f"{path}: there is a file already, and it stays as it is; name another")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"{path}: there is no directory {path.resolve().parent}")
    path.write_text(shipped_scene("first_touch.yaml"), encoding="utf-8")
    print(f"Wrote {path}. Next: hapsim check {path}, then hapsim measure {path}")


@app.command()
def schema() -> None:
    """Print the scene's JSON schema, for editors that complete and check YAML."""
    import json as json_text

    from hapsim.scene import scene_schema

    print(json_text.dumps(scene_schema(), indent=2))


@guarded_output()
def main() -> None:
    """The command line: every failure is a sentence and an exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that cannot show a character shows another
    try:
        app()
    except HapsimError as error:
        _complain(error)
        sys.exit(error.exit_status)
    except SystemExit as ending:
        if ending.code == _INTERRUPTED:  # typer has taken the interrupt, and says nothing
            print("hapsim: stopped before anything was running", file=sys.stderr)
        if "hapsim.realtime.giving_way" in sys.modules and isinstance(ending.code, int | None):
            sys.modules["hapsim.realtime.giving_way"].leave_unfinished(ending.code or 0)
        raise
    except Exception as error:
        if isinstance(error, BrokenPipeError) or is_full(error) or os.environ.get("HAPSIM_TRACEBACK"):
            raise
        print(
            f"hapsim: a defect of hapsim itself: {type(error).__name__}: {error}\n"
            "Please report it; with HAPSIM_TRACEBACK=1 in the environment it says where.",
            file=sys.stderr,
        )
        sys.exit(1)


def _predict_and_warn(scene: Scene) -> None:
    from hapsim.prediction import predict

    _warn(scene, predict(scene, with_margins=False))


def _warn(scene: Scene, prediction: Prediction) -> None:
    """Says before a run what its prediction has against it: the hand should know what is coming."""
    from hapsim.prediction import warnings_about

    for warning in warnings_about(scene, prediction):
        print(f"Warning: {warning}", file=sys.stderr)


def _scene(path: str, port: str | None = None) -> Scene:
    from hapsim.scene import load_scene

    scene = load_scene(path)
    if port is None:
        return scene
    return scene.model_copy(update={"device": scene.device.model_copy(update={"port": port})})


def _transport_kind(mock: bool, transport: str | None, port: str | None) -> Any:
    if port is not None and (mock or transport is not None):
        raise UsageError("--port names a device, --mock and --transport the mock: found both, expected one of them")
    if transport is not None and transport not in ("loopback", "terminal"):
        raise UsageError(f"--transport: found '{transport}', expected loopback or terminal")
    return transport or ("mock" if mock else "auto")


def _require_writable(picture: Path | None = None, data: Path | None = None, record: Path | None = None) -> None:
    """UsageError where one of the files could not be written: better before the run than after it."""
    if picture is not None or data is not None:
        from hapsim.chart.figure import require_writable

        require_writable(picture)
        require_writable(data, (".csv",))
    if record is not None:
        from hapsim.loop.trace import require_writable_as_trace

        require_writable_as_trace(record)


def _say(picture: Path | None = None, data: Path | None = None, record: Path | None = None) -> None:
    """Which files were written."""
    for what, path in (("Picture", picture), ("Its numbers", data), ("Trace", record)):
        if path is not None:
            print(f"{what}: {path}")


def _print_run(report: Report, grants: list[PrivilegeResult], failure: RunError | None) -> None:
    from hapsim.console.as_json import document, report_document

    problem = {} if failure is None else {"error": str(failure), "exit_status": failure.exit_status}
    print(document(report_document(report, grants) | problem))


def _show_measured(scene: Scene, channel: int, felt: Any, why: str, measurement: Any) -> None:
    from hapsim.console.tables import show_measurement, show_report

    hands = {point.channel: name for name, point in scene.device_points.items()}
    show_measurement(_stdout(), f"{hands[channel]}, channel {channel}", felt, why, measurement)
    others = ", ".join(f"--channel {c} for {name}" for c, name in hands.items() if c != channel)
    if others:
        print(f"Other hands of this scene: {others}.")
    show_report(_stdout(), measurement.trace.report)


def _chart_ring_down(felt: Any, measurement: Any, picture: Path | None, data: Path | None) -> None:
    from hapsim.chart.figure import save_columns
    from hapsim.chart.ring_down import draw_ring_down, ring_down

    drawn = ring_down(measurement.trace, felt)
    if data is not None:
        save_columns(drawn.columns(), data)
    if picture is not None:
        draw_ring_down(drawn, felt, (measurement.k, measurement.b), picture)


def _announce(path: str) -> None:
    print(path, flush=True)


def _announce_json(path: str) -> None:
    from hapsim.console.as_json import document

    print(document({"port": path}), flush=True)


def _complain(error: HapsimError) -> None:
    # Plain, not through rich: a sentence with a path in it is to be copied, not wrapped.
    print(error, file=sys.stderr)


def _stdout() -> Any:
    from rich.console import Console

    return Console(highlight=False)


def _stderr() -> Any:
    from rich.console import Console

    return Console(stderr=True, highlight=False)
