"""Transparency: the desired impedance beside the one that the device renders (Florens et al., Figure 2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hapsim.chart.figure import figure_to
from hapsim.chart.hand import Hand
from hapsim.chart.impedance_panels import Curves, draw_frequencies, draw_grid, draw_phases, draw_sizes, phase
from hapsim.theory.arrays import Complexes, Floats

_BELOW_EIGENFREQUENCY, _BELOW_NYQUIST = 20.0, 1000.0  # where the picture begins, the second where nothing swings
_POINTS = 1200


@dataclass(frozen=True)
class Transparency:
    """Force over velocity, desired and rendered; the hand's own mass is in neither."""

    hand: Hand
    frequency: Floats
    """Hz, (n,), up to just below the Nyquist frequency."""
    desired: Complexes
    """N·s/m: the real spring K and damper B, with the device's own."""
    rendered: Complexes
    """N·s/m."""
    eigenfrequency: float
    """Hz, of the hand on what it feels; NaN where no spring and damper is equivalent."""

    @property
    def desired_phase(self) -> Floats:
        """Degrees."""
        return phase(self.desired)

    @property
    def rendered_phase(self) -> Floats:
        """Degrees, followed from the lowest frequency on: what is late goes on turning."""
        return phase(self.rendered)

    def columns(self) -> dict[str, Any]:
        """What is drawn, by the names that a data file uses."""
        return {
            "frequency_Hz": self.frequency,
            "desired_Ns_per_m": np.abs(self.desired),
            "rendered_Ns_per_m": np.abs(self.rendered),
            "desired_phase_deg": self.desired_phase,
            "rendered_phase_deg": self.rendered_phase,
        }

    def gives_energy(self) -> list[tuple[float, float]]:
        """Bands (from, to) in Hz in which the wall gives the hand energy instead of taking it: Re Z < 0."""
        power, f = self.rendered.real, self.frequency
        gives = np.concatenate([[False], power < 0.0, [False]])
        edges = np.flatnonzero(np.diff(gives.astype(int)))
        # Between two frequencies the power is as good as straight.
        nyquist = 0.5 * self.hand.configuration.rate
        at = np.concatenate([[f[0]], f[:-1] - power[:-1] * np.diff(f) / _not_zero(np.diff(power)), [nyquist]])
        return [(float(at[a]), float(at[b])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def transparency(hand: Hand) -> Transparency:
    """The impedances of one hand, for the K and B that are simulated for it."""
    configuration = hand.configuration
    nyquist = 0.5 * configuration.rate
    eigenfrequency = hand.eigenfrequency()
    lowest = eigenfrequency / _BELOW_EIGENFREQUENCY if eigenfrequency > 0.0 else nyquist / _BELOW_NYQUIST
    frequency = np.geomspace(lowest, nyquist, _POINTS, endpoint=False)
    jw = 2j * np.pi * frequency
    desired = np.asarray(
        (hand.stiffness + configuration.stiffness) / jw + hand.damping + configuration.friction, complex
    )
    rendered = configuration.impedance(hand.stiffness, hand.damping, frequency)
    return Transparency(hand, frequency, desired, rendered, eigenfrequency)


def draw_transparency(data: Transparency, title: str, path: Path) -> None:
    """Draws it. The ending of `path` chooses SVG, PNG or PDF."""
    curves = Curves(data.frequency, data.desired, data.rendered)
    with figure_to(path, 6.5, 5.6) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.15, 1.0])
        upper.set_title(title)
        draw_sizes(upper, curves, ("desired", "rendered", ""))
        upper.set_ylabel("|force / velocity|  (N·s/m)")
        draw_phases(lower, curves)
        lower.set_ylabel("phase  (degrees)")
        draw_frequencies(lower, float(data.frequency[0]), 0.5 * data.hand.configuration.rate)
        for axes in (upper, lower):
            draw_grid(axes)
        if math.isfinite(data.eigenfrequency):
            label = f"eigenfrequency of the hand, {data.eigenfrequency:.4g} Hz"
            for axes in (upper, lower):
                style = {"color": "black", "linewidth": 0.9, "dashes": (2, 2), "zorder": 1.5}
                axes.axvline(data.eigenfrequency, label=label if axes is upper else "", **style)
        figure.legend(loc="outside lower center", ncols=2, frameon=False, handlelength=2.6, columnspacing=1.5)


def _not_zero(x: Floats) -> Floats:
    return np.where(x == 0.0, 1.0, x)
