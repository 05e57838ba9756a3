"""`hapsim chart felt`."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Annotated, Any

from hapsim.cli.chart_options import ChartOutput, HandOptions, Mass
from hapsim.cli.options import flag, load, option
from hapsim.cli.output import say, stdout, table
from hapsim.errors import UsageError
from hapsim.number_format import number, percent


def felt(
    hand: HandOptions,
    *,
    mass: Mass = None,
    normalised: Annotated[bool, flag("--normalised", "The paper's units; --mass and --rate default to 1.")] = False,
    over: Annotated[
        str | None, option("PATH", "How far off the scene's k and b are over device.mass, .friction or .delay.")
    ] = None,
    output: ChartOutput,
) -> None:
    """Draw which desired stiffness and damping the hand feels, with each correction.

    Options of the hand take precedence over the scene's values (configs/README.md has an example).
    """
    if over is not None:
        _tolerance(hand, over, [mass, normalised or None], output)
        return
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


def _tolerance(hand: HandOptions, over: str, others: list[Any], output: ChartOutput) -> None:
    """Draws how far off k and b of a scene's hand are where the device is not the declared one."""
    from hapsim.chart.felt import SHARES, draw_tolerance, tolerance_chart

    given = {name: value for name, value in asdict(hand).items() if value is not None}
    if hand.scene is None or others != [None, None] or given.keys() - {"scene", "channel"}:
        raise UsageError("--over: it is drawn for the hand of a SCENE as that is: name one, leave out what changes it")
    output.choose("tolerance.svg")
    chosen, _ = hand.hands(None, as_written=True)
    chart = tolerance_chart(load(hand.scene), chosen.name, over)
    output.write(chart.columns, lambda path: draw_tolerance(chart, f"{chosen.name} of {hand.scene}", path))
    ends = {name: chart.ends(name) for name in chart.within}
    if not output.json:
        headings = (f"<{over}, correction", *(f"within {percent(share, 2)}" for share in SHARES))
        rows = [(name, *map(_span, of_one)) for name, of_one in ends.items()]
        stdout().print(table("The device may be, for k and b to be felt as desired", headings, rows))
    output.close({"scene": hand.scene, "hand": chosen.name, "over": over, "shares": SHARES, "within": ends})


def _span(ends: tuple[float, float] | None) -> str:
    if ends is None:
        return "–"
    low, high = ends
    return f"{number(low, 4)} to {number(high, 4) if math.isfinite(high) else 'any'}"
