"""`hapsim chart felt`."""

from __future__ import annotations

from typing import Annotated

from hapsim.cli.chart_options import ChartOutput, HandOptions, Mass
from hapsim.cli.options import flag
from hapsim.cli.output import say, stdout, table
from hapsim.number_format import percent


def felt(
    hand: HandOptions,
    *,
    mass: Mass = None,
    normalised: Annotated[bool, flag("--normalised", "The paper's units; --mass and --rate default to 1.")] = False,
    output: ChartOutput,
) -> None:
    """Draw which desired stiffness and damping the hand feels, with each correction.

    Options of the hand take precedence over the scene's values (configs/README.md has an example).
    """
    from hapsim.chart.felt import WITHIN, draw_felt, felt_chart
    from hapsim.chart.hand import described

    output.choose("felt.svg")
    masses = [] if mass is None else [mass]
    if normalised:
        hand, masses = hand.normalised(masses)
    chosen, _ = hand.hands(masses[0] if masses else None, as_written=True)
    chart = felt_chart(chosen)
    title = described(chosen.configuration, normalised=normalised)
    output.write(chart.columns, lambda path: draw_felt(chart, title, path))
    if not output.json:
        headings = ("<correction", *(percent(within, 3) for within in WITHIN))
        rows = [(name, *(percent(felt.share(within), 3) for within in WITHIN)) for name, felt in chart.felt.items()]
        stdout().print(table("Share of the plane felt within", headings, rows))
        say(
            f"Limit of any controller: {percent(chart.limit, 3)}, the motions below half the rate; samples do not "
            "distinguish faster ones. Where no (K, B) is felt as desired, hapsim simulates the nearest, which counts "
            "here as not felt."
        )
    output.close({"scene": hand.scene, **chart.summary()} if output.json else {})
