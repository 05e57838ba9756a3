"""`hapsim chart force`."""

from __future__ import annotations

from typing import Annotated

from hapsim.cli.chart_options import Channel, ChartOutput
from hapsim.cli.check_regions import regions_document, show_hand
from hapsim.cli.options import SceneFile, load, option, require_positive
from hapsim.cli.output import speak_of, stdout
from hapsim.errors import UsageError

_SPEED = {"linear": 0.05, "rotary": 2.0}


def force(
    scene: SceneFile,
    *,
    channel: Channel = None,
    speed: Annotated[
        float | None,
        option("V", "Speed of the hand for the loop of friction and damping [default: 0.05 m/s or 2 rad/s]."),
    ] = None,
    output: ChartOutput,
) -> None:
    """Draw force over displacement: what the hand feels at each place.

    The colour is the difference between felt and asked for. Unstable regions are hatched.
    """
    from hapsim.chart.force import columns_of, draw_force, force_chart

    output.choose("force.svg")
    require_positive("--speed", speed, "m/s")
    loaded = load(scene)
    hands = {point.channel: name for name, point in loaded.device_points.items()}
    name = hands.get(min(hands) if channel is None else channel)
    if name is None:
        known = ", ".join(map(str, hands))
        raise UsageError(f"--channel {channel}: the scene has nothing there; its device points are on: {known}")
    speak_of(loaded.device_points[name].channel)
    if speed is None:
        speed = _SPEED[loaded.device.motions(loaded.channels)[loaded.device_points[name].channel]]
    chart = force_chart(loaded, name, speed)
    output.write(lambda: columns_of(chart), lambda path: draw_force(chart, path))
    if not output.json:
        show_hand(stdout(), name, chart.regions)
    output.close({"scene": scene, "name": name, "speed_m_s": speed, "regions": regions_document(chart.regions)})
