"""`hapsim measure`, of k and b."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer

from hapsim.cli.arguments import (
    Files,
    as_played,
    complain,
    load,
    require_files_writable,
    require_stable,
    say_written,
    stderr,
    stdout,
    warn,
)
from hapsim.cli.sentences import say
from hapsim.errors import RunError, UsageError

if TYPE_CHECKING:
    from hapsim.prediction import Prediction
    from hapsim.recording.trace import Trace
    from hapsim.scene import Scene


def measure_pair(
    path: str,
    port: str | None,
    kind: Any,
    channel: int | None,
    duration: float | None,
    files: Files,
    unstable: bool,
    json: bool,
) -> None:
    """Rings a hand, and sets the k and b that it identifies beside the prediction."""
    from hapsim.cli.as_json import felt_on
    from hapsim.cli.live import live_line
    from hapsim.measuring.measure import measure as measure_scene
    from hapsim.prediction import predict, predict_on_wire, with_mass

    loaded = as_played(load(path, port), kind)
    require_files_writable(*files)
    if channel is None:
        channel = next(iter(loaded.device_points.values())).channel
    prediction = predict(loaded, with_margins=False)
    on_wire = None if prediction.wire_of == "none" else predict_on_wire(loaded)
    felt = felt_on(prediction, channel)
    why = next((prediction.coupled.get(n, "") for n, p in loaded.device_points.items() if p.channel == channel), "")
    _require_drawable(felt, why, files.picture, files.data)
    require_stable(path, loaded, prediction, unstable)
    warnings = warn(loaded, prediction)
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
        _tell_failed(path, prediction, channel, error, error.trace, files.record, json)
    prediction = with_mass(prediction, channel, measurement.mass)
    felt = felt_on(prediction, channel)
    if files.record is not None:
        measurement.trace.save(files.record)
    if files.picture is not None or files.data is not None:
        _chart_ring_down(felt, measurement, files.picture, files.data)
    if json:
        from hapsim.cli.as_json import document, measurement_document

        measured = measurement_document(prediction, measurement, channel, on_wire)
        print(document({"scene": path, "warnings": warnings} | measured))
    else:
        _show_measured(loaded, channel, felt, why, measurement, prediction, on_wire)
        say_written(*files)
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
        from hapsim.cli.as_json import document, measured_document

        print(document({"scene": scene} | measured_document(prediction, trace.report, channel, error)))
    else:
        from hapsim.cli.tables import show_report

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
    from hapsim.cli.prediction import show_assumptions
    from hapsim.cli.tables import show_measurement, show_report
    from hapsim.cli.wire import show_wire

    show_assumptions(stdout(), prediction)
    hands = {point.channel: name for name, point in scene.device_points.items()}
    least, most = scene.device.mass_spans(scene.channels)[channel]
    of_mass = "estimated" if any(measurement.trace.report.estimated_mass_kg) else "assumed"
    if least < most:
        whose = "the estimated mass" if of_mass == "estimated" else "the middle of the span"
        say(
            f"k and b are those of a hand of {measurement.mass:.6g} kg, {whose} of {least:g} to {most:g} kg; they grow "
            "with the mass."
        )
    else:
        of_mass = "declared"
    desired = next((one for one in prediction.desired if one.channel == channel), None)
    where = f"{hands[channel]}, channel {channel}"
    show_measurement(stdout(), where, felt, why, measurement, desired, prediction=prediction, of_mass=of_mass)
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
