"""`hapsim chart transparency`."""

from __future__ import annotations

from hapsim.cli.chart_options import ChartOutput, HandOptions, Mass, SimulatedOptions, print_hands
from hapsim.cli.output import stdout
from hapsim.errors import UsageError


def transparency(
    hand: HandOptions,
    simulated: SimulatedOptions,
    *,
    mass: Mass = None,
    output: ChartOutput,
) -> None:
    """Draw the rendered impedance beside the desired one, over frequency.

    This is Figure 2 of the paper. Options of the hand take precedence over the scene's values.
    """
    from hapsim.chart.hand import described
    from hapsim.chart.impedance import draw_transparency
    from hapsim.chart.impedance import transparency as transparency_of

    output.choose("transparency.svg")
    chosen, _ = hand.hands(mass, simulated.pair)
    if not chosen.is_simulated:
        raise UsageError("--simulated-stiffness is missing: without a SCENE, it says what is simulated")
    chart = transparency_of(chosen)
    pair = f"K = {chosen.stiffness:.6g} N/m, B = {chosen.damping:.6g} N·s/m"
    title = f"{pair}; {described(chosen.configuration)}"
    output.write(chart.columns, lambda path: draw_transparency(chart, title, path))
    bands = chart.gives_energy()
    if not output.json:
        print_hands([chosen], [])
        words = ", ".join(_band(low, high, chart.frequency[0], chart.frequency[-1]) for low, high in bands)
        stdout().print(
            f"The wall gives the hand energy {words}." if bands else "At no frequency does the wall give energy."
        )
    output.close({"scene": hand.scene, "hand": chosen.summary(), "gives_energy_hz": bands})


def _band(low: float, high: float, first: float, last: float) -> str:
    """Returns a band in words; where it ends with the picture, the end is no property of the wall."""
    if low <= first:
        return "at every frequency drawn" if high >= last else f"below {high:.4g} Hz"
    return f"above {low:.4g} Hz" if high >= last else f"from {low:.4g} to {high:.4g} Hz"
