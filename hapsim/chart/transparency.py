"""Transparency: the desired impedance of a hand beside the rendered one (Florens et al., Figure 2).

Desired is the scene's continuous impedance, rendered what the sampled, held and late loop presents at the device, as
`hapsim measure --impedance` has them. The device's own mass, friction and spring are in neither.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hapsim.chart import style
from hapsim.chart.figure import figure_to, legend_below
from hapsim.chart.hand import Hand
from hapsim.chart.impedance import Curves, draw_phases, draw_sizes, phase
from hapsim.theory.arrays import Complexes, Floats

_BELOW_EIGENFREQUENCY, _BELOW_NYQUIST = 20.0, 1000.0  # where the picture begins; the second if nothing swings
_POINTS = 1200


@dataclass(frozen=True)
class Transparency:
    """Force over velocity, desired and rendered, N·s/m (n,)."""

    hand: Hand
    frequency: Floats
    """Hz, (n,), up to just below the Nyquist frequency."""
    desired: Complexes
    rendered: Complexes
    eigenfrequency: float
    """Hz, of the hand on what it feels; NaN if no spring and damper is equivalent."""

    def columns(self) -> dict[str, Floats]:
        """Returns what is drawn, by the names that a data file uses."""
        return {
            "frequency_Hz": self.frequency,
            "desired_Ns_per_m": np.abs(self.desired),
            "rendered_Ns_per_m": np.abs(self.rendered),
            "desired_phase_deg": phase(self.desired),
            "rendered_phase_deg": phase(self.rendered),
        }

    def gives_energy(self) -> list[tuple[float, float]]:
        """Returns bands (from, to) in Hz in which the scene gives the hand energy instead of taking it: Re Z < 0."""
        power, f = self.rendered.real, self.frequency
        edges = np.flatnonzero(np.diff(power < 0.0, prepend=False, append=False))
        # Between two frequencies the power is nearly straight.
        step = np.diff(power)
        crossings = f[:-1] - power[:-1] * np.diff(f) / np.where(step == 0.0, 1.0, step)
        at = np.concatenate([[f[0]], crossings, [0.5 * self.hand.configuration.rate]])
        return [(low, high) for low, high in at[edges].reshape(-1, 2).tolist()]


def transparency(hand: Hand) -> Transparency:
    """Returns the impedances of one hand, for the K and B that are simulated for it."""
    nyquist = 0.5 * hand.configuration.rate
    eigenfrequency = hand.eigenfrequency()
    lowest = eigenfrequency / _BELOW_EIGENFREQUENCY if eigenfrequency > 0.0 else nyquist / _BELOW_NYQUIST
    frequency = np.geomspace(lowest, nyquist, _POINTS, endpoint=False)
    stiffness, damping = hand.desired
    desired = np.asarray(stiffness / (2j * np.pi * frequency) + damping, complex)
    scene_alone = replace(hand.configuration, friction=0.0, stiffness=0.0)
    rendered = scene_alone.impedance(hand.stiffness, hand.damping, frequency)
    return Transparency(hand, frequency, desired, rendered, eigenfrequency)


def draw_transparency(data: Transparency, title: str, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    curves = Curves(data.frequency, data.desired, data.rendered)
    with figure_to(path, 6.5, 5.6) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.15, 1.0])
        figure.suptitle(title)
        draw_sizes(upper, curves)
        draw_phases(lower, curves)
        upper.set_ylabel("|force / velocity|  (N·s/m)")
        lower.set_ylabel("phase  (degrees)")
        if math.isfinite(data.eigenfrequency):
            label = f"eigenfrequency of the hand, {data.eigenfrequency:.4g} Hz"
            for axes in (upper, lower):
                axes.axvline(data.eigenfrequency, label=label, **style.EIGENFREQUENCY)
        legend_below(figure, 2, handlelength=2.6)
