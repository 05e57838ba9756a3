"""`hapsim chart transparency`: the rendered impedance beside the desired one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

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
    SimulatedB,
    SimulatedK,
    Stiffness,
    hands_asked_for,
    loop_options,
    print_json,
    tell_of_hands,
    writable,
)
from hapsim.errors import UsageError

if TYPE_CHECKING:
    pass


def transparency(
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
    simulated_stiffness: SimulatedK = None,
    simulated_damping: SimulatedB = None,
    picture: Picture = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Draw the rendered impedance beside the desired one, from frequency to frequency (Figure 2).

    The options of the loop are in place of what SCENE says.
    """
    from hapsim.chart.figure import save_columns
    from hapsim.chart.hand import described
    from hapsim.chart.transparency import draw_transparency
    from hapsim.chart.transparency import transparency as transparency_of

    picture = writable(picture, data, json, "transparency.svg")
    given = loop_options(context, mass=mass, rate=rate)
    hand, _ = hands_asked_for(scene, channel, given, simulated_stiffness, simulated_damping)
    if not hand.is_simulated:
        raise UsageError("--simulated-stiffness is missing: without a SCENE, it says what is simulated")
    worked_out = transparency_of(hand)
    if data is not None:
        save_columns(worked_out.columns(), data)
    if picture is not None:
        simulated = f"K = {hand.stiffness:.6g} N/m, B = {hand.damping:.6g} N·s/m"
        draw_transparency(worked_out, f"{simulated}; {described(hand.configuration)}", picture)
    bands = worked_out.gives_energy()
    if json:
        print_json({"scene": scene, "hand": hand.summary(), "gives_energy_hz": bands}, picture, data)
        return
    tell_of_hands([hand], [])
    frequency = worked_out.frequency
    words = ", ".join(_band(low, high, frequency[0], frequency[-1]) for low, high in bands)
    said = f"The wall gives the hand energy {words}." if bands else "At no frequency does the wall give energy."
    stdout().print(said)
    say_written(picture, data)


def _band(low: float, high: float, first: float, last: float) -> str:
    """Where a band begins or ends with the picture, that is no property of the wall."""
    if low <= first:
        return "at every frequency drawn" if high >= last else f"below {high:.4g} Hz"
    return f"above {low:.4g} Hz" if high >= last else f"from {low:.4g} to {high:.4g} Hz"
