"""A recording of force over distance, the curve made of it, and what the hand feels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hapsim.chart import style
from hapsim.chart.figure import drawn_in, figure_to, legend_below, once
from hapsim.curves.made_curve import MadeCurve

_BRANCHES = ("press", "release")


def columns_of(made: MadeCurve) -> dict[str, Any]:
    """Returns the points of the curve, and the force that the hand feels there."""
    names = _BRANCHES if made.curve.turn is not None else ("force",)
    columns: dict[str, Any] = {"distance_m": made.curve.x}
    for name, force, felt in zip(names, made.curve.branches, made.felt(), strict=True):
        columns |= {f"{name}_N": force, f"{name}_felt_N": felt}
    return columns


def draw_curve(made: MadeCurve, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    with figure_to(path, 8.0, 4.8) as figure:
        axes, units, labels = figure.add_subplot(), drawn_in(), set[str]()
        for one in made.steep:
            ends = units.scaled(np.array([one.low, one.high]), "mm")
            axes.axvspan(*ends, label=once("too steep for the device", labels), **style.UNSTABLE_REGION)
        for rows in made.recording.branches:
            mm, force = units.scaled(rows.x, "mm"), units.scaled(rows.force, "N")
            axes.plot(mm, force, label=once("recording", labels), **style.RESIDUAL, markersize=2)
        mm = units.scaled(made.curve.x, "mm")
        for force, felt in zip(made.curve.branches, made.felt(), strict=True):
            axes.plot(mm, units.scaled(force, "N"), label=once("curve", labels), **style.POINTS)
            axes.plot(mm, units.scaled(felt, "N"), label=once("felt by the hand", labels), **style.FELT | {"zorder": 4})
        axes.axhline(0.0, **style.ZERO_LINE)
        axes.set_xlabel(f"distance ({units.name('mm')})")
        axes.set_ylabel(f"{'torque' if units.is_rotary else 'force'} ({units.name('N')})")
        axes.margins(x=0.01)
        legend_below(figure, 4)
