"""What a run's report says, as a table and as a JSON document."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from hapsim.cli.as_json import failure_document
from hapsim.measuring.trace_quality import kept_rate
from hapsim.number_format import percent, plural

if TYPE_CHECKING:
    from hapsim.loop.histogram import Spread
    from hapsim.loop.realtime import PrivilegeResult
    from hapsim.recording.trace import Report
    from hapsim.running.reconnecting import Lifetime

_REFUSED_BY_DEVICE = "frames refused by the device"
_MASS_KNOWN, _LITTLE_EXPLAINED = 0.1, 0.9  # relative uncertainty and share of the motion: a warning beyond either
_FEW_ARE_NORMAL = " (a few at arming and disarming are normal)"
_MANY = 10
_FEW = 0.01
_OFF_RATE = 0.02  # of the rate, from which a hand feels another damping


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


def show_run(out: Console, report: Report) -> None:
    """Prints how a run went in a line, and what is wrong with the wire."""
    misses = plural(report.deadline_misses, "deadline miss", "deadline misses")
    time = "virtual" if report.virtual_time else "real"
    out.print(
        f"The run: {report.ending}, {report.ticks} ticks in {report.duration_s:.3g} s of {time} time at "
        f"{report.rate_hz:.6g} Hz{_off_rate(report)}, {misses}; --explain prints the report"
    )
    if sentence := _of_the_wire(report):
        out.print(f"[yellow]{sentence}[/yellow]")


def _of_the_wire(report: Report) -> str:
    """That it lost or spoilt more than a few frames, and what to look at; "" where it did not."""
    positions = report.ticks + report.lost_frames
    refused_there = report.rejected_by_device or 0
    refused = report.crc_errors + (refused_there if refused_there >= _MANY else 0)
    if not positions or max(report.lost_frames, refused) <= _FEW * positions:
        return ""
    told = [f"{_share(report.lost_frames / positions)} of the positions were lost"] if report.lost_frames else []
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
        return f"{told} [yellow](the forces explain {_share(explained)} of the latest motion)[/yellow]"
    return told


def _share(share: float) -> str:
    return percent(share) if share < 0.995 else "Nearly all"


def _off_rate(report: Report) -> str:
    """Beside the rate that was kept: that it is another than was asked for, where that is sure."""
    asked, kept = report.nominal_rate_hz, kept_rate(report)
    if kept is None or not kept.differs_from(asked) or abs(kept.rate_hz / asked - 1.0) < _OFF_RATE:
        return ""
    return f" [yellow]({kept.rate_hz / asked:.1%} of {asked:g})[/yellow]"


def _spread_in_us(spread: Spread) -> str:
    """Median, 99 %, the largest."""
    if spread.p50 is None or spread.p99 is None or spread.max is None:
        return "–"
    return f"{spread.p50 * 1e6:.0f} median, {spread.p99 * 1e6:.0f} in 99 %, {spread.max * 1e6:.0f} at most"


def lifetime_document(lifetime: Lifetime, grants: Sequence[PrivilegeResult] = ()) -> dict[str, Any]:
    """What `hapsim run` prints: the report of all sessions, and how often the device came back."""
    return (
        report_document(lifetime.report, grants)
        | {
            "reconnections": lifetime.reconnections,
            "interruptions": [asdict(one) for one in lifetime.interruptions],
            "records": list(map(str, lifetime.records)),
        }
        | failure_document(lifetime.failure)
    )


def report_document(report: Report, grants: Sequence[PrivilegeResult] = ()) -> dict[str, Any]:
    """One run; `grants`: what a real-time set-up asked for."""
    return asdict(report) | ({"realtime": [asdict(grant) for grant in grants]} if grants else {})
