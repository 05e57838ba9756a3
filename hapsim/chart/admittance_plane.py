"""The M,B plane of a device in admittance: curves of equal m and of equal b, the dual of the K,B plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hapsim.chart import style
from hapsim.chart.figure import drawn_in, figure_to, legend_below
from hapsim.chart.plane_curves import round_values
from hapsim.errors import UsageError
from hapsim.number_format import short
from hapsim.prediction import predict
from hapsim.prediction.felt_mass import FeltMass, MassPlane, mass_plane
from hapsim.scene import Scene

_POINTS = (120, 90)  # over M, and over B
_AROUND = 2.5  # times the operating point, where an axis ends
_LEAST = 1e-3  # of an axis: where it begins
_MOST = 10  # curves of a kind


@dataclass(frozen=True)
class AdmittancePlane:
    """The plane of one hand, in SI units."""

    felt: FeltMass
    plane: MassPlane

    def columns(self) -> dict[str, list[float]]:
        """Returns the points of the plane, by the names that a data file uses."""
        M, B = np.meshgrid(self.plane.masses, self.plane.dampings)
        names = ("M_kg", "B_Ns_per_m", "m_kg", "b_Ns_per_m", "spectral_radius")
        every = (M, B, self.plane.m, self.plane.b, self.plane.spectral_radius)
        return {name: one.ravel().tolist() for name, one in zip(names, every, strict=True)}


def admittance_plane(scene: Scene, channel: int, B_to: float | None = None) -> AdmittancePlane:
    """Returns the plane of the hand on a channel, in the stiffest hand that the device assumes. ``B_to``: end of the
    axis of B, N·s/m. Raises UsageError if no mass and damping is equivalent there."""
    hands = {one.channel: one for one in predict(scene, with_margins=False).felt_masses}
    if channel not in hands:
        raise UsageError(f"--channel {channel}: no hand there; hands are on: {', '.join(map(str, hands))}")
    felt = hands[channel]
    if felt.reason:
        raise UsageError(f"{felt.name}: no mass and damping is equivalent, because {felt.reason}")
    least, _ = felt.stable_damping
    most = B_to or _AROUND * max(felt.damping, least if math.isfinite(least) else 0.0) or felt.mass * scene.rate / 10.0
    masses, dampings = (
        end * np.append(_LEAST, np.linspace(1.0 / count, 1.0, count))
        for end, count in zip((_AROUND * felt.mass, most), _POINTS, strict=True)
    )
    return AdmittancePlane(felt, mass_plane(felt, masses, dampings))


def draw_admittance_plane(data: AdmittancePlane, title: str, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    units, felt = drawn_in(), data.felt
    kg, damping = (units.scaled(1.0, unit) for unit in ("kg", "N·s/m"))
    M, B = kg * data.plane.masses, damping * data.plane.dampings
    is_stable = data.plane.spectral_radius < 1.0
    with figure_to(path, 6.5, 5.9) as figure:
        axes = figure.add_subplot()
        axes.set_title(title)
        axes.set(xlim=(0.0, M[-1]), xlabel=f"simulated mass  $M$  ({units.name('kg')})")
        axes.set(ylim=(0.0, B[-1]), ylabel=f"simulated damping  $B$  ({units.name('N·s/m')})")
        grey = style.UNSTABLE["facecolor"]
        axes.contourf(M, B, data.plane.spectral_radius, [1.0, math.inf], colors=grey, zorder=style.UNSTABLE["zorder"])
        axes.plot([], [], "s", color=grey, markersize=9, label="unstable")
        for kind, values, factor, what in (
            ("iso_k", data.plane.m, kg, f"mass, $m$ ({units.name('kg')})"),
            ("iso_b", data.plane.b, damping, f"damping, $b$ ({units.name('N·s/m')})"),
        ):
            drawn: dict[str, Any] = style.ISO[kind] | style.ISO_OF_ONE_MASS[kind]
            seen = np.where(is_stable, factor * values, math.nan)
            levels = round_values(float(np.nanmax(seen, initial=0.0)), _MOST)
            if levels.size:
                look = {"colors": drawn["color"], "linewidths": drawn["linewidth"]}
                lines = axes.contour(M, B, seen, levels, linestyles=[drawn.get("linestyle", "-")], **look)
                axes.clabel(lines, fmt=short, fontsize=style.NUMBER["fontsize"])
            axes.plot([], [], label=f"equal felt {what}", **drawn)
        point = f"{felt.name}: $M$ = {short(kg * felt.mass)}, $B$ = {short(damping * felt.damping)}\n"
        point += f"feels $m$ = {short(kg * felt.m)}, $b$ = {short(damping * felt.b)}"
        axes.plot(kg * felt.mass, damping * felt.damping, label="operating point", **style.OPERATING_POINT)
        axes.annotate(point, (kg * felt.mass, damping * felt.damping), (26, 18), textcoords="offset points",
                      bbox=style.WORDS_BOX, zorder=7)  # fmt: skip
        legend_below(figure, 2, handlelength=3.2)
