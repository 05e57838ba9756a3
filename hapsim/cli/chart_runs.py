"""`hapsim chart table1`, `speed-accuracy` and `trace`: charts of measurements, timings and records."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from hapsim.cli.chart_hand import Channel, ChartOutput, hands_of
from hapsim.cli.command_options import SceneFile, argument, flag, load, names, numbers, option, require_positive
from hapsim.cli.live import live_line, live_words
from hapsim.cli.output import print_line, set_output_units, stderr, stdout, table
from hapsim.errors import UsageError
from hapsim.number_format import relative_difference
from hapsim.recording.trace import load_trace
from hapsim.scene import choices
from hapsim.scene.issue import one_of

if TYPE_CHECKING:
    from hapsim.recording.trace import Trace


def table1(
    scene: SceneFile,
    *,
    channel: Channel = None,
    as_scene: bool = flag(
        "--as-scene", "Use the scene's hold, delay, friction and damping instead of the paper's ideal loop."
    ),
    correction: str | None = option(
        "KIND", "Correction: poles or predictor [default: none, or the scene's with --as-scene]"
    ),
    output: ChartOutput,
) -> None:
    """Draw Table 1 of the paper: a mass on real and simulated springs, predicted and measured.

    A simulated spring is tuned to a real one. Then two springs of either kind are coupled. The mock is the device.
    """
    from hapsim.chart.hand import described
    from hapsim.chart.table1 import draw_table1
    from hapsim.chart.table1 import table1 as table1_of

    output.choose("table1.svg")
    loaded = load(scene)
    hand, _ = hands_of(loaded, channel, {}, as_written=True)
    corrected: Any = correction
    if correction is None:
        corrected = loaded.device.correction if as_scene else "none"
    elif correction not in (known := get_args(choices.CorrectionName)):
        raise UsageError(f"--correction: found '{correction}', expected {one_of(known)}")
    with live_line(stderr()) as show_progress:
        chart = table1_of(hand, as_scene=as_scene, correction=corrected, on_progress=show_progress)
    units = loaded.units_of(hand.channel)
    tuned = f"K = {units(chart.K, 'N/m', '.6g')}, k = {units(chart.k, 'N/m', '.6g')}, correction: {corrected}"
    output.write(chart.columns, lambda path: draw_table1(chart, f"{tuned}; {described(chart.configuration)}", path))
    if not output.json:
        rows = [
            (
                one.numeral,
                units.number(one.configuration.stiffness, "N/m"),
                units.number(one.K, "N/m"),
                f"{one.predicted_hz:.9g}",
                f"{one.measured_hz:.9g}",
                relative_difference(one.measured_hz, one.predicted_hz),
                f"{chart.relative(one.numeral):.7f}",
            )
            for one in chart.couplings.values()
        ]
        unit = units.name("N/m")
        headings = ("", f"k  {unit}", f"K  {unit}", "predicted  Hz", "measured  Hz", "off by", "of I")
        stdout().print(table("Table 1: a mass on real springs k and simulated springs K", headings, rows))
    columns = chart.columns()
    couplings = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    output.close({"scene": scene, "correction": corrected, "k": chart.k, "K": chart.K, "couplings": couplings})


_OBJECTS = "spring, contact, string-10, string-100, string-1000, stiff-string-100"


def speed_accuracy(
    *,
    objects: list[str] | None = option("NAME", f"Objects, a list: {_OBJECTS} [default: all]", "--object"),
    schemes: list[str] | None = option("NAME", "Schemes, a list such as cordis,exact [default: all]", "--scheme"),
    rates: list[str] | None = option("HZ", "Sample rates in Hz, a list [default: 500 to 50000]", "--rates"),
    rounds: int = option("N", "Number of timings of each, in turns.", default=5),
    peers: Path | None = option("FILE.json", "Also draw peers, recorded by tools/bench/schemes.", "--with"),
    output: ChartOutput,
) -> None:
    """Draw computing time against error, for objects, schemes and sample rates.

    The error is the distance from the continuous object.
    """
    from hapsim.chart.speed_accuracy import draw_speed_accuracy
    from hapsim.speed_accuracy.comparison import RATES, compare, objects_named, schemes_named
    from hapsim.speed_accuracy.results import columns, fronts, peers_in, verdict

    chosen, by = objects_named(names(objects)), schemes_named(names(schemes))
    at = numbers("--rates", rates) or RATES
    for rate in at:
        require_positive("--rates", rate)
    if rounds < 1:
        raise UsageError(f"--rounds: found {rounds}, expected a whole number of at least 1")
    output.choose("speed-accuracy.svg")
    rows = [] if peers is None else peers_in(peers, [one.name for one in chosen])
    with live_words(stderr()) as show_progress:
        rows = compare(chosen, at, rounds, show_progress, by) + rows
    on_front = [row for front in fronts(rows).values() for row in front]
    output.write(lambda: columns(rows, on_front), lambda path: draw_speed_accuracy(chosen, rows, path))
    verdicts = {one.name: verdict(one, rows) for one in chosen}
    if not output.json:
        for sentence in verdicts.values():
            print_line(sentence)
    output.close({"objects": verdicts, "rows": rows})


def trace(
    file: Path = argument("FILE", "Trace (.npz, .trace), part that a crash left, or report file.", default=...),
    *,
    last: float | None = option("S", "Draw the last S seconds only [default: all]"),
    output: ChartOutput,
) -> None:
    """Draw a recorded trace: position and force over time.

    It marks the forces that were late, clipped, withheld or never sent. In the plane it draws each hand's path too.
    """
    from hapsim.chart.trace_chart import columns_of, draw_trace, seconds_of

    require_positive("--last", last, "seconds")
    output.choose("trace.svg")
    recorded = load_trace(file)
    set_output_units(recorded.report.units_of())
    if recorded.sample.size == 0:
        raise UsageError(f"{file}: it has no rows to draw")
    if last is not None:
        time = seconds_of(recorded)
        recorded = recorded.since(int((time < time[-1] - last).sum()))
    about = f"{file.name}: {_about(recorded)}"
    output.write(lambda: columns_of(recorded), lambda path: draw_trace(recorded, about, path))
    if not output.json:
        print_line(about)
    output.close({"trace": file, "rows": recorded.sample.size, "report": recorded.report})


def _about(recorded: Trace) -> str:
    drawn, report = recorded.sample.size, recorded.report
    if report.knows_ticks:
        return f"{drawn} of {report.ticks} ticks, {report.ending}"
    return report.ending if drawn == report.ticks else f"{drawn} ticks drawn; {report.ending}"
