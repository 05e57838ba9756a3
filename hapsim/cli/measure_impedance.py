"""`hapsim measure --impedance`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table

from hapsim.cli.as_json import document
from hapsim.cli.live import live_line
from hapsim.cli.options import DeviceOptions, RecordOptions, require_drawable, say_written
from hapsim.cli.output import complain, stderr, stdout
from hapsim.cli.run import predict_before_arming
from hapsim.errors import UsageError
from hapsim.measuring.measure_impedance import TRAVEL_M, StoppedError, walls_in_place
from hapsim.measuring.measure_impedance import measure_impedance as measure
from hapsim.prediction.impedance import (
    PredictedImpedance,
    ZWidth,
    decades_of,
    mean_width,
    predict_impedance,
    width_db,
    z_width_of,
)
from hapsim.stopping import INTERRUPTED, ignore_stops

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.measuring.measure_impedance import MeasuredImpedance
    from hapsim.recording.trace import Trace
    from hapsim.scene import Scene

_WALL_PERIODS = 14
_STOPPED = "hapsim: stopped early: the impedance is of the periods recorded until then"


def measure_impedance(
    device: DeviceOptions,
    channel: int | None,
    duration: float | None,
    push: float | None,
    travel: float | None,
    z_width: bool,
    picture: Path | None,
    data: Path | None,
    record: RecordOptions,
    unstable: bool,
    json: bool,
) -> None:
    """Excites each device point, and prints the impedance that it identifies beside the prediction."""
    scene = device.load()
    require_drawable(picture, data)
    place = _place(scene, channel)
    record.require_writable()
    predict_before_arming(device.scene, scene, unstable)
    options: dict[str, Any] = {"duration": duration, "push": push, "transport": device.kind(), "stop_on_signals": True}
    options["travel"] = TRAVEL_M if travel is None else travel
    with live_line(stderr()) as tell:
        options["on_progress"] = tell
        try:
            measured = measure(scene, **options)
        except StoppedError as stopped:
            if record.record is not None:
                _save_traces(tuple(range(len(stopped.traces))), stopped.traces, record.record)
            raise
        predicted = predict_impedance(scene, measured.frequency)
        widths = [z_width_of(scene, one, measured.frequency) for one in measured.channels]
        walls = _walls(scene, measured, widths, options) if z_width and not measured.stopped else {}
    if record.record is not None:
        _save_traces(measured.channels, measured.traces, record.record)
    _chart(scene, predicted, measured, place, picture, data)
    if json:
        early = {"error": _STOPPED, "exit_status": INTERRUPTED} if measured.stopped else {}
        print(document({"scene": device.scene} | impedance_document(predicted, measured, widths, walls) | early))
    else:
        shown = list(range(len(predicted.names))) if place is None else [place]
        show_impedance(stdout(), predicted, measured, shown)
        show_z_widths(stdout(), predicted, measured.channels, widths, walls)
        say_written(picture, data, record.record)
    if measured.stopped:
        ignore_stops()
        complain(_STOPPED)
        raise typer.Exit(INTERRUPTED)


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


def _chart(
    scene: Scene, predicted: Any, measured: Any, place: int | None, picture: Path | None, data: Path | None
) -> None:
    if data is not None:
        from hapsim.chart.figure import save_rows
        from hapsim.chart.impedance import columns

        save_rows(columns(predicted, measured), data)
    if picture is not None:
        from hapsim.chart.impedance import draw_impedance

        draw_impedance(scene, predicted, measured, place, picture)


def _save_traces(channels: tuple[int, ...], traces: tuple[Trace, ...], path: Path) -> None:
    """One file; of several channels one each, with the channel's number before the ending."""
    for channel, trace in zip(channels, traces, strict=True):
        name = path if len(channels) == 1 else path.with_name(f"{path.stem}.{channel}{path.suffix}")
        trace.save(name)


_ROWS = 12  # of the frequencies, in a table
_UNSURE = 0.1

ZWidths = dict[str, ZWidth]


def show_impedance(out: Console, predicted: PredictedImpedance, measured: MeasuredImpedance, shown: list[int]) -> None:
    """Prediction beside measurement, a table for each of the device points ``shown`` (by their place in the scene)."""
    for i in shown:
        for name, words in (("rendered", "Rendered impedance"), ("closed_loop", "Closed loop's impedance")):
            out.print()
            out.print(_table(predicted, measured, i, name, words))
    out.print()
    for assumption in predicted.assumptions:
        out.print(f"[yellow]Assumed:[/yellow] {escape(assumption)}.")
    for sentence in _sentences(predicted, measured):
        out.print(sentence)


def _table(predicted: PredictedImpedance, measured: MeasuredImpedance, i: int, name: str, words: str) -> Table:
    where = f"{predicted.names[i]}, channel {measured.channels[i]}"
    table = Table(title=f"{words} at {escape(where)}, N·s/m", title_justify="left")
    for heading in ("f  Hz", "desired", "predicted", "measured", "±"):
        table.add_column(heading, justify="right")
    desired = predicted.desired + (predicted.ideal_device if name == "closed_loop" else 0.0)
    circles = getattr(measured, name)
    for n in np.unique(np.rint(np.linspace(0, predicted.frequency.size - 1, _ROWS)).astype(int)):
        values = (desired, getattr(predicted, name), circles.value)
        cells = [_size_and_turn(complex(value[n, i, i])) for value in values]
        table.add_row(f"{predicted.frequency[n]:.4g}", *cells, f"{circles.uncertainty[n, i, i]:.1g}")
    return table


def _size_and_turn(impedance: complex) -> str:
    return f"{abs(impedance):.5g} ∠ {np.degrees(np.angle(impedance)):.1f}°"


def _sentences(predicted: PredictedImpedance, measured: MeasuredImpedance) -> list[str]:
    """How far prediction and measurement are apart, what was done, and what to beware of."""
    found = []
    for name, words in (("rendered", "rendered"), ("closed_loop", "closed-loop"), ("device", "device's own")):
        most = float(np.max(off_by(predicted, measured, name)))
        found.append(
            f"The {words} impedance: prediction and measurement agree within the uncertainty at all "
            f"{predicted.frequency.size} frequencies, at most {most:.2g} of it apart."
            if most <= 1.0
            else f"[yellow]The {words} impedance: prediction and measurement do not agree: "
            f"{_apart(predicted, measured, name)}[/yellow]"
        )
    found.append(
        "± is the radius of the circle about a measured value that holds the true one, all of them together with "
        "99.9 %. Rendered: what the scene presents, late and held; closed loop: that and the device's own mass, "
        "friction and spring, which is what the hand feels."
    )
    for channel, force, travel, periods in zip(
        measured.channels, measured.peak_force, measured.travel, measured.periods, strict=True
    ):
        found.append(
            f"Channel {channel} was excited with up to {force:.3g} N, which moved it by {travel * 1e3:.3g} mm; "
            f"{periods + 1} periods of {measured.period_s:.3g} s count."
        )
    return found + [f"[yellow]{sentence}[/yellow]" for sentence in cautions(predicted, measured)]


def cautions(predicted: PredictedImpedance, measured: MeasuredImpedance) -> list[str]:
    """Sentences: what limits the meaning of the numbers; none where nothing does."""
    found = []
    if predicted.assumptions:
        found.append(
            "Not everything in this scene is linear: measured is the impedance about the motion to which it was "
            "excited, and for that motion only; predicted is that of what was assumed."
        )
    unsure = measured.closed_loop.uncertainty > _UNSURE * np.abs(measured.closed_loop.value)
    some = np.flatnonzero(np.any(np.diagonal(unsure, axis1=1, axis2=2), axis=1))
    if some.size:
        found.append(
            f"Of the closed loop's impedance more than a tenth is uncertain at {some.size} of "
            f"{predicted.frequency.size} frequencies, the first {predicted.frequency[some[0]]:.4g} Hz: there the "
            "motion, or at a resonance the force, is small beside counts and noise. More force (force_limit), more "
            "--travel or a longer --duration helps."
        )
    if measured.limited_samples:
        found.append(
            f"The force was cut to its limit in {measured.limited_samples} samples: there the loop did not answer in "
            "proportion."
        )
    if measured.lost_periods:
        found.append(f"{measured.lost_periods} periods were left out: positions of them never came.")
    seen = measured.seen_rate
    if seen is not None and measured.traces and seen.differs_from(measured.traces[0].rate):
        found.append(
            f"The device sampled at {seen.rate_hz:.6g} ± {seen.uncertainty_hz:.2g} Hz and not at "
            f"{measured.traces[0].rate:g}: every frequency here is as much off, and the device's delay with it."
        )
    return found


def _apart(predicted: PredictedImpedance, measured: MeasuredImpedance, name: str) -> str:
    """Where two are farthest apart, in uncertainties, and how far."""
    off = off_by(predicted, measured, name)
    at = np.unravel_index(int(np.argmax(off)), off.shape)
    there, said = getattr(measured, name).value[at], getattr(predicted, name)[at]
    return f"at {predicted.frequency[at[0]]:.4g} Hz {abs(there - said):.3g} N·s/m, {off[at]:.2g} times the uncertainty."


def off_by(predicted: PredictedImpedance, measured: MeasuredImpedance, name: str) -> Any:
    """(n, C, C): how far the two are apart, over the stated uncertainty."""
    circles = getattr(measured, name)
    apart = np.abs(circles.value - getattr(predicted, name))
    return np.divide(apart, circles.uncertainty, out=np.zeros_like(apart), where=apart > 0.0)


def show_z_widths(
    out: Console, predicted: PredictedImpedance, channels: tuple[int, ...], widths: list[ZWidths], walls: Any
) -> None:
    """The device's Z-width at each point, predicted, and measured where ``walls`` (by channel) has it."""
    bands = next(iter(widths[0].values())).decades()
    table = Table(title="Z-width: from the device alone to its stiffest wall, mean dB", title_justify="left")
    for heading in ("at", "wall"):
        table.add_column(heading)
    for heading in ("K  N/m", "B  N·s/m", "all", *(f"{low:.3g} to {high:.3g} Hz" for low, high, _ in bands)):
        table.add_column(heading, justify="right")
    for i, by_kind in enumerate(widths):
        for kind, width in by_kind.items():
            wall = [f"{width.wall.stiffness:.6g}", f"{width.wall.damping:.4g}"]
            table.add_row(escape(predicted.names[i]), kind, *wall, *_means(width.frequency, width.width_db))
            if kind == "passive" and channels[i] in walls:
                found = walls[channels[i]]
                table.add_row("", "measured", "", "", *_means(width.frequency, found.width_db))
                table.add_row("", "±", "", "", *_means(width.frequency, found.uncertainty_db, ".1g"))
    out.print()
    out.print(table)


def _means(frequency: Any, width: Any, form: str = ".2f") -> list[str]:
    """Of all frequencies, and of each decade."""
    means = [mean_width(frequency, width), *(mean for _, _, mean in decades_of(frequency, width))]
    return [f"{mean:{form}}" for mean in means]


class MeasuredWidth(NamedTuple):
    """(n,) dB: the Z-width between the device and its wall, both measured, and how far off it may be."""

    width_db: Any
    uncertainty_db: Any


def measured_width(measured: MeasuredImpedance, i: int, wall: MeasuredImpedance) -> MeasuredWidth:
    """Of the device point at place ``i``: the device as it was measured with the scene, and with it what was measured
    that the wall renders in the scene's place. (A hand on its stiffest passive wall hardly comes to rest: of the device
    that record tells less.)"""
    device, rendered = ((one.value[:, i, i], one.uncertainty[:, i, i]) for one in (measured.device, wall.rendered))
    with_wall = device[0] + rendered[0]
    share = device[1] / np.abs(device[0]) + (device[1] + rendered[1]) / np.abs(with_wall)
    return MeasuredWidth(width_db(device[0], with_wall), 20.0 * np.log10(1.0 + share))


def impedance_document(
    predicted: PredictedImpedance, measured: MeasuredImpedance, widths: list[ZWidths], walls: Any
) -> dict[str, Any]:
    """What `hapsim measure --impedance --json` prints beside the scene; matrices are (frequencies, C, C), complex
    numbers [re, im], N·s/m."""
    names = ("device", "rendered", "closed_loop")
    return {
        "impedance": {
            "frequency_hz": predicted.frequency,
            "device_points": predicted.names,
            "channels": measured.channels,
            "desired": predicted.desired,
            "predicted": {name: getattr(predicted, name) for name in names},
            "measured": {name: getattr(measured, name)._asdict() for name in names},
            "off_by_uncertainties": {name: float(np.max(off_by(predicted, measured, name))) for name in names},
            "confidence": 0.999,
            "period_s": measured.period_s,
            "periods": [pairs + 1 for pairs in measured.periods],
            "peak_force_n": measured.peak_force,
            "travel_m": measured.travel,
            "lost_periods": measured.lost_periods,
            "limited_samples": measured.limited_samples,
            "assumptions": predicted.assumptions,
            "cautions": cautions(predicted, measured),
        },
        "z_width": {
            name: {kind: _width_document(width, _measured(walls, channel, kind)) for kind, width in by_kind.items()}
            for name, channel, by_kind in zip(predicted.names, measured.channels, widths, strict=True)
        },
    }


def _measured(walls: Any, channel: int, kind: str) -> Any:
    return walls.get(channel) if kind == "passive" else None


def _width_document(width: ZWidth, measured: Any) -> dict[str, Any]:
    def told(values: Any) -> dict[str, Any]:
        return {
            "mean_db": mean_width(width.frequency, values),
            "decades": [
                {"from_hz": low, "to_hz": high, "mean_db": mean}
                for low, high, mean in decades_of(width.frequency, values)
            ],
            "width_db": values,
        }

    return {
        "stiffness": width.wall.stiffness,
        "damping": width.wall.damping,
        "predicted": told(width.width_db),
        "measured": None
        if measured is None
        else told(measured.width_db)
        | {
            "uncertainty_db": measured.uncertainty_db,
            "mean_uncertainty_db": mean_width(width.frequency, measured.uncertainty_db),
        },
    }
