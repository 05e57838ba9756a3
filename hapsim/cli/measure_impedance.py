"""`hapsim measure --impedance`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapsim.cli.arguments import (
    Files,
    complain,
    load,
    predict_before_arming,
    require_files_writable,
    say_written,
    stderr,
    stdout,
)
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.recording.trace import Trace
    from hapsim.scene import Scene

_WALL_PERIODS = 14


def measure_impedance(
    path: str,
    port: str | None,
    transport: Any,
    channel: int | None,
    duration: float | None,
    travel: float | None,
    z_width: bool,
    files: Files,
    unstable: bool,
    json: bool,
) -> None:
    """Excites each device point, and sets the impedance that it identifies beside the prediction."""
    from hapsim.cli.live import live_line
    from hapsim.measuring.measure_impedance import TRAVEL_M
    from hapsim.measuring.measure_impedance import measure_impedance as measure
    from hapsim.prediction.impedance import predict_impedance, z_width_of

    scene = load(path, port)
    require_files_writable(*files)
    place = _place(scene, channel)
    predict_before_arming(path, scene, unstable)
    options: dict[str, Any] = {"duration": duration, "transport": transport, "stop_on_signals": True}
    options["travel"] = TRAVEL_M if travel is None else travel
    with live_line(stderr()) as tell:
        options["on_progress"] = tell
        measured = measure(scene, **options)
        predicted = predict_impedance(scene, measured.frequency)
        widths = [z_width_of(scene, one, measured.frequency) for one in measured.channels]
        walls = _walls(scene, measured, widths, options) if z_width else {}
    if files.record is not None:
        _save_traces(measured.channels, measured.traces, files.record)
    _chart(scene, predicted, measured, place, files)
    if json:
        from hapsim.cli.as_json import document
        from hapsim.cli.impedance import impedance_document

        print(document({"scene": path} | impedance_document(predicted, measured, widths, walls)))
        return
    from hapsim.cli.impedance import show_impedance, show_z_widths

    shown = list(range(len(predicted.names))) if place is None else [place]
    show_impedance(stdout(), predicted, measured, shown)
    show_z_widths(stdout(), predicted, measured.channels, widths, walls)
    say_written(files.picture, files.data, files.record)


def _place(scene: Scene, channel: int | None) -> int | None:
    """Which of the scene's device points, in its order; None for all."""
    channels = [point.channel for point in scene.device_points.values()]
    if channel is None:
        return None
    if channel not in channels:
        known = ", ".join(map(str, channels))
        raise UsageError(f"--channel {channel}: the scene has nothing there; its device points are on: {known}")
    return channels.index(channel)


def _walls(scene: Scene, measured: Any, widths: list[Any], options: dict[str, Any]) -> dict[int, Any]:
    """By channel, of those where a wall is passive: the Z-width, measured."""
    from hapsim.cli.impedance import measured_width
    from hapsim.measuring.measure_impedance import measure_impedance as measure
    from hapsim.measuring.measure_impedance import walls_in_place

    walls = {
        channel: tuple(by_kind["passive"].wall)
        for channel, by_kind in zip(measured.channels, widths, strict=True)
        if "passive" in by_kind and by_kind["passive"].wall.stiffness > 0.0
    }
    without = [str(channel) for channel in measured.channels if channel not in walls]
    if without:
        which = f"channel {without[0]}" if len(without) == 1 else f"channels {', '.join(without)}"
        complain(f"{which}: no wall is passive there, or it is not derived; its Z-width is not measured")
    if not walls:
        return {}
    long_enough = {"duration": options["duration"] or _WALL_PERIODS * measured.period_s}
    with_walls = measure(walls_in_place(scene, walls), **(options | long_enough))
    return {one: measured_width(measured, i, with_walls) for i, one in enumerate(measured.channels) if one in walls}


def _chart(scene: Scene, predicted: Any, measured: Any, place: int | None, files: Files) -> None:
    if files.data is not None:
        from hapsim.chart.figure import save_rows
        from hapsim.chart.impedance import columns

        save_rows(columns(predicted, measured), files.data)
    if files.picture is not None:
        from hapsim.chart.impedance import draw_impedance

        draw_impedance(scene, predicted, measured, place, files.picture)


def _save_traces(channels: tuple[int, ...], traces: tuple[Trace, ...], path: Path) -> None:
    """One file; of several channels one each, with the channel's number before the ending."""
    for channel, trace in zip(channels, traces, strict=True):
        name = path if len(channels) == 1 else path.with_name(f"{path.stem}.{channel}{path.suffix}")
        trace.save(name)
