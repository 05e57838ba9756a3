"""Force over displacement: what the hand feels at each place, the picture that makers of buttons draw."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hapsim.chart import style
from hapsim.chart.figure import drawn_in, figure_to, legend_below, once
from hapsim.chart.hand import described
from hapsim.errors import UsageError
from hapsim.prediction import Region, predict
from hapsim.prediction.characteristic import hand_at
from hapsim.prediction.force_curve import error_of, places_within, snaps_of, view_of
from hapsim.scene import Scene
from hapsim.theory.arrays import Floats

_POINTS = 49  # of a region
_LEAST_ERROR, _MOST_ERROR = 1e-3, 1.0  # ends of the colours


class ForceChart(NamedTuple):
    """The numbers of the picture of one hand."""

    name: str
    regions: tuple[Region, ...]
    drawn: list[Region]  # those within the picture, that are taken where nothing is known
    position: list[Floats]  # of each of these, m
    force: list[Floats]  # N, with which a hand at rest pushes, without friction
    pushing: list[Floats]
    releasing: list[Floats]  # N, of a hand that moves up and down
    speed: float  # m/s
    what: str  # `force`, or of a rotary hand `torque`


def force_chart(scene: Scene, name: str, speed: float) -> ForceChart:
    """Returns the force over the position of the hand `name` at `speed` m/s. UsageError if it moves masses or hands."""
    scene.require_impedance("the picture shows the stiffness that is felt at each place")
    prediction = predict(scene)
    if name in prediction.coupled:
        raise UsageError(
            f"{name} {prediction.coupled[name]}: its force depends on more than its own position. Expected a hand "
            "whose links all end on grounds"
        )
    hand, regions = hand_at(scene, name), prediction.regions_of(name)
    low, high = view_of(hand, regions)
    drawn = [one for one in regions if one.piece.is_first and one.piece.low < high and one.piece.high > low]
    ends = [(max(one.piece.low, low), min(one.piece.high, high)) for one in drawn]
    position = [places_within(a, b, _POINTS) for a, b in ends]
    return ForceChart(
        name,
        regions,
        drawn,
        position,
        [hand.force(x) for x in position],
        [hand.moving_force(x, speed) for x in position],
        [hand.moving_force(x, -speed) for x in position],
        speed,
        "torque" if scene.units_of(scene.device_points[name].channel).is_rotary else "force",
    )


def columns_of(chart: ForceChart) -> dict[str, Any]:
    """Returns what is drawn, by the names that a data file uses; k, b and the error of each point's region."""

    def each(values: list[Any]) -> Any:
        return np.repeat(values, _POINTS)

    held = [(one.felt.k, one.felt.b) if one.kind == "held" else (math.nan, math.nan) for one in chart.drawn]
    return {
        "position_m": np.concatenate(chart.position),
        "force_N": np.concatenate(chart.force),
        "force_pushing_N": np.concatenate(chart.pushing),
        "force_releasing_N": np.concatenate(chart.releasing),
        "region": each(list(range(len(chart.drawn)))),
        "K": each([one.piece.stiffness for one in chart.drawn]),
        "B": each([one.piece.damping for one in chart.drawn]),
        "k": each([k for k, _ in held]),
        "b": each([b for _, b in held]),
        "error": each([error_of(one) for one in chart.drawn]),
        "stable": each([int(one.is_stable) for one in chart.drawn]),
    }


def draw_force(chart: ForceChart, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    colours = ScalarMappable(LogNorm(_LEAST_ERROR, _MOST_ERROR), mpl.colormaps[style.FELT_ERROR])
    with figure_to(path, 8.0, 4.8) as figure:
        axes, units = figure.add_subplot(), drawn_in()
        labels = set[str]()
        for region, x, newtons in zip(chart.drawn, chart.position, chart.force, strict=True):
            force = units.scaled(newtons, "N")
            error, mm = error_of(region), units.scaled(x, "mm")
            if not region.is_stable:
                axes.axvspan(mm[0], mm[-1], label=once("unstable", labels), **style.UNSTABLE_REGION)
            if region.kind == "snap":
                axes.axvspan(mm[0], mm[-1], label=once("snap", labels), **style.SNAP)
            look = (
                style.NOT_HELD if math.isnan(error) else {"color": colours.to_rgba(np.array(max(error, _LEAST_ERROR)))}
            )
            axes.plot(mm, force, **(style.FORCE | look))
        for at, energy in snaps_of(chart.drawn):
            place, label = float(units.scaled(at, "mm")), units(energy, "mJ", 3)
            axes.text(place, 0.98, label, transform=axes.get_xaxis_transform(), **style.SNAP_ENERGY)
        x = units.scaled(np.concatenate(chart.position), "mm")
        up, down = (units.scaled(np.concatenate(one), "N") for one in (chart.pushing, chart.releasing))
        loop = f"friction and damping of the scene, moved at {units(chart.speed, 'm/s', 3)}"
        axes.fill_between(x, down, up, label=loop, **style.HYSTERESIS)
        axes.axhline(0.0, **style.ZERO_LINE)
        axes.set_xlabel(f"position of the hand ({units.name('mm')})")
        axes.set_ylabel(f"{chart.what} of the hand ({units.name('N')})")
        axes.set_title(f"{chart.name}: {described(chart.drawn[0].felt.configuration)}", fontsize=9)
        axes.margins(x=0.0)
        figure.colorbar(
            colours,
            ax=axes,
            label="error of felt k or b",
            extend="both",
            format=lambda value, _: f"{100.0 * value:g} %",
        )
        legend_below(figure, 3)
