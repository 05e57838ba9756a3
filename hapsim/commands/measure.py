"""`hapsim measure`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from hapsim.commands.arguments import (
    Data,
    Files,
    Json,
    MockFlag,
    Port,
    Record,
    SceneFile,
    TransportOption,
    Unstable,
    as_played,
    complain,
    load,
    require_files_writable,
    require_stable,
    say_written,
    seconds_above_zero,
    stderr,
    stdout,
    transport_kind,
    warn,
)
from hapsim.console.sentences import say
from hapsim.errors import RunError, UsageError

if TYPE_CHECKING:
    from hapsim.loop.trace import Trace
    from hapsim.prediction import Prediction
    from hapsim.scene import Scene


def measure(
    scene: SceneFile,
    port: Port = None,
    mock: MockFlag = False,
    transport: TransportOption = None,
    channel: Annotated[
        int | None,
        typer.Option(help="The channel whose hand is rung, or whose impedance is shown; left out: the first, or all."),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            callback=seconds_above_zero,
            help="Seconds; left out: about two, or with --impedance eight for each channel.",
        ),
    ] = None,
    impedance: Annotated[
        bool,
        typer.Option("--impedance", help="Measure the driving-point impedance over frequency, in place of k and b."),
    ] = False,
    travel: Annotated[
        float | None,
        typer.Option(metavar="M", help="With --impedance: how far a hand is moved at most, about, in m: 0.001."),
    ] = None,
    z_width: Annotated[
        bool,
        typer.Option("--z-width", help="With --impedance: put the stiffest passive wall in the scene's place, too."),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the ring-down, or the impedance: .svg, .png, .pdf.")
    ] = None,
    data: Data = None,
    record: Record = None,
    unstable: Unstable = False,
    json: Json = False,
) -> None:
    """Ring the hand, identify the spring and damper that it felt, and set them beside the prediction.

    It pushes the hand: now and then, to one side and the other, with up to a quarter of the scene's force_limit.
    With --impedance it excites each channel in turn by many frequencies at once, with as much.
    """
    if impedance:
        from hapsim.commands.measure_impedance import measure_impedance

        files = Files(picture, data, record)
        place = transport_kind(mock, transport, port)
        measure_impedance(scene, port, place, channel, duration, travel, z_width, files, unstable, json)
        return
    if travel is not None or z_width:
        raise UsageError("--travel and --z-width go with --impedance: it is missing")
    from hapsim.console.as_json import felt_on
    from hapsim.console.live import live_line
    from hapsim.measuring.measure import measure as measure_scene
    from hapsim.prediction import predict, predict_on_wire, with_mass

    kind = transport_kind(mock, transport, port)
    loaded = as_played(load(scene, port), kind)
    require_files_writable(picture, data, record)
    if channel is None:
        channel = next(iter(loaded.device_points.values())).channel
    prediction = predict(loaded, with_margins=False)
    on_wire = None if prediction.wire_of == "none" else predict_on_wire(loaded)
    felt = felt_on(prediction, channel)
    why = next((prediction.coupled.get(n, "") for n, p in loaded.device_points.items() if p.channel == channel), "")
    _require_drawable(felt, why, picture, data)
    require_stable(scene, loaded, prediction, unstable)
    warn(loaded, prediction)
    try:
        with live_line(stderr()) as tell:
            measurement = measure_scene(
                loaded,
                channel=channel,
                duration=duration,
                transport=kind,
                on_progress=tell,
                stop_on_signals=True,
            )
    except RunError as error:
        if error.trace is None:
            raise
        _tell_failed(scene, prediction, channel, error, error.trace, record, json)
    prediction = with_mass(prediction, channel, measurement.mass)
    felt = felt_on(prediction, channel)
    if record is not None:
        measurement.trace.save(record)
    if picture is not None or data is not None:
        _chart_ring_down(felt, measurement, picture, data)
    if json:
        from hapsim.console.as_json import document, measurement_document

        print(document({"scene": scene} | measurement_document(prediction, measurement, channel, on_wire)))
    else:
        _show_measured(loaded, channel, felt, why, measurement, prediction, on_wire)
        say_written(picture, data, record)
    if measurement.failure is not None:
        complain(measurement.failure)
        raise typer.Exit(measurement.failure.exit_status)


def _tell_failed(
    scene: str, prediction: Prediction, channel: int, error: RunError, trace: Trace, record: Path | None, json: bool
) -> NoReturn:
    """Of a run that failed before anything could be identified: how it went, what was predicted, and why."""
    if record is not None:
        trace.save(record)
    if json:
        from hapsim.console.as_json import document, measured_document

        print(document({"scene": scene} | measured_document(prediction, trace.report, channel, error)))
    else:
        from hapsim.console.tables import show_report

        show_report(stdout(), trace.report)
        say_written(record=record)
    complain(error)
    raise typer.Exit(error.exit_status)


def _require_drawable(felt: Any, why: str, *files: Path | None) -> None:
    if felt is None and any(files):
        raise UsageError(
            f"a ring-down is drawn for a hand that is a spring and damper's alone; this one {why}: "
            "leave out --picture and --data"
        )


def _show_measured(
    scene: Scene,
    channel: int,
    felt: Any,
    why: str,
    measurement: Any,
    prediction: Prediction,
    on_wire: Prediction | None,
) -> None:
    from hapsim.console.tables import show_assumptions, show_measurement, show_report
    from hapsim.console.wire import show_wire

    show_assumptions(stdout(), prediction)
    hands = {point.channel: name for name, point in scene.device_points.items()}
    least, most = scene.device.mass_spans(scene.channels)[channel]
    if least < most:
        whose = "the estimated mass" if measurement.trace.report.estimated_mass_kg else "the middle of the span"
        say(
            f"k and b are those of a hand of {measurement.mass:.6g} kg, {whose} of {least:g} to {most:g} kg; they grow "
            "with the mass."
        )
    desired = next((one for one in prediction.desired if one.channel == channel), None)
    show_measurement(stdout(), f"{hands[channel]}, channel {channel}", felt, why, measurement, desired)
    others = ", ".join(f"--channel {c} for {name}" for c, name in hands.items() if c != channel)
    if others:
        say(f"Other hands of this scene: {others}.")
    show_report(stdout(), measurement.trace.report)
    if on_wire is not None:
        show_wire(stdout(), prediction, on_wire)


def _chart_ring_down(felt: Any, measurement: Any, picture: Path | None, data: Path | None) -> None:
    from hapsim.chart.figure import save_columns
    from hapsim.chart.ring_down import draw_ring_down, ring_down

    drawn = ring_down(measurement.trace, felt)
    if data is not None:
        save_columns(drawn.columns(), data)
    if picture is not None:
        draw_ring_down(drawn, felt, (measurement.k, measurement.b), picture)
