"""How far off k and b are where the device is not the declared one, with each correction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hapsim.chart import style
from hapsim.chart.felt import DRAWN
from hapsim.chart.figure import figure_to, legend_below
from hapsim.errors import UsageError
from hapsim.prediction import predict
from hapsim.prediction.felt import SHARES, Tolerance, tolerance_of
from hapsim.scene import Scene
from hapsim.theory.arrays import Floats

OVER = ("device.mass", "device.friction", "device.delay")
_LABELS = {
    "device.mass": "true mass / declared mass",
    "device.friction": "true friction  (N·s/m)",
    "device.delay": "true delay  (samples)",
}
_POINTS = 121
_MOST = 30.0  # per cent that are drawn


@dataclass(frozen=True)
class ToleranceChart:
    """Errors of k and b (n,), relative, over true values (n,) of one quantity of `OVER`, by correction; NaN where it is
    unstable."""

    over: str
    true: Floats
    """Of the mass as a share of the declared one."""
    k_error: dict[str, Floats]
    b_error: dict[str, Floats]
    within: dict[str, tuple[Tolerance | None, ...]]
    """By correction, for each of `SHARES`; None where what is desired is not felt so."""

    def columns(self) -> dict[str, Any]:
        """Returns what is drawn, by the names that a data file uses."""
        of_k = {f"{name}_k_error": error for name, error in self.k_error.items()}
        return {self.over: self.true} | of_k | {f"{name}_b_error": error for name, error in self.b_error.items()}

    def ends(self, correction: str) -> list[tuple[float, float] | None]:
        """Returns the least and the most of that quantity within each of `SHARES`."""
        field = self.over.removeprefix("device.")
        return [one and getattr(one, field) for one in self.within[correction]]


def tolerance_chart(scene: Scene, name: str, over: str) -> ToleranceChart:
    """Returns it for the hand at a device point whose links all end on grounds. UsageError for another, or where
    `over` is none of `OVER`."""
    if over not in OVER:
        raise UsageError(f"--over: found {over}, expected one of {', '.join(OVER)}")
    true: Floats = np.zeros(0)
    errors: tuple[dict[str, Floats], dict[str, Floats]] = ({}, {})
    within = {}
    for correction in DRAWN:
        device = scene.device.model_copy(update={"correction": correction})
        prediction = predict(scene.model_copy(update={"device": device}), with_margins=False)
        felt = next(one for one in prediction.felt if one.name == name)
        declared, wanted = felt.configuration, prediction.asked_for(felt)
        true = _true_values(over, getattr(declared, over.removeprefix("device.")))
        for of_one in errors:
            of_one[correction] = np.full(true.size, np.nan)
        unit = declared.mass if over == "device.mass" else 1.0
        for i, value in enumerate((unit * true).tolist()):
            there = replace(felt, configuration=replace(declared, **{over.removeprefix("device."): value}))
            if there.stable:
                for of_one, found, asked in zip(errors, (there.k, there.b), wanted, strict=True):
                    of_one[correction][i] = found / asked - 1.0
        within[correction] = tuple(tolerance_of(felt, *wanted, share) for share in SHARES)
    return ToleranceChart(over, true, *errors, within)


def _true_values(over: str, declared: float) -> Floats:
    if over == "device.mass":
        return np.geomspace(0.4, 4.0, _POINTS)
    if over == "device.delay":
        return np.linspace(0.0, declared + 2.0, _POINTS)
    return np.linspace(0.0, max(4.0 * declared, 1.0), _POINTS)


def draw_tolerance(chart: ToleranceChart, title: str, path: Path, shares: Sequence[float] = SHARES) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    with figure_to(path, 7.4, 4.0) as figure:
        figure.suptitle(f"How well the device has to be known   {title}", fontsize=9)
        panels = figure.subplots(1, 2, sharey=True)
        for axes, errors, label in zip(panels, (chart.k_error, chart.b_error), ("k", "b"), strict=True):
            for share in shares:
                axes.axhspan(-100.0 * share, 100.0 * share, **style.WITHIN)
            for name, error in errors.items():
                axes.plot(chart.true, 100.0 * error, label=name, **style.CORRECTIONS[name])
            axes.set_title(f"{label} felt beside {label} desired")
            axes.set_xlabel(_LABELS[chart.over])
            axes.set_xlim(chart.true[0], chart.true[-1])
            axes.set_ylim(-_MOST, _MOST)
            axes.yaxis.set_major_formatter("{x:+.0f} %")
            axes.grid()
            if chart.over == "device.mass":
                axes.set_xscale("log", base=2)
                axes.set_xticks([0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0], ["0.5", "0.7", "1", "1.4", "2", "2.8", "4"])
        legend_below(figure, 3)
