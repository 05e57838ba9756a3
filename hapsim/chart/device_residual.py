"""What the fit of a device leaves: over time, over velocity, over position."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from hapsim.chart import style
from hapsim.chart.figure import figure_to, legend_below
from hapsim.measuring.device_misfit import BINS, binned
from hapsim.measuring.identify_device import DeviceIdentification
from hapsim.number_format import rounded
from hapsim.theory.arrays import Floats

_MOST_POINTS = 20000  # of a picture; its data have all


def residual_columns(found: DeviceIdentification) -> dict[str, Floats]:
    """Returns the rows that the fit used: run, time, position, position residual; and in the rows in the middle of a
    window (NaN elsewhere) the velocity and the force that the model lacks there."""
    motions, lacking = found.motions, found.force_residual
    starts = np.cumsum([0, *(motion.position.size for motion in motions)])
    rows = int(starts[-1])
    run = np.repeat(np.arange(len(motions)), np.diff(starts))
    left, velocity, force = (np.full(rows, np.nan) for _ in range(3))
    for swing, error in zip(found.swings, found.residuals, strict=True):
        first = starts[swing.motion] + swing.first
        left[first : first + swing.rows] = error * found.count_m
    window = starts[lacking.motion] + lacking.row
    velocity[window], force[window] = lacking.velocity, lacking.force
    columns = {
        "run": run.astype(float),
        "time_s": (np.arange(rows) - starts[run]) / found.rate_hz,
        "position_m": np.concatenate([motion.position for motion in motions]) * found.count_m,
        "position_residual_m": left,
        "velocity_m_s": velocity,
        "force_residual_N": force,
    }
    used = np.isfinite(left)
    return {name: column[used] for name, column in columns.items()}


def draw_device_residual(found: DeviceIdentification, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    lacking = found.force_residual
    with figure_to(path, 9.0, 6.4) as figure:
        panels = figure.subplot_mosaic([["time", "time"], ["velocity", "position"]])
        _draw_over_time(panels["time"], found)
        size = float(np.max(np.abs(lacking.force), initial=0.0))
        unit, name = (1.0, "N") if size > 0.5 else (1e3, "mN") if size > 5e-4 else (1e6, "µN")
        _draw_forces(panels["velocity"], lacking.velocity, lacking.force * unit, lacking.noise * unit)
        _draw_forces(panels["position"], 1e3 * lacking.position, lacking.force * unit, lacking.noise * unit)
        panels["velocity"].set_xlabel("velocity (m/s)")
        panels["position"].set_xlabel("position from where it was found (mm)")
        panels["velocity"].set_ylabel(f"force beside the model ({name})")
        panels["position"].sharey(panels["velocity"])
        legend_below(figure, 3)
        figure.suptitle(_title(found), fontsize=9)


def _draw_over_time(axes: Axes, found: DeviceIdentification) -> None:
    """Draws the position residuals, each run behind the one before."""
    columns = residual_columns(found)
    begins = np.cumsum([0.0, *(motion.position.size / found.rate_hz for motion in found.motions)])
    time = columns["time_s"] + begins[columns["run"].astype(int)]
    some = slice(None, None, max(1, time.size // _MOST_POINTS))
    unit, name = (1e6, "µm") if found.residual_m > 2e-8 else (1e9, "nm")
    axes.plot(time[some], unit * columns["position_residual_m"][some], markersize=1.5, **style.RESIDUAL)
    axes.axhline(0.0, **style.ZERO_LINE)
    axes.set_xlim(0.0, float(begins[-1]))
    top = axes.get_ylim()[1]
    for begin, drive in zip(begins, found.drives, strict=False):
        axes.axvline(float(begin), linestyle=":", **style.ZERO_LINE)
        words = f" K = {drive.stiffness:.3g} N/m, B = {drive.damping:.2g} N·s/m"
        axes.annotate(words, (float(begin), top), ha="left", va="bottom", fontsize=8)
    axes.set_xlabel("time (s), the runs one after the other")
    axes.set_ylabel(f"position beside the model ({name})")


def _draw_forces(axes: Axes, along: Floats, force: Floats, noise: float) -> None:
    """Draws the force that the model lacks in each window, and its mean over the velocity or the position."""
    axes.plot(along, force, markersize=2.5, label="a window each", **style.RESIDUAL)
    axes.axhspan(-2.0 * noise, 2.0 * noise, color="0.9", zorder=0, label="95 % of noise and rounding")
    if force.size >= 4 * BINS:
        _, middles, means = binned(along, force)
        axes.plot(middles, means, label="mean over a twelfth of them", **style.MEAN)
    axes.axhline(0.0, **style.ZERO_LINE)


def _title(found: DeviceIdentification) -> str:
    named = (
        ("mass", found.mass, "kg"),
        ("friction", found.friction, "N·s/m"),
        ("stiffness", found.stiffness, "N/m"),
        ("delay", found.delay, "samples"),
        ("dry friction", found.coulomb, "N"),
    )
    words = [
        f"{name} {rounded(one.value, one.uncertainty)} ± {one.uncertainty:.1g} {unit}" for name, one, unit in named
    ]
    return f"{', '.join(words[:3])},\n{', '.join(words[3:])}"
