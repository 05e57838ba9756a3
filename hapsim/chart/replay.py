"""A replay beside its record: the hand's position, the force that was sent, and the one that comes out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from hapsim.chart.figure import figure_to, legend_below
from hapsim.chart.trace import draw_zero_if_near
from hapsim.replaying.replay import Comparison


def columns_of(found: Comparison) -> dict[str, NDArray[Any]]:
    """Returns what is drawn, row by row, by the names that a data file uses."""
    columns: dict[str, NDArray[Any]] = {"time_s": found.time_s}
    for c in range(found.position.shape[1]):
        columns[f"position_m[{c}]"] = found.position[:, c]
        columns[f"recorded_force_N[{c}]"] = found.recorded[:, c]
        columns[f"replayed_force_N[{c}]"] = found.replayed[:, c]
    return columns


def draw_replay(found: Comparison, title: str, path: Path) -> None:
    """Draws it to a file (.svg, .png or .pdf)."""
    with figure_to(path, 8.0, 5.2) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True)
        for c in range(found.position.shape[1]):
            of = f" of channel {c}" if found.position.shape[1] > 1 else ""
            upper.plot(found.time_s, 1e3 * found.position[:, c], linewidth=1.0, color=f"C{c}")
            lower.plot(
                found.time_s, found.recorded[:, c], linewidth=2.2, alpha=0.4, color=f"C{c}", label=f"recorded{of}"
            )
            lower.plot(found.time_s, found.replayed[:, c], linewidth=0.9, color=f"C{c}", label=f"replayed{of}")
        upper.set_ylabel("position (mm)")
        lower.set_ylabel("force (N)")
        lower.set_xlabel("time since arming (s)")
        for axes in (upper, lower):
            axes.margins(x=0.01)
            draw_zero_if_near(axes)
        upper.set_title(title, fontsize=9)
        legend_below(figure, 4)
