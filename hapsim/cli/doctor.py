"""`hapsim doctor`."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import typer
from rich.markup import escape

from hapsim.cli import command_options
from hapsim.cli.live import live_words
from hapsim.cli.output import Table, document, fitted, print_message, stderr, stdout, table
from hapsim.doctor.examine import RATES_HZ, examine
from hapsim.doctor.exchanges import EXCHANGE, IN_TIME, MOCK, ON_THE_MOCK, Exchanges, Verdict
from hapsim.documents import pick
from hapsim.errors import UsageError
from hapsim.number_format import frequency, in_ascii, share_in_percent, short_duration, time_unit
from hapsim.stopping import INTERRUPTED, ignore_stops

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.doctor.advice import Machine
    from hapsim.doctor.examine import Examination, Step
    from hapsim.loop.histogram import Histogram


def doctor(
    scene: str | None = command_options.argument("[SCENE]", "Scene whose device is tested [default: the mock]"),
    port: command_options.Port = None,
    mock: command_options.MockFlag = False,
    seconds: float = command_options.option(
        "S", "Duration of each measurement in seconds. Longer ones find rarer delays.", default=2.0
    ),
    rates: list[str] | None = command_options.option(
        "HZ,…", "Rates to test in Hz, a list [default: 1000,2000,4000,10000 and the scene's]"
    ),
    realtime: command_options.Realtime = False,
    *,
    picture: command_options.PictureOptions,
    json: command_options.Json = False,
) -> None:
    """Measure the wake-up latency and the possible loop rates of this machine, and print advice.

    Only zero force is sent: the scene runs without its links.
    """
    if port is not None and scene is None:
        raise UsageError("--port: found no SCENE, expected the scene whose device is at that port")
    picture.require_writable()
    with live_words(stderr()) as show:
        found = examine(
            None if scene is None else command_options.load(scene, port),
            seconds=seconds,
            rates=tuple(command_options.numbers("--rates", rates)) or RATES_HZ,
            realtime=realtime,
            transport=command_options.transport_kind(mock, None, port),
            on_progress=lambda step: show(now(step)),
        )
    if found.stopped:
        ignore_stops()  # what is left takes no time worth stopping for
    if picture.wanted:
        from hapsim.chart.steadiness import columns, draw_steadiness, steadiness

        curves, title = steadiness(found), f"How steady this machine is: {found.scene}, {seconds:g} s each"
        picture.write(lambda: columns(curves), lambda path: draw_steadiness(curves, title, path))
    if json:
        print(document(examination_document(found)))
    else:
        show_examination(stdout(), found)
        picture.print_written()
    if found.stopped:
        print_message(f"hapsim: {found.stopped}")
        raise typer.Exit(INTERRUPTED)
    if found.device_failed is not None:
        print_message(found.device_failed.failure)
        raise typer.Exit(found.device_failed.exit_status)


_COLOUR = {"yes": "green", "with gaps": "yellow", "no": "red", "no verdict": "red"}


def now(step: Step) -> str:
    """Returns the progress of a step, in words."""
    what = f"{step.number} of {step.of}: {step.what}"
    if step.compiling:
        return f"{what}: compiling (only the first time, up to a minute), now {step.compiling}"
    return f"{what}: {min(step.elapsed_s, step.seconds):.1f} of {step.seconds:g} s"


def show_examination(out: Console, examination: Examination) -> None:
    """Prints the machine, its wake-up latency, the rates that it keeps, and advice."""
    out.print(_machine(examination.machine))
    for grant in examination.grants or ():
        # The advice gives the reason of a denial.
        answer = f"[green]granted[/green], {escape(grant.detail)}" if grant.granted else "[yellow]denied[/yellow]"
        out.print(f"{escape(grant.privilege)}: {answer}")
    out.print("", _wakeups(out, examination.wakeups))
    rate = examination.rate_hz
    if rate in examination.wakeups:  # else it was stopped before
        out.print(f"\n[italic]Wake-ups at {frequency(rate)}, by how late they came[/italic]")
        histogram, marks = examination.wakeups[rate], {"a period": 1.0 / rate}
        for line in histogram_lines(histogram, out.width, ascii_only=out.options.ascii_only, marks=marks):
            out.print(line, markup=False, highlight=False, soft_wrap=True)
    made = list(zip(examination.exchanges, examination.verdicts, strict=True))
    for clock in dict.fromkeys(run.clock for run, _ in made):
        _show_exchanges(out, examination, clock, [entry for entry in made if entry[0].clock == clock])
    _show_advice(out, examination)


def _machine(machine: Machine) -> str:
    threads = " (two threads a core)" if machine.smt else ""
    facts = [
        machine.cpu or "unknown processor",
        f"{machine.cores_allowed or '?'} of {machine.cores_online or '?'} cores{threads}",
        f"Linux {machine.kernel}, {'PREEMPT_RT' if machine.preempt_rt else 'not a real-time kernel'}"
        if machine.system == "Linux"
        else machine.system,
        f"clock {machine.clock_source}" if machine.clock_source else "",
        f"governor {', '.join(machine.governors)}" if machine.governors else "",
        f"cores kept free: {machine.isolated}" if machine.isolated else "",
        f"a virtual machine ({machine.virtual})" if machine.virtual else "",
    ]
    return escape("; ".join(filter(None, facts)))


def _wakeups(out: Console, wakeups: dict[float, Histogram]) -> Table:
    rows = []
    for rate, histogram in wakeups.items():
        spread = histogram.spread()
        late = share_in_percent(histogram.share_above(1.0 / rate)) if spread.count else "–"
        times = map(short_duration, (spread.p50, spread.p99, spread.p999, spread.max))
        rows.append(_fit_for(out, frequency(rate), *times, str(spread.count), late))
    headings = ("rate", "p50", "p99", "99.9 %", "latest", "wake-ups", "a period late")
    return table("Wake-up latency of a sleeping thread", headings, rows)


def _show_exchanges(out: Console, examination: Examination, clock: str, made: list[tuple[Exchanges, Verdict]]) -> None:
    """Prints the table of one clock. Two side by side would not fit an ordinary terminal."""
    verdicts = [verdict for _, verdict in made]
    where = "the mock" if made[0][0].where == MOCK else f"{made[0][0].where}, sent zero force"
    # Above the table, not its title: a long path stays whole.
    heading = fitted(f"Exchanges of {examination.scene} on {where}; clock: {clock}", out.width, indent="")
    out.print(f"\n{heading}", style="italic", markup=False, soft_wrap=True)
    rows = []
    for run, verdict in made:
        spread = None if run.exchange is None else run.exchange.spread()
        quantiles = (None,) * 3 if spread is None else (spread.p50, spread.p99, spread.max)
        in_time = "–" if verdict.share_in_time is None else share_in_percent(verdict.share_in_time)
        kept = "–" if run.share_of_rate is None else f"{100.0 * run.share_of_rate:.1f} %"
        cells = _fit_for(out, frequency(run.rate_hz), kept, *map(short_duration, quantiles), in_time)
        rows.append([*cells, f"[{_COLOUR[verdict.answer]}]{verdict.answer}[/]"])
    out.print(table("", ("rate", "kept", "p50", "p99", "max", "in time", "<keeps up"), rows))
    on_the_mock = f" {ON_THE_MOCK}" if clock == "device" and clock in examination.best_rates else ""
    out.print(f"{EXCHANGE[clock]} {IN_TIME[clock]}{on_the_mock}")
    if clock in examination.best_rates:
        best = examination.best_rates[clock]
        kept = "none of these rates without gaps" if best is None else f"up to {frequency(best)}"
        conclusion = f"this machine keeps {kept}"
        if best is None and all(verdict.answer == "no verdict" for verdict in verdicts):
            conclusion = "there is no verdict for any of these rates"
        out.print(f"[bold]With clock: {clock} {conclusion}.[/bold]")
    out.print(escape("; ".join(verdict.sentence for verdict in verdicts)) + ".")


def _fit_for(out: Console, *cells: str) -> list[str]:
    return [in_ascii(cell) for cell in cells] if out.options.ascii_only else list(cells)


def _show_advice(out: Console, examination: Examination) -> None:
    if not examination.advice:
        out.print("\nNo setting of this machine needs a change.")
        return
    out.print("\n[bold]What would help[/bold]")
    for number, advice in enumerate(examination.advice, start=1):
        for indent, text, style in ((f"{number:2}. ", advice.found, "bold"), ("    ", f"{advice.why} {advice.do}", "")):
            lines = textwrap.fill(text, max(out.width, 40), initial_indent=indent, subsequent_indent="    ")
            out.print(lines, markup=False, soft_wrap=True, style=style)
        for command in advice.commands:
            # Unbroken, so that it can be copied.
            out.print(f"      {command}", markup=False, soft_wrap=True)


def examination_document(examination: Examination) -> dict[str, Any]:
    """Returns the document of `hapsim doctor --json`: plain values, durations in s with names that end in _s."""
    failed, ending = examination.device_failed, {}
    if examination.stopped:
        ending = {"error": examination.stopped, "exit_status": INTERRUPTED}
    elif failed is not None:
        ending = {"error": failed.failure, "exit_status": failed.exit_status}
    made = zip(examination.exchanges, examination.verdicts, strict=True)
    return {
        **pick(examination, "scene rate_hz steps seconds_each=seconds machine grants load shortest_sleep_s"),
        "wakeups": [{"rate_hz": rate, "lateness": _durations(one)} for rate, one in examination.wakeups.items()],
        "exchanges": [_exchanges_document(run, verdict) for run, verdict in made],
        "in_time_means": IN_TIME,
        **pick(examination, "best_rates_hz=best_rates advice stopped_after_steps=stopped_after"),
        **ending,
    }


def _exchanges_document(run: Exchanges, verdict: Verdict) -> dict[str, Any]:
    return {
        **pick(run, "rate_hz clock where"),
        **pick(verdict, "answer share_in_time"),
        **pick(run.report, "ticks deadline_misses lost_frames kept_rate_hz=rate_hz"),
        "lateness": run.lateness and _durations(run.lateness),
        "exchange": run.exchange and _durations(run.exchange),
        "failure": run.failure or None,
    }


def _durations(histogram: Histogram) -> dict[str, Any]:
    edges = histogram.edges.tolist()
    bins = [[edges[i], edges[i + 1], int(in_bin)] for i, in_bin in enumerate(histogram.counts) if in_bin]
    spread = pick(histogram.spread(), "count p50_s=p50 p99_s=p99 p999_s=p999 max_s=max")
    return spread | {"bins_from_s_to_s_count": bins}


_BINS_AN_OCTAVE = 16
_EIGHTHS = " ▏▎▍▌▋▊▉█"
_LEAST_BAR, _MOST_BAR = 8, 56
_QUANTILES = (("p50", 0.5), ("p99", 0.99), ("99.9 %", 0.999), ("max", 1.0))


@dataclass(frozen=True)
class Row:
    """The counts of one range of values, in s."""

    begins: float
    ends: float
    count: int
    marks: tuple[str, ...]
    """Names of the values in it: p50, p99, max, …"""


def histogram_lines(
    histogram: Histogram, width: int, *, ascii_only: bool = False, marks: Mapping[str, float] | None = None
) -> list[str]:
    """Returns a histogram of durations as lines of at most `width` characters, as far as numbers and marks have room.

    `marks`: further values to mark, s, by name.
    """
    rows = histogram_rows(histogram, marks)
    if not rows:
        return ["nothing was counted"]
    total, most = sum(row.count for row in rows), max(row.count for row in rows)
    ranges = [_range(row) for row in rows]
    shares = [f"{row.count:>{len(str(most))}} {share_in_percent(row.count / total):>8}" for row in rows]
    texts = [f"{share} {' '.join(row.marks)}".rstrip() for share, row in zip(shares, rows, strict=True)]
    wide = max(map(len, ranges))
    length = min(max(width - wide - max(map(len, texts)) - 4, _LEAST_BAR), _MOST_BAR)
    lines = [
        f" {between:>{wide}} {_bar(row.count, most, length, ascii_only):<{length}} {text}".rstrip()
        for row, between, text in zip(rows, ranges, texts, strict=True)
    ]
    lines.append(f" {total} in all; bars are logarithmic in the count: one is {_bar(1, most, length, ascii_only)}")
    return [in_ascii(line) for line in lines] if ascii_only else lines


def histogram_rows(histogram: Histogram, marks: Mapping[str, float] | None = None) -> list[Row]:
    """Returns the bins merged to a row an octave, from the first that holds anything to the last; bin 0 is zero's
    alone, and a row of its own. [] if the histogram is empty."""
    if histogram.total == 0:
        return []
    starts = np.concatenate([[0], np.arange(1, histogram.counts.size, _BINS_AN_OCTAVE)])
    counts = np.add.reduceat(histogram.counts, starts).tolist()
    edges = histogram.edges[[*starts, -1]].tolist()
    values = {name: histogram.quantile(share) or 0.0 for name, share in _QUANTILES} | dict(marks or {})
    filled = np.flatnonzero(counts)
    return [
        Row(low, high, count, tuple(name for name, value in values.items() if low <= value < high))
        for low, high, count in list(zip(edges, edges[1:], counts, strict=False))[filled[0] : filled[-1] + 1]
    ]


def _range(row: Row) -> str:
    """Returns both ends of a row in the unit of the lower one: 65.5 –  81.9 µs."""
    if row.begins == 0.0:
        return "0"
    size, unit = time_unit(row.begins)
    low, high = (f"{value:.{3 if value < 1e3 else 4}g}" for value in (row.begins / size, row.ends / size))
    return f"{low:>4} – {high:>4} {unit}"


def _bar(count: int, most: int, width: int, ascii_only: bool) -> str:
    """Returns the bar of a count. One has 1 / (1 + lg most) of the width, and each factor of ten as much more."""
    if count == 0:
        return ""
    eighths = max(round(8.0 * width * (1.0 + math.log10(count)) / (1.0 + math.log10(most))), 1)
    if ascii_only:
        return "#" * max(eighths // 8, 1)
    return ("█" * (eighths // 8) + _EIGHTHS[eighths % 8]).rstrip()
