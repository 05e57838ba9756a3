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
from hapsim.number_format import share_in_percent
from hapsim.scene.issue import did_you_mean

if TYPE_CHECKING:
    import xarray

_OFF = "_off"  # after the name of a measured variable: how far it is off the predicted one
_DEVIATIONS = ("measured_k_off", "measured_k_1_off", "measured_k_2_off")
_LONGEST = 40  # characters of a line
_LOGARITHMIC = 30.0  # a parameter whose values span more has a logarithmic axis
_USUAL = (*_DEVIATIONS, "predicted_k", "predicted_b", "measured_k", "measured_b")
_UNCERTAINTIES = 4.0  # a difference of more is none of chance,
_FEW = 0.05  # unless only this share of the points have one
_ROUNDING = 1e-9  # of a value

SHARES = {"stable": "predicted stable", "passive": "passive: no hand makes them unstable"}
"""The variables that are 1 or 0 at a point, and what is said of the points with 1."""


@dataclass(frozen=True)
class SweepChart:
    """The values of the picture along one or two parameters; the title has the values of the others."""

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
) -> tuple[list[str], list[str]]:
    """Returns the variables of which a chart shows one, and the one or two parameters: those asked for, or else how far
    measured k is off, k, b and all others, over the first two. `parameters`: those with numbers. Raises UsageError for
    an unknown name."""
    variables, parameters = list(variables), list(parameters)
    variables += [one for one in _DEVIATIONS if {*_compared(one)} <= {*variables}]
    for what, word, known in (("--draw", variable, variables), *(("--over", one, parameters) for one in over)):
        if word is not None and word not in known:
            raise UsageError(f"{what}: found '{word}', expected {', '.join(known)}{did_you_mean(word, known)}")
    if not parameters:
        raise UsageError("--picture: the sweep has no parameter that is a number")
    if len(over) > 2:
        raise UsageError(f"--over: found {len(over)} parameters, expected one or two")
    usual = [one for one in _USUAL if one in variables]
    return [variable] if variable else [*dict.fromkeys([*usual, *variables])], list(over) or parameters[:2]


def sweep_chart(dataset: xarray.Dataset, variables: Sequence[str], along: Sequence[str]) -> SweepChart:
    """Returns the chart over one or two parameters of the first variable that varies by more than its uncertainty; of
    the first one where none does."""
    charts = (_chart_of(dataset, variable, along) for variable in variables if variable in {*dataset, *_DEVIATIONS})
    first = next(charts)
    return next((one for one in (first, *charts) if _varies(dataset, one.values)), first)


def _varies(dataset: xarray.Dataset, values: xarray.DataArray) -> bool:
    known = values.values[np.isfinite(values.values)]
    if values.name in _DEVIATIONS:
        measured, predicted = _compared(str(values.name))
        off = abs(dataset[measured] - dataset[predicted])
        return float((off > _UNCERTAINTIES * dataset[f"{measured}_uncertainty"]).mean()) > _FEW
    unsure = dataset.get(f"{values.name}_uncertainty")
    least = 0.0 if unsure is None else _UNCERTAINTIES * float(unsure.max())
    return bool(known.size) and float(np.ptp(known)) > max(least, _ROUNDING * float(abs(known).max()))


def _compared(deviation: str) -> tuple[str, str]:
    measured = deviation.removesuffix(_OFF)
    return measured, measured.replace("measured", "predicted")


def shares_of(values: xarray.DataArray) -> str:
    """Returns at which share of the points a variable of `SHARES` is 1."""
    known = values.values[np.isfinite(values.values)]
    count = int(known.sum())
    if not known.size:
        return f"It is not known at which points they are {SHARES[str(values.name)]}"
    return f"{count} of {known.size} points ({share_in_percent(count / known.size)}) are {SHARES[str(values.name)]}"


def _chart_of(dataset: xarray.Dataset, variable: str, along: Sequence[str]) -> SweepChart:
    if variable in _DEVIATIONS:
        measured, predicted = _compared(variable)
        off = abs(dataset[measured] / dataset[predicted] - 1.0)
        what = f"how far {measured.replace('_', ' ', 1)} is off the predicted one"
        dataset = dataset.assign({variable: off.assign_attrs(units="", description=what)})
    values = dataset[variable]
    if "point" in values.dims:
        return SweepChart(values, tuple(along), True, shares_of(values) if variable in SHARES else "")
    if variable in SHARES:
        others = [one for one in values.dims if one not in along]
        share = values.mean(others, keep_attrs=True).transpose(*reversed(along))
        return SweepChart(share, tuple(along), False, shares_of(values))
    fixed = {one: values[one].size // 2 for one in map(str, values.dims) if one not in along}
    there = values.isel(fixed).transpose(*reversed(along))
    return SweepChart(there, tuple(along), False, ", ".join(_with_unit(there[one]) for one in fixed))


def _with_unit(value: xarray.DataArray) -> str:
    number = value.item()
    shown = f"{number:g}" if isinstance(number, float) else str(number)
    return f"{value.name} = {shown} {value.attrs.get('units', '')}".rstrip()


def _label_of(parameter: xarray.DataArray) -> str:
    unit = parameter.attrs.get("units", "")
    return f"{parameter.name} ({unit})" if unit else str(parameter.name)


def draw_sweep(chart: SweepChart, path: Path) -> None:
    """Draws it to a file (.svg, .png or .pdf): a line over one parameter, colours over two."""
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.ticker import PercentFormatter

    values, over = chart.values, chart.over
    label = str(values.attrs.get("description", values.name))
    unit = values.attrs.get("units", "")
    label = textwrap.fill(f"{label} ({unit})" if unit else label, _LONGEST)
    is_share = values.name in SHARES
    if is_share:
        label = f"share of the points that are {values.name}"
    with figure_to(path, 6.4, 4.6) as figure:
        axes = figure.subplots()
        along = [values[one].values for one in over]
        numbers = values.values.astype(float)
        if len(over) == 1:
            axes.plot(along[0], numbers, ".-" if not chart.is_scattered else ".", linewidth=1.0)
            axes.set_ylabel(label)
            if is_share:
                axes.yaxis.set_major_formatter(PercentFormatter(1.0))
            axes.grid(True)
        else:
            known = numbers[np.isfinite(numbers) & (numbers > 0.0)]
            is_positive = known.size and known.size == np.isfinite(numbers).sum()
            # logarithmic where the values are above 0 and span much
            norm: Normalize | None = LogNorm() if is_positive and known.max() / known.min() > _LOGARITHMIC else None
            if is_share:
                norm = Normalize(0.0, 1.0)
            if chart.is_scattered:
                drawn: Any = axes.scatter(along[0], along[1], c=numbers, s=14, norm=norm)
            else:
                drawn = axes.pcolormesh(along[0], along[1], numbers, shading="nearest", norm=norm)
            figure.colorbar(drawn, label=label, format=PercentFormatter(1.0) if is_share else None)
            axes.set_ylabel(_label_of(values[over[1]]))
        axes.set_xlabel(_label_of(values[over[0]]))
        for one, set_scale in zip(along, (axes.set_xscale, axes.set_yscale), strict=False):
            if one.min() > 0.0 and one.max() / one.min() > _LOGARITHMIC:
                set_scale("log")
        axes.set_title(chart.title)
