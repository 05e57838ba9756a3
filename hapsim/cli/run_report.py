"""What a run's report says, as a table and as a JSON document."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from hapsim.cli.output import failure_document, spoken, table
from hapsim.measuring.trace_quality import kept_rate
from hapsim.number_format import percent, plural

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.loop.histogram import Spread
    from hapsim.loop.realtime import PrivilegeResult
    from hapsim.recording.trace import Report
    from hapsim.running.reconnecting import Lifetime

_GRIP_S = 1.0  # a hand takes no longer for another grip: an older mass may no longer be that
_MASS_KNOWN, _LITTLE_EXPLAINED = 0.1, 0.9  # relative uncertainty and share of the motion: a warning beyond either
_NORMAL_REFUSALS = 9  # of the device, at arming and disarming
_FEW = 0.01  # of the positions
_OFF_RATE = 0.02  # of the rate, from which a hand feels another damping


def show_report(out: Console, report: Report, reconnections: int = 0) -> None:
    """Prints how a run went, as a table. `reconnections`: how often its device came back."""
    out.print()
    out.print(table("The run", ("", "result"), _rows(report, reconnections), show_header=False))
    _warn_of_the_wire(out, report)


def show_run(out: Console, report: Report) -> None:
    """Prints how a run went in a line, and what is wrong with the wire."""
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
    yield "deadline misses", f"{report.deadline_misses} ({share:.2%})"
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
            yield spoken(channel)(f"estimated mass, channel {channel}  kg"), _estimated_mass(report, channel, mass)
    if report.released is False:
        yield "force released", "[yellow]not confirmed[/yellow]"


def _time(report: Report) -> str:
    return "virtual time" if report.virtual_time else "real time"


def _warn_of_the_wire(out: Console, report: Report) -> None:
    """Prints what to look at where a position stood still, or the wire lost or spoilt more than a few frames."""
    if report.frozen:
        out.print(f"Warning: {report.frozen}.", style="yellow", markup=False)
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
    """Returns the mass with its uncertainty, and whether the motion shows it."""
    if channel >= len(report.estimated_mass_uncertainty_kg):
        return f"{mass:.4g}"  # a record of an earlier version
    uncertainty, explained = report.estimated_mass_uncertainty_kg[channel] or 0.0, report.mass_explained[channel] or 0.0
    note = ""
    if uncertainty > _MASS_KNOWN * mass:
        note = " [yellow](not known: no force moved the hand clearly, or others moved it more)[/yellow]"
    elif explained < _LITTLE_EXPLAINED:
        note = f" [yellow](the forces explain {_share(explained)} of the latest motion)[/yellow]"
    elif (age_s := dict(enumerate(report.mass_age_s)).get(channel) or 0.0) > _GRIP_S:
        note = f" [yellow](of {age_s:.3g} s before the end: no motion showed it later)[/yellow]"
    return f"{mass:.4g} ± {uncertainty:.2g}{note}"


def _share(share: float) -> str:
    return percent(share) if share < 0.995 else "Nearly all"


def _off_rate(report: Report) -> str:
    """Returns a note beside the rate that was kept, where it is surely another than was asked for."""
    asked, kept = report.nominal_rate_hz, kept_rate(report)
    if kept is None or not kept.differs_from(asked) or abs(kept.rate_hz / asked - 1.0) < _OFF_RATE:
        return ""
    return f" [yellow]({kept.rate_hz / asked:.1%} of {asked:g})[/yellow]"


def _spread_in_us(spread: Spread) -> str:
    if spread.p50 is None or spread.p99 is None or spread.max is None:
        return "–"
    return f"{spread.p50 * 1e6:.0f} median, {spread.p99 * 1e6:.0f} in 99 %, {spread.max * 1e6:.0f} at most"


def lifetime_document(lifetime: Lifetime, grants: Sequence[PrivilegeResult] = ()) -> dict[str, Any]:
    """Returns what `hapsim run` prints: the report of all sessions, and how often the device came back."""
    return (
        asdict(lifetime.report)
        | ({"realtime": [asdict(grant) for grant in grants]} if grants else {})
        | {
            "reconnections": lifetime.reconnections,
            "interruptions": [asdict(one) for one in lifetime.interruptions],
            "records": list(map(str, lifetime.records)),
            "sound_files": list(map(str, lifetime.sound_files)),
        }
        | failure_document(lifetime.failure)
    )
