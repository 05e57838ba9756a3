"""The two panels in which an impedance is drawn over frequency: its size and its phase, desired and rendered, and what
was measured of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes, Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Measured(NamedTuple):
    """What was measured at frequencies (n,) in Hz, N·s/m, with the radii of its circles; drawn on the predicted curve's
    turn, ``predicted`` (n,) at the same frequencies."""

    frequency: Floats
    value: Complexes
    uncertainty: Floats
    predicted: Complexes


class Curves(NamedTuple):
    """One impedance at frequencies (n,) in Hz, N·s/m."""

    frequency: Floats
    desired: Complexes
    rendered: Complexes
    measured: Measured | None = None


def phase(impedance: Complexes) -> Floats:
    """Degrees, followed from the lowest frequency on: what is late goes on turning."""
    return np.asarray(np.degrees(np.unwrap(np.angle(impedance))))


def draw_sizes(axes: Axes, curves: Curves, labels: tuple[str, str, str] = ("", "", "")) -> None:
    """Its size, on a logarithmic scale where there is any."""
    _draw_both(axes, curves.frequency, np.abs(curves.desired), np.abs(curves.rendered), labels)
    found = curves.measured
    if found is not None:
        _draw_measured(axes, found.frequency, np.abs(found.value), found.uncertainty, labels[2])
    if curves.desired.any() or curves.rendered.any():  # of a hand that feels nothing there is nothing to draw
        axes.set_yscale("log")
    if found is not None:  # a circle that reaches down to 0 would squeeze all else
        sizes = np.abs(np.concatenate([curves.desired, curves.rendered]))
        axes.set_ylim(0.5 * float(np.min(sizes[sizes > 0.0])), 2.0 * float(np.max(sizes)))


def draw_phases(axes: Axes, curves: Curves) -> None:
    """Its phase, with the band in which it is passive."""
    desired, rendered = phase(curves.desired), phase(curves.rendered)
    _draw_both(axes, curves.frequency, desired, rendered, ("", "", ""))
    found = curves.measured
    if found is not None:
        along = np.interp(found.frequency, curves.frequency, rendered)
        turn = 360.0 * np.round((along - np.degrees(np.angle(found.predicted))) / 360.0)
        at = turn + np.degrees(np.angle(found.predicted)) + np.degrees(np.angle(found.value / found.predicted))
        radius = np.degrees(np.arcsin(np.minimum(1.0, found.uncertainty / np.abs(found.value))))
        _draw_measured(axes, found.frequency, at, radius, "")
    mark_passive_band(axes, desired, rendered)


def draw_frequencies(axes: Axes, low: float, high: float) -> None:
    """The axis that the panels share."""
    axes.set_xlabel("frequency  (Hz)")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    axes.set_xlim(low, high)


def draw_grid(axes: Axes) -> None:
    axes.grid(which="major", color="0.88", linewidth=0.6)


def mark_passive_band(axes: Axes, *phases: Floats) -> None:
    """-90 to 90 degrees: outside of it the wall gives the hand energy."""
    lowest = min(-90.0, *(float(np.min(one)) for one in phases))
    highest = max(0.0, *(float(np.max(one)) for one in phases))
    low = 45.0 * math.floor(lowest / 45.0 - 0.2)
    high = 45.0 * math.ceil(highest / 45.0 + 0.2)
    every = 45.0 if high - low <= 270.0 else 90.0 if high - low <= 900.0 else 360.0
    axes.set_yticks(every * np.arange(math.ceil(low / every), math.floor(high / every) + 1))
    outside: dict[str, Any] = {"facecolor": "0.86", "linewidth": 0, "zorder": 0.5}
    label = "outside of −90° to 90°: the scene gives energy"
    # A phase that goes on turning comes back into the band, a turn further down.
    turn = math.floor((low + 90.0) / 360.0)
    for centre in 360.0 * np.arange(turn, 2):
        axes.axhspan(max(low, centre - 270.0), min(high, centre - 90.0), label=label, **outside)
        label = ""
    axes.set_ylim(low, high)


def _draw_both(axes: Axes, frequency: Floats, desired: Floats, rendered: Floats, labels: tuple[str, str, str]) -> None:
    axes.plot(frequency, desired, color="0.5", linewidth=1.6, dashes=(5, 2), label=labels[0])
    axes.plot(frequency, rendered, color="black", linewidth=1.4, label=labels[1])


def _draw_measured(axes: Axes, frequency: Floats, value: Floats, radius: Floats, label: str) -> None:
    style: dict[str, Any] = {"markersize": 4.0, "elinewidth": 0.9, "markerfacecolor": "white", "markeredgewidth": 0.9}
    axes.errorbar(frequency, value, radius, fmt="o", color="#b3261e", label=label, zorder=3, **style)
