"""`hapsim measure --hands` and `--impedance`: stiffness, damping and impedance at several device points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import typer
from rich.markup import escape

from hapsim.cli.before_arming import predict_before_arming, print_warnings, require_stable
from hapsim.cli.check_details import assumption_lines
from hapsim.cli.command_options import hand_channel
from hapsim.cli.measure_remarks import of_mock
from hapsim.cli.output import Table, compared, document, output_units, print_message, show, stdout, table
from hapsim.device.open_connection import on_device
from hapsim.documents import pick
from hapsim.errors import UsageError
from hapsim.measuring import measure_hands as rings
from hapsim.measuring.measure import measure as measure_scene
from hapsim.measuring.measure_impedance import StoppedError, walls_in_place
from hapsim.measuring.measure_impedance import measure_impedance as measure
from hapsim.number_format import number, percent, plural
from hapsim.prediction import predict
from hapsim.prediction.predict_impedance import (
    PredictedImpedance,
    ZWidth,
    decades_of,
    mean_width,
    predict_impedance,
    width_db,
    z_width_of,
)
from hapsim.stopping import INTERRUPTED, ignore_stops
from hapsim.theory.network import principal
from hapsim.theory.network.impedance import spring_and_damper

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.cli.measure_options import MeasureOptions
    from hapsim.measuring.measure_hands import HandsMeasurement
    from hapsim.measuring.measure_impedance import MeasuredImpedance
    from hapsim.scene import Scene
    from hapsim.theory.network import FeltPair


def measure_hands(asked: MeasureOptions, scene: Scene, channel: int, at: tuple[float, float] | None) -> None:
    """Pushes each of the linked hands; or leads a hand in the plane to `at`, m, and pushes it along x and y. Prints the
    measured matrices beside the prediction. The trace of each coordinate gets a file."""
    name = scene.hand_on(channel)
    prediction = predict(scene, with_margins=False, at=None if at is None else {name: at})
    one = prediction.part_on(channel)
    if one is None or len(one.names) == 1:
        raise UsageError(f"--hands: the hand on channel {channel} is linked to no other; leave the option out")
    asked.require_units(scene, one.channels)
    asked.require_free(*asked.files_of(one.channels if asked.hands else scene.hand_of(channel)))
    require_stable(asked.scene, scene, prediction, asked.unstable)
    warnings = print_warnings(scene, prediction)
    with asked.running() as options:
        found = (
            rings.measure_hands(scene, channels=one.channels, **options)
            if asked.hands
            else measure_scene(scene, channel=channel, at=at, **options)
        )
    asked.save(found.channels, *found.traces)
    own = np.ix_(*[[one.channels.index(each) for each in found.channels]] * 2)
    felt = one.felt._replace(k=one.felt.k[own], b=one.felt.b[own])
    if asked.json:
        print(document({"scene": asked.scene, "warnings": warnings} | hands_document(one.names, felt, found)))
        return
    if found.at_m is None:
        names = [escape(each) for each in one.names]
        title, masses = f"What {' and '.join(names)} feel, of the scene and of each other", "masses"
        rows, measured = _pair_rows(names, felt, found), " Measured: the motions with the most energy."
    else:
        place = f"{output_units().number(found.at_m[0], 'm')}, {output_units()(found.at_m[1], 'm')}"
        title, masses = f"What {escape(name)} feels at {place}, along the two principal directions", "mass"
        rows, measured = _principal_rows(felt, found), ""
    stdout().print(table(f"{title}{of_mock(scene)}", ("", "predicted", "measured", "±", "off by"), rows))
    show(stdout(), assumption_lines(prediction.assumptions))
    if felt.reason:
        stdout().print(f"No k and b are predicted, because {felt.reason}.{measured}")
    stdout().print(
        f"Fitted to {plural(found.samples, 'sample')} of free motion. Other motions had {percent(found.others, 2)} of "
        f"the energy. The uncertainty does not include that of the {masses}."
    )
    asked.print_files(found.channels)
    asked.print_next_run(scene, asked.unstable)


_UNITS = {"k": "N/m", "b": "N·s/m"}


def _pair_rows(names: Sequence[str], felt: FeltPair, found: HandsMeasurement) -> Iterator[tuple[str, ...]]:
    """Yields k and b of each hand, and of each hand to each other one."""
    for i, j in np.ndindex(found.k.shape):
        label, sign = (names[i], 1.0) if i == j else (f"{names[i]} of {names[j]}", -1.0)
        for what, unit in _UNITS.items():
            predicted, measured = (sign * getattr(side, what)[i, j] for side in (felt, found))
            uncertainty, units = getattr(found, f"{what}_uncertainty")[i, j], output_units(found.channels[i])
            yield compared(f"{label}: {what}", unit, predicted, measured, uncertainty, units=units)


def _principal_rows(felt: FeltPair, found: HandsMeasurement) -> Iterator[tuple[str, ...]]:
    """Yields the angle, k and b of both principal directions."""
    directions = [None, None] if felt.reason else principal(felt.k, felt.b)
    for predicted, measured in zip(directions, found.principal, strict=True):
        degrees = [np.nan if one is None else np.degrees(one.angle) for one in (predicted, measured)]
        if predicted is not None:  # 179.9° is -0.1°
            degrees[1] -= 180.0 * round((degrees[1] - degrees[0]) / 180.0)
        yield ("direction  °", *(number(float(one), 4) for one in degrees), "", "")
        for what, unit in _UNITS.items():
            uncertainty = getattr(measured, f"{what}_uncertainty")
            yield compared(what, unit, getattr(predicted, what, np.nan), getattr(measured, what), uncertainty)


def hands_document(names: Sequence[str], felt: FeltPair, found: HandsMeasurement) -> dict[str, Any]:
    """Returns the keys of linked hands, or of a hand in the plane, which has k and b along its principal directions."""
    sides: dict[str, Any] = {"predicted": None}
    more_measured = "k_uncertainty b_uncertainty poles others samples"
    for how, pair, more in (("predicted", felt, ""), ("measured", found, more_measured)):
        if not getattr(pair, "reason", ""):
            directions = principal(pair.k, pair.b) if found.at_m is not None else ()
            each = [{"angle_deg": float(np.degrees(one.angle)), "k": one.k, "b": one.b} for one in directions]
            sides[how] = pick(pair, "k b") | ({"principal": each} if each else {}) | pick(pair, more)
    if found.at_m is None:
        return {"hands": {"device_points": names, "channels": found.channels, **sides}}
    return pick(found, "at_m channels") | sides


_WALL_PERIODS = 14
_STOPPED = "hapsim: stopped early: the impedance is of the periods recorded until then"
_ROWS = 12  # of the frequencies, in a table
_IMPEDANCES = "device rendered closed_loop"
_UNSURE = 0.1  # of a value


def measure_impedance(asked: MeasureOptions, scene: Scene) -> None:
    """Excites each device point, and prints the impedance that it identifies beside the prediction."""
    channels = [point.channel for point in scene.device_points.values()]
    place = None if asked.channel is None else channels.index(hand_channel(scene, asked.channel))
    asked.require_units(scene, channels)
    asked.require_free(*asked.files_of(channels))
    predict_before_arming(asked.scene, scene, asked.unstable)
    with asked.running() as options:
        options["travel"] = asked.travel
        try:
            measured = measure(scene, **options)
        except StoppedError as stopped:
            asked.save(channels, *stopped.traces)
            raise
        predicted = predict_impedance(scene, measured.frequency, as_read=True)
        widths = [z_width_of(scene, one, measured.frequency) for one in measured.channels]
        walls = _walls(scene, measured, widths, options) if asked.z_width and not measured.stopped else {}
    asked.save(measured.channels, *measured.traces)
    if asked.wanted:
        from hapsim.chart.impedance_chart import columns, draw_impedance

        asked.write(
            lambda: columns(predicted, measured), lambda path: draw_impedance(scene, predicted, measured, place, path)
        )
    if asked.json:
        early = {"error": _STOPPED, "exit_status": INTERRUPTED} if measured.stopped else {}
        about = {"scene": asked.scene, "motion": scene.device.motions(scene.channels)}
        print(document(about | impedance_document(predicted, measured, widths, walls) | early))
    else:
        shown = list(range(len(predicted.names))) if place is None else [place]
        show_impedance(stdout(), predicted, measured, shown)
        if any(widths):
            stdout().print("", _width_table(predicted, measured.channels, widths, walls))
        if of_mock(on_device(scene, asked.kind())):
            stdout().print("Measured on the built-in mock.")
        asked.print_files(measured.channels)
    if measured.stopped:
        ignore_stops()
        print_message(_STOPPED)
        raise typer.Exit(INTERRUPTED)
    if not asked.json:
        asked.print_next_run(scene, asked.unstable)


class MeasuredWidth(NamedTuple):
    """Measured Z-width between the device and its wall, (n,) dB, and its uncertainty."""

    width_db: Any
    uncertainty_db: Any


Widths = list[dict[str, ZWidth]]
"""Z-width of each device point, by kind of wall."""

Walls = Mapping[int, MeasuredWidth]
"""The Z-width that was measured, by channel."""


def _walls(scene: Scene, measured: MeasuredImpedance, widths: Widths, options: dict[str, Any]) -> Walls:
    """Measures the Z-width of those channels where a wall is passive."""
    walls = {
        channel: (by_kind["passive"].wall.stiffness, by_kind["passive"].wall.damping)
        for channel, by_kind in zip(measured.channels, widths, strict=True)
        if "passive" in by_kind and by_kind["passive"].wall.stiffness > 0.0
    }
    if without := [str(channel) for channel in measured.channels if channel not in walls]:
        which = f"{'channel' if len(without) == 1 else 'channels'} {', '.join(without)}"
        print_message(f"{which}: no wall is passive there, or it is not derived; its Z-width is not measured")
    if not walls:
        return {}
    long_enough = {"duration": options["duration"] or _WALL_PERIODS * measured.period_s}
    with_walls = measure(walls_in_place(scene, walls), **(options | long_enough))
    return {one: measured_width(measured, i, with_walls) for i, one in enumerate(measured.channels) if one in walls}


def measured_width(measured: MeasuredImpedance, i: int, wall: MeasuredImpedance) -> MeasuredWidth:
    """Returns the Z-width of the device point at place `i`: between the device as it was measured with the scene, and
    the same with what the wall renders in the scene's place. (A hand on its stiffest passive wall hardly comes to rest:
    that record shows less of the device.)"""
    device, rendered = ((one.value[:, i, i], one.uncertainty[:, i, i]) for one in (measured.device, wall.rendered))
    with_wall = device[0] + rendered[0]
    share = device[1] / np.abs(device[0]) + (device[1] + rendered[1]) / np.abs(with_wall)
    return MeasuredWidth(width_db(device[0], with_wall), 20.0 * np.log10(1.0 + share))


def show_impedance(out: Console, predicted: PredictedImpedance, measured: MeasuredImpedance, shown: list[int]) -> None:
    """Prints prediction beside measurement, two tables for each device point of `shown`, numbered as in the scene."""
    for i in shown:
        for name, words in (("rendered", "Rendered impedance"), ("closed_loop", "Closed loop's impedance")):
            out.print("", _table(predicted, measured, i, name, words))
        out.print("", _springs(predicted, measured, i))
    out.print()
    show(out, [*assumption_lines(predicted.assumptions), *_sentences(predicted, measured)])


def _table(predicted: PredictedImpedance, measured: MeasuredImpedance, i: int, name: str, words: str) -> Table:
    desired = predicted.desired + (predicted.ideal_device if name == "closed_loop" else 0.0)
    circles = getattr(measured, name)
    units = output_units(measured.channels[i])
    columns = tuple(units.scaled(z, "N·s/m") for z in (desired, getattr(predicted, name), circles.value))
    rows = [
        (
            f"{predicted.frequency[n]:.4g}",
            *(f"{abs(z[n, i, i]):.5g} ∠ {np.degrees(np.angle(z[n, i, i])):.1f}°" for z in columns),
            units.number(circles.uncertainty[n, i, i], "N·s/m", 1),
        )
        for n in _shown(predicted.frequency)
    ]
    where = f"{predicted.names[i]}, channel {measured.channels[i]}"
    return table(
        f"{words} at {escape(where)}, {units.name('N·s/m')}", ("f  Hz", "desired", "predicted", "measured", "±"), rows
    )


def _springs(predicted: PredictedImpedance, measured: MeasuredImpedance, i: int) -> Table:
    """Returns the rendered impedance as a spring and a damper."""
    f, circles = predicted.frequency, measured.rendered
    pairs = [spring_and_damper(f, one[:, i, i]) for one in (predicted.desired, predicted.rendered, circles.value)]
    off, rows, units = circles.uncertainty[:, i, i], [], output_units(measured.channels[i])
    for n in _shown(f):
        cells = [f"{units.number(k[n], 'N/m', 5)}, {units.number(b[n], 'N·s/m', 4)}" for k, b in pairs]
        apart = units.number(2.0 * np.pi * f[n] * off[n], "N/m", 1), units.number(off[n], "N·s/m", 1)
        rows.append((f"{f[n]:.4g}", *cells, ", ".join(apart)))
    where = f"{escape(predicted.names[i])}, channel {measured.channels[i]}"
    title = f"The same rendered at {where} as k, b: {units.name('N/m')}, {units.name('N·s/m')} (a mass has k below 0)"
    return table(title, ("f  Hz", "desired", "predicted", "measured", "±"), rows)


def _shown(frequency: Any) -> list[int]:
    return np.unique(np.rint(np.linspace(0, frequency.size - 1, _ROWS)).astype(int)).tolist()


def _sentences(predicted: PredictedImpedance, measured: MeasuredImpedance) -> list[str]:
    """Returns the differences of prediction and measurement, the excitation, and the cautions."""
    frequency = predicted.frequency
    found = [f"The tables show {_ROWS} of {frequency.size} frequencies; --json and --data have all."] * (
        frequency.size > _ROWS
    )
    for name, words in (("rendered", "rendered"), ("closed_loop", "closed-loop"), ("device", "device's own")):
        off = off_by(predicted, measured, name)
        worst = np.unravel_index(int(np.argmax(off)), off.shape)
        if off[worst] <= 1.0:
            found.append(
                f"The {words} impedance: prediction and measurement agree within the uncertainty at all "
                f"{frequency.size} frequencies, at most {off[worst]:.2g} of it apart."
            )
            continue
        apart = abs(getattr(measured, name).value[worst] - getattr(predicted, name)[worst])
        found.append(
            f"[yellow]The {words} impedance: prediction and measurement do not agree: at {frequency[worst[0]]:.4g} Hz "
            f"{output_units()(apart, 'N·s/m', '.3g')}, {off[worst]:.2g} times the uncertainty.[/yellow]"
        )
    found.append(
        "± is the radius of the circle about a measured value that holds the true one, all of them together with "
        "99.9 %. Rendered: what the scene presents, late and held; closed loop: that and the device's own mass, "
        "friction and spring, which is what the hand feels. Both hold where the position is read; of a hand behind a "
        "transmission or a lagging motor `hapsim chart transparency` draws what it feels."
    )
    found += [
        f"Channel {channel} was excited with up to {output_units(channel)(force, 'N', '.3g')}, which moved it by "
        f"{output_units(channel)(travel, 'mm', '.3g')}; {periods + 1} periods of {measured.period_s:.3g} s count."
        for channel, force, travel, periods in zip(
            measured.channels, measured.peak_force, measured.travel, measured.periods, strict=True
        )
    ]
    return found + [f"[yellow]{sentence}[/yellow]" for sentence in cautions(predicted, measured)]


def cautions(predicted: PredictedImpedance, measured: MeasuredImpedance) -> list[str]:
    """Returns sentences that limit the meaning of the numbers."""
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
            f"The force was clipped at its limit in {plural(measured.limited_samples, 'sample')}: there the loop did "
            "not answer in proportion."
        )
    if measured.lost_periods:
        found.append(f"Not used: {plural(measured.lost_periods, 'period')} with positions that never came.")
    seen = measured.seen_rate
    if seen is not None and measured.traces and seen.differs_from(measured.traces[0].rate):
        found.append(
            f"The device sampled at {seen.rate_hz:.6g} ± {seen.uncertainty_hz:.2g} Hz and not at "
            f"{measured.traces[0].rate:g}: every frequency here is as much off, and the device's delay with it."
        )
    return found


def off_by(predicted: PredictedImpedance, measured: MeasuredImpedance, name: str) -> Any:
    """Returns the distance of the two over the stated uncertainty, (n, C, C)."""
    circles = getattr(measured, name)
    apart = np.abs(circles.value - getattr(predicted, name))
    return np.divide(apart, circles.uncertainty, out=np.zeros_like(apart), where=apart > 0.0)


def _width_table(predicted: PredictedImpedance, channels: tuple[int, ...], widths: Widths, walls: Walls) -> Table:
    """Returns the device's Z-width at each point, predicted, and measured where `walls` has it."""
    first = next(width for by_kind in widths for width in by_kind.values())
    bands = decades_of(first.frequency, first.width_db)
    rows = []
    alike = len({output_units(channel) for channel in channels}) == 1
    for name, channel, by_kind in zip(predicted.names, channels, widths, strict=True):
        units = output_units(channel)
        for kind, width in by_kind.items():
            K, B = width.wall.stiffness, width.wall.damping
            shown = units.number if alike else units
            wall = [shown(K, "N/m", ".6g"), shown(B, "N·s/m", ".4g")]
            rows.append([escape(name), kind, *wall, *_means(width.frequency, width.width_db)])
            if kind == "passive" and channel in walls:
                found = walls[channel]
                rows.append(["", "measured", "", "", *_means(width.frequency, found.width_db)])
                rows.append(["", "±", "", "", *_means(width.frequency, found.uncertainty_db, ".1g")])
    of_bands = (f"{low:.3g} to {high:.3g} Hz" for low, high, _ in bands)
    walls_at = (f"K  {units.name('N/m')}", f"B  {units.name('N·s/m')}") if alike else ("K", "B")
    headings = ("<at", "<wall", *walls_at, "all", *of_bands)
    return table("Z-width: from the device alone to its stiffest wall, mean dB", headings, rows)


def _means(frequency: Any, width: Any, form: str = ".2f") -> list[str]:
    """Returns the means of all frequencies, and of each decade."""
    means = [mean_width(frequency, width), *(mean for _, _, mean in decades_of(frequency, width))]
    return [f"{mean:{form}}" for mean in means]


def impedance_document(
    predicted: PredictedImpedance, measured: MeasuredImpedance, widths: Widths, walls: Walls
) -> dict[str, Any]:
    """Returns the document of `hapsim measure --impedance --json`, without the scene; matrices are (frequencies, C, C),
    complex numbers [re, im], N·s/m."""
    sides = {"desired": predicted.desired, "predicted": predicted.rendered, "measured": measured.rendered.value}
    pairs = {name: spring_and_damper(predicted.frequency[:, None, None], one) for name, one in sides.items()}
    return {
        "impedance": {
            **pick(predicted, "frequency_hz=frequency device_points=names"),
            **pick(measured, "channels period_s lost_periods limited_samples"),
            "desired": predicted.desired,
            "predicted": pick(predicted, _IMPEDANCES),
            "measured": pick(measured, _IMPEDANCES),
            "spring_and_damper": {name: {"k": k, "b": b} for name, (k, b) in pairs.items()},
            "off_by_uncertainties": {
                name: float(np.max(off_by(predicted, measured, name))) for name in _IMPEDANCES.split()
            },
            "confidence": 0.999,
            "periods": [pairs + 1 for pairs in measured.periods],
            **pick(measured, "peak_force_n=peak_force travel_m=travel"),
            "assumptions": predicted.assumptions,
            "cautions": cautions(predicted, measured),
        },
        "z_width": {
            name: {
                kind: _width_document(width, walls.get(channel) if kind == "passive" else None)
                for kind, width in by_kind.items()
            }
            for name, channel, by_kind in zip(predicted.names, measured.channels, widths, strict=True)
        },
    }


def _width_document(width: ZWidth, measured: MeasuredWidth | None) -> dict[str, Any]:
    def of(values: Any) -> dict[str, Any]:
        """Returns the document of a width over frequency."""
        decades = decades_of(width.frequency, values)
        return {
            "mean_db": mean_width(width.frequency, values),
            "decades": [dict(zip(("from_hz", "to_hz", "mean_db"), one, strict=True)) for one in decades],
            "width_db": values,
        }

    found = None
    if measured is not None:
        mean = mean_width(width.frequency, measured.uncertainty_db)
        found = of(measured.width_db) | {"uncertainty_db": measured.uncertainty_db, "mean_uncertainty_db": mean}
    return pick(width.wall, "stiffness damping") | {"predicted": of(width.width_db), "measured": found}
