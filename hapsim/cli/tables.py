"""What runs and measurements found, as text for people; and which ports there are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hapsim.cli.compared import gives, is_another_device, oscillation_of, probable_mass
from hapsim.cli.prediction import number
from hapsim.prediction import Desired, Felt, Prediction, felt_at_rate

if TYPE_CHECKING:
    from hapsim.loop.histogram import Spread
    from hapsim.measuring.measure_trace import Measurement
    from hapsim.measuring.trace_quality import SeenRate
    from hapsim.recording.trace import Report


_REFUSED_BY_DEVICE = "frames refused by the device"
_MASS_KNOWN, _LITTLE_EXPLAINED = 0.1, 0.9  # relative uncertainty and share of the motion: a warning beyond either
_FEW_ARE_NORMAL = " (a few at arming and disarming are normal)"
_MANY = 10
_FEW = 0.01
_OFF_RATE = 0.02  # of the rate, from which a hand feels another damping


def show_measurement(
    out: Console,
    where: str,
    felt: Felt | None,
    why: str,
    measurement: Measurement,
    desired: Desired | None = None,
    *,
    prediction: Prediction | None = None,
    of_mass: str = "declared",
) -> None:
    """Prediction beside measurement, as `hapsim measure` tells them; and beside what is desired, with a correction.

    `where`: the hand in question; `why`: there is no prediction for it, in words; `prediction`: of the whole
    scene; `of_mass`: where the mass comes from, in a word.
    """
    out.print()
    out.print(_side_by_side(f"What the hand feels at {escape(where)}", felt, measurement, of_mass, desired))
    _show_at_seen_rate(out, felt, measurement, of_mass)
    if felt is None:
        out.print(
            f"This hand {why}: no single spring and damper is predicted "
            "for it. Measured is, of the modes that its motion shows, the one that rings longest; k and b would give "
            "the hand's mass alone the same mode. `hapsim check` lists the modes."
        )
    limited = measurement.trace.report.limited_ticks
    if limited:
        out.print(
            f"[yellow]{limited} of {measurement.trace.report.ticks} ticks were at the force limit[/yellow]: k and b "
            "hold for motions that stay below it; beyond, the hand feels less."
        )
    slewed = measurement.trace.report.slewed_ticks
    if slewed:
        out.print(
            f"[yellow]{slewed} of {measurement.trace.report.ticks} ticks were at the slew limit or in the soft "
            "start[/yellow]: k and b hold for motions that are slower; in these the hand feels less."
        )
    faded = measurement.trace.report.faded_ticks
    if faded:
        out.print(
            f"[yellow]{faded} of {measurement.trace.report.ticks} ticks were outside device.travel[/yellow], where the "
            "force fades: k and b hold for motions within it."
        )
    _show_what_the_device_is(out, felt, measurement, prediction, of_mass)
    if not measurement.dominant:
        out.print(f"The motion is not that of a spring and damper: {_plainly(measurement.reason)}.")
    out.print(
        f"Read from {measurement.samples} samples; the fit leaves {measurement.residual_m:.2g} m, in "
        f"{measurement.order} poles."
    )


def _show_what_the_device_is(
    out: Console, felt: Felt | None, measurement: Measurement, prediction: Prediction | None, of_mass: str
) -> None:
    """Where it is not as the scene declares it: what that may be."""
    second, mass = measurement.second_mode, probable_mass(felt, measurement)
    if second is not None and prediction is not None and gives(prediction, measurement):
        frequency, ratio = oscillation_of(second.pole, measurement.trace.rate)
        out.print(
            f"[yellow]A second mode swings along[/yellow] at {frequency:.3g} Hz, damping ratio {ratio:.2g}, with "
            f"{100.0 * second.share:.3g} % of the motion's energy: the hand, or a part of the device, moves against "
            "the rest like a mass on a spring. k and b are those of the longest ringing mode, not what the hand feels."
        )
    elif mass is not None:
        share = mass.factor
        out.print(
            f"[yellow]The mass is probably {share:.3g} times the {of_mass} one[/yellow], {mass.mass:.4g} kg: with it "
            "the prediction has the eigenfrequency and the damping ratio that were measured, and the hand feels "
            f"k = {share * measurement.k:.6g} N/m, b = {share * measurement.b:.6g} N·s/m. `hapsim identify --write` "
            "measures and stores it."
        )
    elif felt is not None and is_another_device(felt, measurement):
        out.print(
            "[yellow]Measured and predicted are much further apart than the uncertainty[/yellow]: the device is not as "
            "the scene declares it, or has dry friction. `hapsim identify` finds what it is."
        )


def _plainly(reason: str) -> str:
    """Why there is no pair of poles, for who does not think in poles; `Measurement.reason` keeps it precise."""
    from hapsim.measuring.pole_pair import NO_SECOND_REAL_POLE

    if reason == NO_SECOND_REAL_POLE:
        return "the hand creeps back without swinging, in a way that no single spring and damper does"
    return reason


def _show_at_seen_rate(out: Console, felt: Felt | None, measurement: Measurement, of_mass: str) -> None:
    """Both sides once more, where the device was seen to sample at another rate than it declares."""
    seen, declared = measurement.seen_rate, measurement.trace.rate
    if seen is None or not seen.differs_from(declared):
        return
    rate, uncertainty = _rounded(seen)
    out.print(
        f"[yellow]The device sampled at {rate} ± {uncertainty} Hz[/yellow], as its positions "
        f"arrived; it declares {declared:g} Hz, for which the table above holds. With the rate that was seen:"
    )
    at_seen = None if felt is None else felt_at_rate(felt, seen.rate_hz)
    title = f"What the hand feels at {rate} Hz (or this machine held the device up)"
    out.print(_side_by_side(title, at_seen, measurement.at_rate(seen.rate_hz), of_mass))


def _rounded(seen: SeenRate) -> tuple[str, str]:
    """The rate and its uncertainty, Hz, to the second digit of the uncertainty."""
    decimals = max(1 - math.floor(math.log10(seen.uncertainty_hz)), 0)
    return f"{seen.rate_hz:.{decimals}f}", f"{seen.uncertainty_hz:.{decimals}f}"


def _side_by_side(
    title: str, felt: Felt | None, measurement: Measurement, of_mass: str, desired: Desired | None = None
) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in (
        "",
        *(["desired"] if desired else []),
        "predicted",
        "measured",
        "±" if desired else "uncertainty",
        "off by",
    ):
        table.add_column(heading, justify="right" if heading else "left")
    digits = 7 if desired else 9  # so that 80 columns hold the table
    rows = [
        ("k  N/m", "k", measurement.k_uncertainty),
        ("b  N·s/m", "b", measurement.b_uncertainty),
        ("eigenfrequency  Hz", "frequency_hz", measurement.frequency_uncertainty_hz),
        ("damping ratio", "damping_ratio", measurement.damping_ratio_uncertainty),
    ]
    for label, key, uncertainty in rows:
        predicted = math.nan if felt is None else getattr(felt, key)
        measured = getattr(measurement, key)
        difference = (measured / predicted - 1.0) if predicted else math.nan
        table.add_row(
            label,
            *([number(getattr(desired, key))] if desired else []),
            number(predicted, digits),
            number(measured, digits),
            number(uncertainty, 1),
            f"{difference:+.1e}" if math.isfinite(difference) else "",
        )
    unsure = of_mass if measurement.mass_uncertainty is None else number(measurement.mass_uncertainty, 1)
    table.add_row("mass  kg", *([""] if desired else []), "", number(measurement.mass, digits), unsure, "")
    return table


def show_report(out: Console, report: Report, reconnections: int = 0) -> None:
    """How a run went. `reconnections`: how often its device came back."""
    table = Table(title="The run", title_justify="left", show_header=False)
    table.add_column()
    table.add_column(justify="right")
    time = "virtual" if report.virtual_time else "real"
    table.add_row("ended", report.ending)
    table.add_row(f"{time} time  s", f"{report.duration_s:.3f}")
    table.add_row("ticks", str(report.ticks))
    if reconnections:
        table.add_row("reconnections", str(reconnections))
    table.add_row("rate  Hz", f"{report.rate_hz:.2f}{_off_rate(report)}")
    share = report.deadline_misses / report.ticks if report.ticks else 0.0
    table.add_row("deadline misses", f"{report.deadline_misses} ({share:.2%})")
    if report.age_samples.max is not None:
        at_most = "at most " if report.deadline_misses else ""
        table.add_row("oldest force  samples", f"{at_most}{report.age_samples.max:.0f}")
    if not report.virtual_time:
        table.add_row("lateness  µs", _spread_in_us(report.lateness_s))
        table.add_row("exchange  µs", _spread_in_us(report.exchange_s))
    if report.parameter_changes:
        table.add_row("changes taken", str(report.parameter_changes))
    for label, count in (
        ("positions lost", report.lost_frames),
        ("frames refused by this host", report.crc_errors),
        ("bytes that were no frame", report.garbage_bytes),
        (_REFUSED_BY_DEVICE, report.rejected_by_device),
        ("stale positions", report.stale_positions),
        ("ticks at the force limit", report.limited_ticks),
        ("ticks at the slew limit or in the soft start", report.slewed_ticks),
        ("ticks outside the travel, force faded", report.faded_ticks),
        ("ticks in which changes were slowed", report.slowed_ticks),
        ("forces withheld: position too old", report.withheld_forces),
        ("releases to test a motor's sign", report.sign_tests),
        ("rows not recorded", report.dropped_rows + report.unrecorded_rows),
    ):
        if count:
            note = _FEW_ARE_NORMAL if label == _REFUSED_BY_DEVICE and count < _MANY else ""
            table.add_row(label, f"[yellow]{count}[/yellow]{note}")
    for channel, mass in enumerate(report.estimated_mass_kg):
        if mass is not None:
            table.add_row(f"estimated mass, channel {channel}  kg", _estimated_mass(report, channel))
    if report.released is False:
        table.add_row("force released", "[yellow]not confirmed[/yellow]")
    out.print()
    out.print(table)
    if sentence := _of_the_wire(report):
        out.print(f"[yellow]{sentence}[/yellow]")


def _of_the_wire(report: Report) -> str:
    """That it lost or spoilt more than a few frames, and what to look at; "" where it did not."""
    positions = report.ticks + report.lost_frames
    refused_there = report.rejected_by_device or 0
    refused = report.crc_errors + (refused_there if refused_there >= _MANY else 0)
    if not positions or max(report.lost_frames, refused) <= _FEW * positions:
        return ""
    told = [f"{_percent(report.lost_frames / positions)} of the positions were lost"] if report.lost_frames else []
    told += [f"{refused} frames were refused"] if refused else []
    held_up = "" if refused or report.garbage_bytes else ", and whether this machine was held up (`hapsim doctor`)"
    return (
        f"{' and '.join(told)}: look at cable, baud rate and interference{held_up}. `hapsim frames PORT`, while "
        "nothing runs, shows what arrives."
    )


def _estimated_mass(report: Report, channel: int) -> str:
    """The mass with its uncertainty, and whether the motion told it."""
    mass = report.estimated_mass_kg[channel] or 0.0
    if channel >= len(report.estimated_mass_uncertainty_kg):
        return f"{mass:.4g}"  # a record of an earlier version
    uncertainty, explained = report.estimated_mass_uncertainty_kg[channel] or 0.0, report.mass_explained[channel] or 0.0
    told = f"{mass:.4g} ± {uncertainty:.2g}"
    if uncertainty > _MASS_KNOWN * mass:
        return f"{told} [yellow](not known: no force moved the hand clearly, or others moved it more)[/yellow]"
    if explained < _LITTLE_EXPLAINED:
        return f"{told} [yellow](the forces explain {_percent(explained)} of the latest motion)[/yellow]"
    return told


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.995 else "Nearly all"


def _off_rate(report: Report) -> str:
    """Beside the rate that was kept: that it is another than was asked for, where that is sure."""
    from hapsim.measuring.trace_quality import kept_rate

    asked, kept = report.nominal_rate_hz, kept_rate(report)
    if kept is None or not kept.differs_from(asked) or abs(kept.rate_hz / asked - 1.0) < _OFF_RATE:
        return ""
    return f" [yellow]({kept.rate_hz / asked:.1%} of {asked:g})[/yellow]"


def _spread_in_us(spread: Spread) -> str:
    """Median, 99 %, the largest."""
    if spread.p50 is None or spread.p99 is None or spread.max is None:
        return "–"
    return f"{spread.p50 * 1e6:.0f} median, {spread.p99 * 1e6:.0f} in 99 %, {spread.max * 1e6:.0f} at most"


_NOT_KNOWN = "n/a"  # as pyserial says it


def show_ports(out: Console, ports: Iterable[Mapping[str, str]]) -> None:
    """What `hapsim ports` lists: where each port is, what it says of itself, and by what the system knows it."""
    table = Table(title="Serial ports", title_justify="left")
    table.add_column("port", overflow="fold", no_wrap=True)
    table.add_column("description", overflow="fold")
    table.add_column("hardware", overflow="fold")
    for port in ports:
        table.add_row(
            *(escape(port[key] if port[key] != _NOT_KNOWN else "") for key in ("port", "description", "hardware"))
        )
    out.print(table)
