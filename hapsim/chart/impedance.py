"""The measured driving-point impedance over the predicted curve and the desired one (Florens et al., Figure 2)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.chart.figure import figure_to
from hapsim.chart.impedance_panels import (
    Curves,
    Measured,
    draw_frequencies,
    draw_grid,
    draw_phases,
    draw_sizes,
)
from hapsim.prediction.impedance import PredictedImpedance, predict_impedance
from hapsim.theory.arrays import Floats

if TYPE_CHECKING:
    from hapsim.measuring.measure_impedance import MeasuredImpedance
    from hapsim.scene import Scene

_POINTS = 400
_LABELS = ("desired", "predicted", "measured, 99.9 % for all together")
_MOST_IN_A_MATRIX = 6


def columns(predicted: PredictedImpedance, measured: MeasuredImpedance) -> dict[str, list[Any]]:
    """Every number, long: a row for each frequency and each pair of device points, forces before velocities."""
    n, channels = predicted.frequency.size, range(len(predicted.names))
    at = [(k, i, j) for k in range(n) for i in channels for j in channels]
    found: dict[str, list[Any]] = {
        "frequency_Hz": [predicted.frequency[k] for k, _, _ in at],
        "force_at": [predicted.names[i] for _, i, _ in at],
        "velocity_at": [predicted.names[j] for _, _, j in at],
    }

    def add(name: str, values: Any) -> None:
        found[f"{name}_re_Ns_per_m"] = [values[one].real for one in at]
        found[f"{name}_im_Ns_per_m"] = [values[one].imag for one in at]

    add("desired", predicted.desired)
    for name in ("device", "rendered", "closed_loop"):
        circles = getattr(measured, name)
        add(f"{name}_predicted", getattr(predicted, name))
        add(f"{name}_measured", circles.value)
        found[f"{name}_uncertainty_Ns_per_m"] = [circles.uncertainty[one] for one in at]
    return found


def draw_impedance(
    scene: Scene, predicted: PredictedImpedance, measured: MeasuredImpedance, place: int | None, path: Path
) -> None:
    """Draws it: of the device point at ``place`` size and phase, rendered and in the closed loop; where that is None
    and there are several, the sizes of the whole matrix, rendered. The ending of `path` chooses SVG, PNG or PDF."""
    at = np.geomspace(predicted.frequency[0], predicted.frequency[-1], _POINTS)
    dense = predict_impedance(scene, at)
    count = len(predicted.names)
    if place is None and 1 < count <= _MOST_IN_A_MATRIX:
        _draw_matrix(dense, predicted, measured, path)
    else:
        _draw_one(dense, predicted, measured, place or 0, path)


def _draw_one(
    dense: PredictedImpedance, predicted: PredictedImpedance, measured: MeasuredImpedance, i: int, path: Path
) -> None:
    with figure_to(path, 9.5, 5.8) as figure:
        panels = figure.subplots(2, 2, sharex=True, height_ratios=[1.15, 1.0])
        figure.suptitle(f"Impedance at {predicted.names[i]}, channel {measured.channels[i]}")
        for side, (name, title) in enumerate(
            (("rendered", "rendered by the scene"), ("closed_loop", "closed loop, the device with it"))
        ):
            curves = _curves(name, dense, predicted, measured, (i, i))
            upper, lower = panels[0, side], panels[1, side]
            upper.set_title(title)
            draw_sizes(upper, curves, _LABELS if side == 0 else ("", "", ""))
            draw_phases(lower, curves)
            draw_frequencies(lower, 0.9 * float(dense.frequency[0]), 1.1 * float(dense.frequency[-1]))
            for axes in (upper, lower):
                draw_grid(axes)
        panels[0, 0].set_ylabel("|force / velocity|  (N·s/m)")
        panels[1, 0].set_ylabel("phase  (degrees)")
        _legend(figure)


def _draw_matrix(
    dense: PredictedImpedance, predicted: PredictedImpedance, measured: MeasuredImpedance, path: Path
) -> None:
    names = predicted.names
    with figure_to(path, 1.5 + 2.9 * len(names), 1.4 + 2.3 * len(names)) as figure:
        panels = figure.subplots(len(names), len(names), sharex=True, squeeze=False)
        figure.suptitle("Rendered impedance  (N·s/m)")
        for i, j in np.ndindex(len(names), len(names)):
            axes: Any = panels[i, j]
            curves = _curves("rendered", dense, predicted, measured, (i, j))
            axes.set_title(f"force at {names[i]}, velocity at {names[j]}")
            draw_sizes(axes, curves, _LABELS if (i, j) == (0, 0) else ("", "", ""))
            draw_grid(axes)
            if i == len(names) - 1:
                draw_frequencies(axes, 0.9 * float(dense.frequency[0]), 1.1 * float(dense.frequency[-1]))
        _legend(figure)


def _legend(figure: Any) -> None:
    style: dict[str, Any] = {"ncols": 2, "frameon": False, "handlelength": 2.6, "columnspacing": 1.5}
    handles: dict[str, Any] = {}
    for axes in figure.axes:
        handles |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", **style)


def _curves(
    name: str,
    dense: PredictedImpedance,
    predicted: PredictedImpedance,
    measured: MeasuredImpedance,
    at: tuple[int, int],
) -> Curves:
    here = (slice(None), *at)
    desired = dense.desired[here] + (dense.ideal_device[here] if name == "closed_loop" else 0.0)
    circles = getattr(measured, name)
    uncertainty: Floats = circles.uncertainty[here]
    found = Measured(predicted.frequency, circles.value[here], uncertainty, getattr(predicted, name)[here])
    return Curves(dense.frequency, desired, getattr(dense, name)[here], found)
