"""`hapsim chart transparency`."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from hapsim.cli.chart_options import ChartOutput, HandOptions, Mass, SimulatedOptions, print_hands
from hapsim.cli.options import load, scene_name
from hapsim.cli.output import speak_of, stdout
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.chart.impedance import Transparency


def transparency(
    hand: HandOptions,
    simulated: SimulatedOptions,
    *,
    mass: Mass = None,
    output: ChartOutput,
) -> None:
    """Draw the rendered impedance beside the desired one, over frequency.

    This is Figure 2 of the paper; beside it are k and b, the spring and damper of the same force. Options of the hand
    take precedence over the scene's values, unless it moves masses or another hand.
    """
    from hapsim.chart.hand import described
    from hapsim.chart.impedance import draw_transparency
    from hapsim.chart.impedance import transparency as transparency_of

    output.choose("transparency.svg")
    if (found := _of_scene(hand, simulated, mass)) is not None:
        chart, title, summary = found
    else:
        chosen, _ = hand.hands(mass, simulated.pair)
        if not chosen.is_simulated:
            raise UsageError("--simulated-stiffness is missing: without a SCENE, it says what is simulated")
        chart, summary = transparency_of(chosen), chosen.summary()
        pair = f"K = {chosen.stiffness:.6g} N/m, B = {chosen.damping:.6g} N·s/m"
        title = f"{pair}; {described(chosen.configuration)}"
        if not output.json:
            print_hands([chosen], [])
    output.write(chart.columns, lambda path: draw_transparency(chart, title, path))
    bands = chart.gives_energy()
    if not output.json:
        words = ", ".join(_band(low, high, chart.frequency[0], chart.frequency[-1]) for low, high in bands)
        stdout().print(
            f"The scene gives the hand energy {words}." if bands else "At no frequency does the scene give energy."
        )
    output.close({"scene": hand.scene, "hand": summary, "gives_energy_hz": bands})


def _of_scene(
    hand: HandOptions, simulated: SimulatedOptions, mass: float | None
) -> tuple[Transparency, str, dict[str, Any]] | None:
    """Returns the chart of a hand that moves more than itself, or that a predictor answers, its title and what scripts
    read; None for another. UsageError where an option describes another hand."""
    if hand.scene is None:
        return None
    from hapsim.chart.impedance import transparency_in
    from hapsim.prediction import predict

    scene = load(hand.scene)
    prediction = predict(scene, with_margins=False)
    points = [(name, point.channel) for name, point in scene.device_points.items()]
    name, channel = next((one for one in points if hand.channel in (None, one[1])), (None, 0))
    lone = next((one for one in prediction.felt if one.name == name), None)
    if name is None or (lone is not None and lone.predictor is None):
        return None
    given = {"mass": mass, **asdict(hand), **asdict(simulated)}
    if others := [one for one, value in given.items() if value is not None and one not in ("scene", "channel")]:
        why = prediction.coupled.get(name, "is answered by a predictor")
        raise UsageError(f"--{others[0].replace('_', '-')}: {name} {why}; it is drawn as it is, leave that out")
    speak_of(channel)
    shared = next((one for one in prediction.together if name in one.names), None)
    motion = lone or (shared and shared.own_motion)
    chart = transparency_in(prediction, name, motion.frequency_hz if motion else math.nan)
    summary = {"name": name, "channel": channel, "k": motion and motion.k, "b": motion and motion.b}
    title = f"{name} of {scene_name(hand.scene)}, {scene.rate:g} Hz"
    return chart, title, summary | {"frequency_hz": chart.eigenfrequency}


def _band(low: float, high: float, first: float, last: float) -> str:
    """Returns a band in words; where it ends with the picture, the end is no property of the wall."""
    if low <= first:
        return "at every frequency drawn" if high >= last else f"below {high:.4g} Hz"
    return f"above {low:.4g} Hz" if high >= last else f"from {low:.4g} to {high:.4g} Hz"
