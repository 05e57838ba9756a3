"""A sweep's variable over one or two of its parameters."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.chart.figure import figure_to
from hapsim.errors import UsageError
from hapsim.scene.issue import did_you_mean

if TYPE_CHECKING:
    import xarray

_DEVIATION = "measured_k_off"
_LONGEST = 40  # characters of a line
_LOGARITHMIC = 30.0  # a parameter whose values span more has a logarithmic axis


@dataclass(frozen=True)
class SweepChart:
    """What is drawn: the values along one or two parameters, where the others are as the title says."""

    values: xarray.DataArray
    over: tuple[str, ...]
    is_scattered: bool  # whether the values are those of samples and not of a grid
    title: str

    def columns(self) -> dict[str, Any]:
        """Returns what is drawn, row by row, by the names that a data file uses."""
        frame = self.values.to_dataframe().reset_index()
        return {name: frame[name].to_numpy() for name in (*self.over, str(self.values.name))}


def names_to_draw(
    variables: Iterable[str], parameters: Iterable[str], variable: str | None, over: Sequence[str]
) -> tuple[str, list[str]]:
    """Returns the variable and the one or two parameters that a chart shows: those asked for, or else how far measured
    k is off, or k, over the first two. `parameters`: those with numbers. Raises UsageError for an unknown name."""
    variables, parameters = list(variables), list(parameters)
    if {"measured_k", "predicted_k"} <= {*variables}:
        variables.append(_DEVIATION)
    for what, word, known in (("--draw", variable, variables), *(("--over", one, parameters) for one in over)):
        if word is not None and word not in known:
            raise UsageError(f"{what}: found '{word}', expected {', '.join(known)}{did_you_mean(word, known)}")
    if not parameters:
        raise UsageError("--picture: the sweep has no parameter that is a number")
    if len(over) > 2:
        raise UsageError(f"--over: found {len(over)} parameters, expected one or two")
    usual = (one for one in (_DEVIATION, "predicted_k", "measured_k") if one in variables)
    return variable or next(usual, variables[0]), list(over) or parameters[:2]


def sweep_chart(dataset: xarray.Dataset, variable: str, along: Sequence[str]) -> SweepChart:
    """Returns the chart of a variable over one or two parameters, as `names_to_draw` gives them."""
    if variable == _DEVIATION:
        off = abs(dataset["measured_k"] / dataset["predicted_k"] - 1.0)
        dataset = dataset.assign(
            {_DEVIATION: off.assign_attrs(units="", description="how far measured k is off the predicted one")}
        )
    values = dataset[variable]
    if "point" in values.dims:
        return SweepChart(values, tuple(along), True, "")
    fixed = {one: values[one].size // 2 for one in map(str, values.dims) if one not in along}
    there = values.isel(fixed).transpose(*reversed(along))
    return SweepChart(there, tuple(along), False, ", ".join(f"{one} = {there[one].item()}" for one in fixed))


def draw_sweep(chart: SweepChart, path: Path) -> None:
    """Draws it to a file (.svg, .png or .pdf): a line over one parameter, colours over two."""
    from matplotlib.colors import LogNorm

    values, over = chart.values, chart.over
    label = str(values.attrs.get("description", values.name))
    unit = values.attrs.get("units", "")
    label = textwrap.fill(f"{label} ({unit})" if unit else label, _LONGEST)
    with figure_to(path, 6.4, 4.6) as figure:
        axes = figure.subplots()
        along = [values[one].values for one in over]
        numbers = values.values.astype(float)
        if len(over) == 1:
            axes.plot(along[0], numbers, ".-" if not chart.is_scattered else ".", linewidth=1.0)
            axes.set_ylabel(label)
            axes.grid(True)
        else:
            known = numbers[np.isfinite(numbers) & (numbers > 0.0)]
            is_positive = known.size and known.size == np.isfinite(numbers).sum()
            # logarithmic where the values are above 0 and span much
            norm = LogNorm() if is_positive and known.max() / known.min() > _LOGARITHMIC else None
            if chart.is_scattered:
                drawn: Any = axes.scatter(along[0], along[1], c=numbers, s=14, norm=norm)
            else:
                drawn = axes.pcolormesh(along[0], along[1], numbers, shading="nearest", norm=norm)
            figure.colorbar(drawn, label=label)
            axes.set_ylabel(over[1])
        axes.set_xlabel(over[0])
        for one, set_scale in zip(along, (axes.set_xscale, axes.set_yscale), strict=False):
            if one.min() > 0.0 and one.max() / one.min() > _LOGARITHMIC:
                set_scale("log")
        axes.set_title(chart.title)
