"""`hapsim chart plane`."""

from __future__ import annotations

from typing import Annotated

from hapsim.cli.chart_options import ChartOutput, HandOptions, SimulatedOptions, print_hands
from hapsim.cli.options import flag, numbers, option, require_positive


def plane(
    hand: HandOptions,
    simulated: SimulatedOptions,
    *,
    mass: Annotated[
        list[str] | None,
        option("M", "Mass of hand and handle, kg; a list (0.1,0.2,0.4) draws one family of curves per mass."),
    ] = None,
    normalised: Annotated[
        bool, flag("--normalised", "The paper's units, K T²/m and B T/m; --mass and --rate default to 1.")
    ] = False,
    total_damping: Annotated[
        bool, flag("--total-damping", "Put B + b0 on the axis, as in the paper's Figure 9.")
    ] = False,
    to_stiffness: Annotated[float | None, option("K", "End of the K axis, in its unit [default: automatic]")] = None,
    to_damping: Annotated[float | None, option("B", "End of the B axis, in its unit [default: automatic]")] = None,
    output: ChartOutput,
) -> None:
    """Draw the K,B plane: curves of equal k and b that the hand feels.

    These are Figures 7, 8 and 9 of the paper. Options of the hand take precedence over the scene's values.
    """
    from hapsim.chart.hand import described
    from hapsim.chart.plane import draw_plane
    from hapsim.chart.plane import plane as plane_of
    from hapsim.chart.plane_curves import scale_of, view_of

    output.choose("plane.svg")
    masses = numbers("--mass", mass)
    if normalised:
        hand, masses = hand.normalised(masses)
    chosen, others = hand.hands(masses[0] if masses else None, simulated.pair)
    masses = masses or list(chosen.masses)
    # One hand with each of several masses, or all the hands that share the plane of the chosen one.
    alike = [other for other in others if other.configuration == chosen.configuration]
    drawn = [chosen.with_mass(mass) for mass in masses] if len(masses) > 1 else [chosen, *alike]
    scale = scale_of(chosen.configuration, normalised=normalised, total=total_damping)
    K_to, B_to = (
        require_positive("--to-stiffness", to_stiffness),
        require_positive("--to-damping", to_damping),
    )
    view = view_of(
        drawn,
        from_total=total_damping,
        K_to=K_to and K_to * scale.stiffness,
        B_to=B_to and B_to * scale.damping - scale.offset,
    )
    chart = plane_of(drawn, view, scale)
    title = described(drawn[0].configuration, mass=len(masses) < 2, normalised=normalised)
    output.write(chart.columns, lambda path: draw_plane(chart, title, path))
    if not output.json:
        print_hands(drawn, [other for other in others if other not in drawn])
    output.close({"scene": hand.scene, "hands": [one.summary() for one in drawn]})
