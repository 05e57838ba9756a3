"""`hapsim chart plane`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from hapsim.cli.chart_options import ChartOutput, HandOptions, SimulatedOptions, print_hands
from hapsim.cli.options import numbers
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.chart.hand import Hand
    from hapsim.chart.plane_curves import Scale, View


def plane(
    hand: HandOptions,
    simulated: SimulatedOptions,
    *,
    mass: Annotated[
        list[str] | None,
        typer.Option(
            metavar="M",
            help="Mass of hand and handle, kg; a list (0.1,0.2,0.4) draws one family of curves per mass.",
        ),
    ] = None,
    normalised: Annotated[
        bool, typer.Option("--normalised", help="The paper's units, K T²/m and B T/m; --mass and --rate default to 1.")
    ] = False,
    total_damping: Annotated[
        bool, typer.Option("--total-damping", help="Put B + b0 on the axis, as in the paper's Figure 9.")
    ] = False,
    to_stiffness: Annotated[
        float | None, typer.Option(metavar="K", help="End of the K axis, in its unit [default: automatic]")
    ] = None,
    to_damping: Annotated[
        float | None, typer.Option(metavar="B", help="End of the B axis, in its unit [default: automatic]")
    ] = None,
    output: ChartOutput,
) -> None:
    """Draw the K,B plane: curves of equal k and b that the hand feels.

    These are Figures 7, 8 and 9 of the paper. Options of the hand take precedence over the scene's values.
    """
    from hapsim.chart.plane_curves import scale_of, view_of

    output.require_writable("plane.svg")
    masses = numbers("--mass", mass)
    if normalised:
        hand, masses = hand.normalised(masses)
    chosen, others = hand.hands(masses[0] if masses else None, simulated.pair)
    masses = masses or list(chosen.masses)
    drawn = _in_one_plane(chosen, others, masses)
    scale = scale_of(chosen.configuration, normalised=normalised, total=total_damping)
    view = view_of(
        drawn,
        from_total=total_damping,
        K_to=_end("--to-stiffness", to_stiffness, scale.stiffness),
        B_to=_end("--to-damping", to_damping, scale.damping, scale.offset),
    )
    _draw_plane(drawn, len(masses) > 1, view, scale, normalised, output)
    if not output.json:
        print_hands(drawn, [other for other in others if other not in drawn])
    output.close({"scene": hand.scene, "hands": [one.summary() for one in drawn]})


def _in_one_plane(chosen: Hand, others: list[Hand], masses: list[float]) -> list[Hand]:
    """Returns one hand with each of several masses; or all the hands that share the plane of the chosen one."""
    if len(masses) > 1:
        return [chosen.with_mass(mass) for mass in masses]
    return [chosen, *(other for other in others if other.configuration == chosen.configuration)]


def _end(option: str, value: float | None, unit: float, offset: float = 0.0) -> float | None:
    """Returns the end of an axis in SI units; None: automatic. Raises UsageError."""
    if value is None:
        return None
    if not 0.0 < value < float("inf"):
        raise UsageError(f"{option}: found {value:g}, expected a finite number above 0")
    return value * unit - offset


def _draw_plane(
    drawn: list[Hand], several_masses: bool, view: View, scale: Scale, normalised: bool, output: ChartOutput
) -> None:
    """Draws the plane, or a family of curves per mass, and writes the numbers."""
    from hapsim.chart.hand import described
    from hapsim.chart.plane import draw_plane
    from hapsim.chart.plane import plane as plane_of

    chart = plane_of(drawn, view, scale)
    output.save_rows(chart.columns())
    if output.picture is not None:
        title = described(drawn[0].configuration, mass=not several_masses, normalised=normalised)
        draw_plane(chart, title, output.picture)
