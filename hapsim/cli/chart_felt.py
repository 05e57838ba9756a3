"""`hapsim chart felt`: which part of what a scene may ask for the hand feels, with every correction."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapsim.cli.arguments import Json, say_written, stdout
from hapsim.cli.chart_options import (
    Channel,
    Cutoff,
    Damper,
    Data,
    Delay,
    Friction,
    Hold,
    MaybeScene,
    Picture,
    Rate,
    Sampling,
    Stiffness,
    hands_asked_for,
    in_paper_units,
    loop_options,
    print_json,
    save_rows,
    writable,
)
from hapsim.cli.sentences import say

if TYPE_CHECKING:
    from hapsim.chart.felt import FeltChart


def felt(
    context: typer.Context,
    scene: MaybeScene = None,
    channel: Channel = None,
    mass: Annotated[float | None, typer.Option(metavar="M", help="Hand and moving part, kg.")] = None,
    rate: Rate = None,
    friction: Friction = None,  # noqa: ARG001
    stiffness: Stiffness = None,  # noqa: ARG001
    delay: Delay = None,  # noqa: ARG001
    hold: Hold = None,  # noqa: ARG001
    sampling: Sampling = None,  # noqa: ARG001
    damper: Damper = None,  # noqa: ARG001
    cutoff: Cutoff = None,  # noqa: ARG001
    normalised: Annotated[
        bool, typer.Option("--normalised", help="--mass and --rate default to 1, the paper's units.")
    ] = False,
    picture: Picture = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Draw which desired stiffness and damping the hand feels, with every correction (configs/README.md).

    The options of the loop are in place of what SCENE says.
    """
    from hapsim.chart.felt import felt_chart
    from hapsim.chart.felt_picture import draw_felt
    from hapsim.chart.hand import described

    picture = writable(picture, data, json, "felt.svg")
    masses = [] if mass is None else [mass]
    if normalised:
        masses, rate = in_paper_units(masses, rate, described_by_options=scene is None)
    given = loop_options(context, mass=masses[0] if masses else None, rate=rate)
    hand, _ = hands_asked_for(scene, channel, given, as_written=True)
    worked_out = felt_chart(hand)
    save_rows(worked_out.columns() if data is not None else {}, data)
    if picture is not None:
        draw_felt(worked_out, described(hand.configuration, normalised=normalised), picture)
    if json:
        print_json({"scene": scene, **worked_out.summary()}, picture, data)
        return
    stdout().print(_table(worked_out))
    say(_limit(worked_out))
    say_written(picture, data)


def _table(chart: FeltChart) -> Any:
    from rich.table import Table

    from hapsim.chart.felt import WITHIN

    table = Table(title="Share of the plane felt within", title_justify="left")
    table.add_column("correction")
    for within in WITHIN:
        table.add_column(f"{100.0 * within:.0f} %", justify="right")
    for name, felt in chart.felt.items():
        table.add_row(name, *(f"{100.0 * felt.share(within):.1f} %" for within in WITHIN))
    return table


def _limit(chart: FeltChart) -> str:
    return (
        f"Any controller: {100.0 * chart.limit:.1f} % at most, what swings below half the rate; samples do not tell "
        "a faster swing from a slower one. Where no (K, B) is felt as desired, hapsim simulates the nearest; here it "
        "counts as not felt."
    )
