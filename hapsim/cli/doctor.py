"""`hapsim doctor`."""

from __future__ import annotations

import contextlib
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hapsim.cli.as_json import document
from hapsim.cli.histogram import show_histogram
from hapsim.cli.options import (
    DataFile,
    Json,
    MockFlag,
    PictureFile,
    Port,
    Realtime,
    load,
    numbers,
    require_drawable,
    say_written,
    transport_kind,
)
from hapsim.cli.output import complain, fitted, stderr, stdout
from hapsim.doctor.examine import RATES_HZ, examine
from hapsim.doctor.exchanges import EXCHANGE, IN_TIME, MOCK, ON_THE_MOCK, Exchanges, Verdict
from hapsim.errors import UsageError
from hapsim.number_format import frequency, in_ascii, share_in_percent, short_duration
from hapsim.stopping import INTERRUPTED, ignore_stops

if TYPE_CHECKING:
    from hapsim.doctor.advice import Advice
    from hapsim.doctor.examine import Examination, Step
    from hapsim.doctor.machine import Machine
    from hapsim.loop.histogram import Histogram, Spread


def doctor(
    scene: Annotated[
        str | None, typer.Argument(metavar="[SCENE]", help="The scene whose device is tested [default: the mock].")
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
    picture: PictureFile = None,
    data: DataFile = None,
    json: Json = False,
) -> None:
    """Tell how steady this machine is for a haptic loop, which rates it keeps, and what would help.

    The test sends zero force only: the scene runs without its links.
    """

    if port is not None and scene is None:
        raise UsageError("--port: found no SCENE, expected the scene whose device is at that port")
    require_drawable(picture, data)
    with examination_line(stderr()) as tell:
        found = examine(
            None if scene is None else load(scene, port),
            seconds=seconds,
            rates=tuple(numbers("--rates", rates)) or RATES_HZ,
            realtime=realtime,
            transport=transport_kind(mock, None, port),
            on_progress=tell,
        )
    if found.stopped:
        ignore_stops()  # what is left takes no time worth stopping for
    if picture is not None or data is not None:
        from hapsim.chart.figure import save_rows
        from hapsim.chart.steadiness import columns, draw_steadiness, steadiness

        curves = steadiness(found)
        if data is not None:
            save_rows(columns(curves), data)
        if picture is not None:
            draw_steadiness(curves, f"How steady this machine is: {found.scene}, {seconds:g} s each", picture)
    if json:
        print(document(examination_document(found)))
    else:
        show_examination(stdout(), found)
        say_written(picture, data)
    if found.stopped:
        complain(f"hapsim: {found.stopped}")
        raise typer.Exit(INTERRUPTED)
    if found.device_failed is not None:
        complain(found.device_failed.failure)
        raise typer.Exit(found.device_failed.exit_status)


_COLOUR = {"yes": "green", "with gaps": "yellow", "no": "red", "no verdict": "red"}


@contextlib.contextmanager
def examination_line(error: Console) -> Iterator[Callable[[Step], None]]:
    """A function to tell progress to: on a terminal one line changes in place, elsewhere each measurement is a line."""
    if error.is_terminal:
        with error.status("starting") as status:
            yield lambda step: status.update(_now(step))
        return
    told: set[object] = set()

    def _tell(step: Step) -> None:
        if step.number not in told:
            told.add(step.number)
            error.print(f"{step.number} of {step.of}: {step.what}, {step.seconds:g} s", soft_wrap=True)
        if step.compiling and (step.number, "compiling") not in told:
            told.add((step.number, "compiling"))
            error.print("  compiling (only the first time, up to a minute)", soft_wrap=True)

    yield _tell


def _now(step: Step) -> str:
    what = f"{step.number} of {step.of}: {step.what}"
    if step.compiling:
        return f"{what}: compiling (only the first time), now {step.compiling}"
    return f"{what}: {min(step.elapsed_s, step.seconds):.1f} of {step.seconds:g} s"


def show_examination(out: Console, examination: Examination) -> None:
    """The machine, how late it wakes up, what rates it keeps, and what would help."""
    out.print(_machine(examination.machine))
    if examination.grants is not None:
        _show_grants(out, examination)
    out.print()
    out.print(_wakeups(out, examination.wakeups))
    rate = examination.rate_hz
    if rate in examination.wakeups:  # else it was stopped before
        out.print(f"\n[italic]Wake-ups at {frequency(rate)}, by how late they came[/italic]")
        show_histogram(out, examination.wakeups[rate], {"a period": 1.0 / rate})
    _show_exchanges(out, examination)
    _show_advice(out, examination.advice)


def _machine(machine: Machine) -> str:
    cores = f"{machine.cores_allowed or '?'} of {machine.cores_online or '?'} cores"
    told = [
        machine.cpu or "a processor that does not tell its name",
        cores + {True: " (two threads a core)"}.get(machine.smt or False, ""),
        f"Linux {machine.kernel}, {'PREEMPT_RT' if machine.preempt_rt else 'not a real-time kernel'}",
        f"clock {machine.clock_source}" if machine.clock_source else "",
        f"governor {', '.join(machine.governors)}" if machine.governors else "",
        f"cores kept free: {machine.isolated}" if machine.isolated else "",
        f"a virtual machine ({machine.virtual})" if machine.virtual else "",
    ]
    return escape("; ".join(filter(None, told)))


def _show_grants(out: Console, examination: Examination) -> None:
    for grant in examination.grants or ():
        # Why something was denied is said with what would help.
        answer = f"[green]granted[/green], {escape(grant.detail)}" if grant.granted else "[yellow]denied[/yellow]"
        out.print(f"{escape(grant.privilege)}: {answer}")


def _wakeups(out: Console, wakeups: dict[float, Histogram]) -> Table:
    table = Table(title="Wake-up latency of a sleeping thread", title_justify="left")
    for heading in ("rate", "p50", "p99", "99.9 %", "latest", "wake-ups", "a period late"):
        table.add_column(heading, justify="right")
    for rate, histogram in wakeups.items():
        spread = histogram.spread()
        late = share_in_percent(histogram.share_above(1.0 / rate)) if spread.count else "–"
        times = map(short_duration, (spread.p50, spread.p99, spread.p999, spread.max))
        table.add_row(*_fit_for(out, frequency(rate), *times, str(spread.count), late))
    return table


def _show_exchanges(out: Console, examination: Examination) -> None:
    """A table a clock: side by side they would not fit an ordinary terminal."""
    made = list(zip(examination.exchanges, examination.verdicts, strict=True))
    for clock in dict.fromkeys(run.clock for run, _ in made):
        of_clock = [(run, verdict) for run, verdict in made if run.clock == clock]
        verdicts = [verdict for _, verdict in of_clock]
        where = "the mock" if of_clock[0][0].where == MOCK else f"{of_clock[0][0].where}, sent zero force"
        # Above the table, not its title: that would be folded to the table's width.
        heading = fitted(f"Exchanges of {examination.scene} on {where}; clock: {clock}", out.width, indent="")
        out.print(f"\n{heading}", style="italic", markup=False, soft_wrap=True)
        out.print(_exchanges(out, of_clock))
        beware = f" {ON_THE_MOCK}" if clock == "device" and clock in examination.best_rates else ""
        out.print(f"{EXCHANGE[clock]} {IN_TIME[clock]}{beware}")
        if clock in examination.best_rates:
            out.print(f"[bold]{_conclusion(examination.best_rates[clock], clock, verdicts)}[/bold]")
        out.print(escape("; ".join(verdict.sentence for verdict in verdicts)) + ".")


def _exchanges(out: Console, made: list[tuple[Exchanges, Verdict]]) -> Table:
    table = Table()
    for heading in ("rate", "kept", "p50", "p99", "max", "in time", "keeps up"):
        table.add_column(heading, justify="left" if heading == "keeps up" else "right")
    for run, verdict in made:
        spread = None if run.exchange is None else run.exchange.spread()
        quantiles = (None,) * 3 if spread is None else (spread.p50, spread.p99, spread.max)
        in_time = "–" if verdict.share_in_time is None else share_in_percent(verdict.share_in_time)
        kept = "–" if run.share_of_rate is None else f"{100.0 * run.share_of_rate:.1f} %"
        answer = f"[{_COLOUR[verdict.answer]}]{verdict.answer}[/]"
        told = (frequency(run.rate_hz), kept, *map(short_duration, quantiles), in_time)
        table.add_row(*_fit_for(out, *told), answer)
    return table


def _fit_for(out: Console, *told: str) -> list[str]:
    return [in_ascii(one) for one in told] if out.options.ascii_only else list(told)


def _conclusion(best: float | None, clock: str, verdicts: list[Verdict]) -> str:
    if best is None and all(verdict.answer == "no verdict" for verdict in verdicts):
        return f"With clock: {clock} nothing can be said of any of these rates."
    kept = "none of these rates without gaps" if best is None else f"up to {frequency(best)}"
    return f"With clock: {clock} this machine keeps {kept}."


def _show_advice(out: Console, advice: tuple[Advice, ...]) -> None:
    if not advice:
        out.print("\nNothing was found that could be set better.")
        return
    out.print("\n[bold]What would help[/bold]")
    for number, one in enumerate(advice, start=1):
        _print_indented(out, f"{number:2}. ", one.found, style="bold")
        _print_indented(out, "    ", f"{one.why} {one.do}")
        for command in one.commands:
            # Whole, however long: it is to be copied.
            out.print(f"      {command}", markup=False, soft_wrap=True)


def _print_indented(out: Console, indent: str, text: str, style: str = "") -> None:
    lines = textwrap.fill(text, max(out.width, 40), initial_indent=indent, subsequent_indent=" " * len(indent))
    out.print(lines, markup=False, soft_wrap=True, style=style)


def examination_document(examination: Examination) -> dict[str, Any]:
    """What `hapsim doctor --json` prints: plain values, durations in s with names that end in _s."""
    failed = examination.device_failed
    return {
        "scene": examination.scene,
        "rate_hz": examination.rate_hz,
        "seconds_each": examination.seconds,
        "machine": asdict(examination.machine),
        "grants": None if examination.grants is None else [_grant(grant) for grant in examination.grants],
        "load": None if examination.load is None else asdict(examination.load),
        "wakeups": [
            {"rate_hz": rate, "lateness": _durations(histogram)} for rate, histogram in examination.wakeups.items()
        ],
        "exchanges": [
            _exchanges_document(run, verdict)
            for run, verdict in zip(examination.exchanges, examination.verdicts, strict=True)
        ],
        "in_time_means": IN_TIME,
        "best_rates_hz": examination.best_rates,
        "advice": [asdict(one) for one in examination.advice],
        "steps": examination.steps,
        "stopped_after_steps": examination.stopped_after,
    } | (
        {"error": examination.stopped, "exit_status": INTERRUPTED}
        if examination.stopped
        else {}
        if failed is None
        else {"error": failed.failure, "exit_status": failed.exit_status}
    )


def _grant(grant: Any) -> dict[str, Any]:
    return {"privilege": grant.privilege, "granted": grant.granted, "detail": grant.detail}


def _exchanges_document(run: Exchanges, verdict: Verdict) -> dict[str, Any]:
    report = run.report
    return {
        "rate_hz": run.rate_hz,
        "clock": run.clock,
        "where": run.where,
        "answer": verdict.answer,
        "share_in_time": verdict.share_in_time,
        "ticks": None if report is None else report.ticks,
        "deadline_misses": None if report is None else report.deadline_misses,
        "lost_frames": None if report is None else report.lost_frames,
        "kept_rate_hz": None if report is None else report.rate_hz,
        "lateness": None if run.lateness is None else _durations(run.lateness),
        "exchange": None if run.exchange is None else _durations(run.exchange),
        "failure": run.failure or None,
    }


def _durations(histogram: Histogram) -> dict[str, Any]:
    spread: Spread = histogram.spread()
    edges = histogram.edges
    return {
        "count": spread.count,
        "p50_s": spread.p50,
        "p99_s": spread.p99,
        "p999_s": spread.p999,
        "max_s": spread.max,
        "bins_from_s_to_s_count": [
            [float(edges[i]), float(edges[i + 1]), int(count)] for i, count in enumerate(histogram.counts) if count
        ],
    }
