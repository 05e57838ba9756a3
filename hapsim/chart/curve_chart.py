"""A recording of force over distance, the curve made of it, and what the hand feels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hapsim.chart import style
from hapsim.chart.figure import drawn_in, figure_to, legend_below, once
from hapsim.curves.made_curve import MadeCurve
from hapsim.theory.arrays import Floats

_BRANCHES = ("press", "release")


def columns_of(made: MadeCurve) -> dict[str, Any]:
    """Returns the points of the curve, and the stiffness that the hand feels from each to the next."""
    names = _BRANCHES if made.curve.turn is not None else ("force",)
    columns: dict[str, Any] = {"distance_m": made.curve.x}
    for name, force, felt in zip(names, made.curve.branches, made.felt(), strict=True):
        columns |= {f"{name}_N": force, f"{name}_felt_k_N_per_m": np.append(felt, np.nan)}
    return columns


def _as_felt(x: Floats, force: Floats, felt: Floats) -> tuple[Floats, Floats]:
    """Returns a line of the felt slope through the middle of each piece: m and N, with gaps."""
    ends = np.column_stack((x[:-1], x[1:]))
    middle = 0.5 * (force[:-1] + force[1:])[:, None]
    lines = middle + felt[:, None] * (ends - ends.mean(axis=1, keepdims=True))
    gaps = np.full((felt.size, 1), np.nan)
    return np.hstack((ends, gaps)).ravel(), np.hstack((lines, gaps)).ravel()


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
            ways, forces = _as_felt(made.curve.x, force, felt)
            look = style.FELT | {"zorder": 4}
            axes.plot(units.scaled(ways, "mm"), units.scaled(forces, "N"), label=once("felt slope", labels), **look)
        axes.axhline(0.0, **style.ZERO_LINE)
        axes.set_xlabel(f"distance ({units.name('mm')})")
        axes.set_ylabel(f"{'torque' if units.is_rotary else 'force'} ({units.name('N')})")
        axes.margins(x=0.01)
        legend_below(figure, 4)
