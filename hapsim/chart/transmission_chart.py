"""Position per force of a free device over frequency: as measured, and as fitted with one mass and with two."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.chart import style
from hapsim.chart.figure import drawn_in, figure_to, legend_below

if TYPE_CHECKING:
    from hapsim.measuring.identify_transmission import TransmissionIdentification

_POINTS = 600


def response_columns(found: TransmissionIdentification) -> dict[str, Any]:
    """Returns what is drawn at the measured frequencies, by the names that a data file uses."""
    frequency, mean = found.measured.frequency, found.measured.mean
    columns = {"frequency_Hz": frequency, "measured_re_m_per_N": mean.real, "measured_im_m_per_N": mean.imag}
    columns["uncertainty_m_per_N"] = found.measured.deviation
    for name, fitted in found.fitted(frequency).items():
        columns |= {f"{name}_re_m_per_N": fitted.real, f"{name}_im_m_per_N": fitted.imag}
    return columns


def draw_response(found: TransmissionIdentification, path: Path) -> None:
    """Draws size and phase to a file: .svg, .png or .pdf."""
    measured, units = found.measured, drawn_in()
    frequency = np.geomspace(measured.frequency[0], measured.frequency[-1], _POINTS)
    fitted, mean = found.fitted(frequency), measured.mean
    looks = {"one_mass": ("fitted, one mass", style.DESIRED), "two_masses": ("fitted, two masses", style.RENDERED)}
    unit = f"{units.name('mm')}/{units.name('N')}"
    scale = units.scaled(1.0, "mm") / units.scaled(1.0, "N")
    with figure_to(path, 8.0, 5.8) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.4, 1.0])
        off = scale * measured.deviation
        upper.errorbar(measured.frequency, scale * np.abs(mean), off, label="measured", **style.MEASURED)
        lower.errorbar(measured.frequency, np.degrees(np.angle(mean)), **style.MEASURED)
        for name, curve in fitted.items():
            label, look = looks[name]
            upper.plot(frequency, scale * np.abs(curve), label=label, **look)
            lower.plot(frequency, np.degrees(np.angle(curve)), **look)
        upper.set(xscale="log", yscale="log", ylabel=f"|position / force|  ({unit})")
        sizes = scale * np.abs(mean)
        upper.set_ylim(0.5 * float(np.min(sizes)), 2.0 * float(np.max(sizes)))
        lower.set(
            xlabel="frequency  (Hz)", ylabel="phase  (degrees)", ylim=(-185.0, 185.0), yticks=range(-180, 181, 90)
        )
        for axes in (upper, lower):
            axes.xaxis.set_major_formatter("{x:g}")
            axes.grid()
        upper.set_title(f"Position per force of the free device, channel {found.channel}")
        legend_below(figure, 3)
