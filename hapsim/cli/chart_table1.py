"""`hapsim chart table1`: the paper's Table 1."""

from __future__ import annotations

from typing import Annotated, Any, get_args

from hapsim.cli.chart_options import Channel, ChartOutput, hands_of
from hapsim.cli.live import live_line
from hapsim.cli.options import SceneFile, flag, load, option
from hapsim.cli.output import stderr, stdout, table
from hapsim.errors import UsageError
from hapsim.number_format import relative_difference
from hapsim.scene import choices
from hapsim.scene.issue import one_of


def table1(
    scene: SceneFile,
    *,
    channel: Channel = None,
    as_scene: Annotated[
        bool, flag("--as-scene", "Use the scene's hold, delay, friction and damping, not the paper's ideal loop.")
    ] = False,
    correction: Annotated[
        str | None, option("KIND", "poles or predictor [default: none; with --as-scene the scene's own]")
    ] = None,
    output: ChartOutput,
) -> None:
    """Couple the hand's mass with real and simulated springs, predicted and measured.

    This is Table 1 of the paper: a simulated spring is tuned to a real one, then two of either are coupled. The mock
    plays the device.
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
    with live_line(stderr()) as tell:
        chart = table1_of(hand, as_scene=as_scene, correction=corrected, on_progress=tell)
    tuned = f"K = {chart.K:.6g} N/m, k = {chart.k:.6g} N/m, correction: {corrected}"
    output.write(chart.columns, lambda path: draw_table1(chart, f"{tuned}; {described(chart.configuration)}", path))
    if not output.json:
        rows = [
            (
                one.numeral,
                f"{one.configuration.stiffness:.6g}",
                f"{one.K:.6g}",
                f"{one.predicted_hz:.9g}",
                f"{one.measured_hz:.9g}",
                relative_difference(one.measured_hz, one.predicted_hz),
                f"{chart.relative(one.numeral):.7f}",
            )
            for one in chart.couplings.values()
        ]
        headings = ("", "k  N/m", "K  N/m", "predicted  Hz", "measured  Hz", "off by", "of I")
        stdout().print(table("Table 1: a mass on real springs k and simulated springs K", headings, rows))
    columns = chart.columns()
    couplings = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    output.close({"scene": scene, "correction": corrected, "k": chart.k, "K": chart.K, "couplings": couplings})
