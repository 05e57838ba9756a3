"""`hapsim chart plane`: which k and b every simulated K and B is felt as."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapsim.cli.arguments import Json, say_written
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
    SimulatedB,
    SimulatedK,
    Stiffness,
    hands_asked_for,
    in_paper_units,
    loop_options,
    print_json,
    save_rows,
    tell_of_hands,
    writable,
)
from hapsim.cli.options import numbers
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.chart.hand import Hand
    from hapsim.chart.scale import Scale
    from hapsim.chart.view import View


def plane(
    context: typer.Context,
    scene: MaybeScene = None,
    channel: Channel = None,
    mass: Annotated[
        list[str] | None,
        typer.Option(
            metavar="M",
            help="Hand and moving part, kg; several, 0.1,0.2,0.4, for a hand that nobody knows.",
        ),
    ] = None,
    rate: Rate = None,
    friction: Friction = None,  # noqa: ARG001
    stiffness: Stiffness = None,  # noqa: ARG001
    delay: Delay = None,  # noqa: ARG001
    hold: Hold = None,  # noqa: ARG001
    sampling: Sampling = None,  # noqa: ARG001
    damper: Damper = None,  # noqa: ARG001
    cutoff: Cutoff = None,  # noqa: ARG001
    simulated_stiffness: SimulatedK = None,
    simulated_damping: SimulatedB = None,
    normalised: Annotated[
        bool, typer.Option("--normalised", help="The paper's units, K T²/m and B T/m; --mass and --rate default to 1.")
    ] = False,
    total_damping: Annotated[
        bool, typer.Option("--total-damping", help="B + b0 on the axis, as in the paper's Figure 9.")
    ] = False,
    to_stiffness: Annotated[
        float | None, typer.Option(metavar="K", help="Where the K axis ends, in its unit; left out: found.")
    ] = None,
    to_damping: Annotated[
        float | None, typer.Option(metavar="B", help="Where the B axis ends, in its unit; left out: found.")
    ] = None,
    picture: Picture = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Draw the K,B plane: curves of equal k and b that the hand feels (the paper's Figures 7, 8 and 9).

    The options of the loop are in place of what SCENE says.
    """
    from hapsim.chart.scale import scale_of

    picture = writable(picture, data, json, "plane.svg")
    masses = numbers("--mass", mass)
    if normalised:
        masses, rate = in_paper_units(masses, rate, described_by_options=scene is None)
    given = loop_options(context, mass=masses[0] if masses else None, rate=rate)
    chosen, others = hands_asked_for(scene, channel, given, simulated_stiffness, simulated_damping)
    masses = masses or list(chosen.masses)
    drawn = _in_one_plane(chosen, others, masses)
    scale = scale_of(chosen.configuration, normalised=normalised, total=total_damping)
    view = _view(drawn, scale, total_damping, to_stiffness, to_damping)
    _draw_plane(drawn, len(masses) > 1, view, scale, normalised, picture, data)
    if json:
        print_json({"scene": scene, "hands": [hand.summary() for hand in drawn]}, picture, data)
        return
    tell_of_hands(drawn, [other for other in others if other not in drawn])
    say_written(picture, data)


def _in_one_plane(chosen: Hand, others: list[Hand], masses: list[float]) -> list[Hand]:
    """One hand of several masses; or all the hands that stand in the plane of the one that is asked for."""
    if len(masses) > 1:
        return [chosen.with_mass(mass) for mass in masses]
    return [chosen, *(other for other in others if other.configuration == chosen.configuration)]


def _view(
    drawn: list[Hand], scale: Scale, from_total: bool, to_stiffness: float | None, to_damping: float | None
) -> View:
    """The part of the plane that is drawn; its ends in the unit of `scale`, None where they are to be found."""
    from hapsim.chart.view import view_of

    return view_of(
        drawn,
        from_total=from_total,
        K_to=_end("--to-stiffness", to_stiffness, scale.stiffness),
        B_to=_end("--to-damping", to_damping, scale.damping, scale.offset),
    )


def _end(option: str, value: float | None, unit: float, offset: float = 0.0) -> float | None:
    """The end of an axis in SI units."""
    if value is None:
        return None
    if not 0.0 < value < float("inf"):
        raise UsageError(f"{option}: found {value:g}, expected a finite number above 0")
    return value * unit - offset


def _draw_plane(
    drawn: list[Hand],
    several_masses: bool,
    view: View,
    scale: Scale,
    normalised: bool,
    picture: Path | None,
    data: Path | None,
) -> None:
    """The plane, or the planes of several masses in one, to where they are asked for."""
    from hapsim.chart.family import draw_family, family
    from hapsim.chart.hand import described
    from hapsim.chart.plane import draw_plane
    from hapsim.chart.plane import plane as plane_of

    worked_out: Any = family(drawn, view, scale) if several_masses else plane_of(drawn, view, scale)
    save_rows(worked_out.columns(), data)
    if picture is not None:
        title = described(drawn[0].configuration, mass=not several_masses, normalised=normalised)
        (draw_family if several_masses else draw_plane)(worked_out, title, picture)
