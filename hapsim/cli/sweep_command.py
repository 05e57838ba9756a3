"""`hapsim sweep`."""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import Context

from hapsim.cli.command_options import (
    At,
    Json,
    PictureOptions,
    SceneFile,
    argument,
    flag,
    hand_channel,
    load,
    option,
    place_at,
    seconds,
)
from hapsim.cli.live import live_words
from hapsim.cli.option_modes import require_mode
from hapsim.cli.output import document, output_units, print_line, stderr, stdout, table
from hapsim.number_format import number, percent, plural
from hapsim.stopping import note_work

if TYPE_CHECKING:
    import xarray

    from hapsim.scene import Scene
    from hapsim.sweeping.sweep_points import Points

_ERRORS_SHOWN = 3  # failures
_DEVIATION = 2  # digits


@dataclass
class PointOptions:
    """The points of a sweep."""

    parameters: list[str] | None = argument(
        "[PATH=VALUES …]",
        "Scene key and its values: a list (device.delay=0,0.5,1), or FROM:TO:COUNT (rate=lin:500:2000:4)",
    )
    samples: int | None = option("N", "Number of samples to draw from ranges such as lin:0:2 or log:200:5000.")
    method: str = option("KIND", "Sampling method: lhs (Latin hypercube), random or sobol.", default="lhs")
    points: Path | None = option("FILE.csv", "Table of points, with the names of the parameters in its first row.")
    seed: int = option("N", "Seed of the samples.", default=0)

    def read(self) -> Points:
        """Returns the points. Raises UsageError."""
        from hapsim.sweeping.sweep_points import read_points, table

        if self.points is not None:
            return table(self.points)
        return read_points(self.parameters or [], self.samples, self.method, self.seed)


@dataclass
class QuantityOptions:
    """Quantities computed at each point."""

    check: bool = flag("--check", "Predict only.")
    measure: bool = flag("--measure", "Measure only, on the mock in virtual time.")
    impedance: bool = flag("--impedance", "Predict and measure impedances over frequency instead of k and b.")

    @property
    def names(self) -> tuple[str, ...]:
        """Kinds of the quantities."""
        if self.impedance:
            return ("impedance",)
        return *(() if self.measure else ("predicted",)), *(() if self.check else ("measured",))


def sweep(
    scene: SceneFile,
    points: PointOptions,
    *,
    out: Path = option("FILE.nc", "File for the results: .nc (netCDF) or .zarr.", default=...),
    quantities: QuantityOptions,
    channel: int | None = option(None, "Channel of the hand [default: the first]"),
    at: At = None,
    duration: float | None = seconds("Duration of each measurement in seconds [default: about 2; 10 each for x, y]"),
    jobs: int | None = option("N", "Number of processes [default: one per processor if the sweep is long]", min=1),
    scheduler: str | None = option(
        "ADDRESS", "Use the workers of a dask.distributed scheduler, such as tcp://host:8786."
    ),
    draw: str | None = option(
        "VARIABLE", "Variable of the dataset that --picture shows [default: the error of k, or k]"
    ),
    over: str | None = option("X,Y", "Parameters on the axes of the picture [default: the first two]"),
    pictures: PictureOptions,
    json: Json = False,
    context: Context,
) -> None:
    """Predict and measure a scene at many points: every combination of values, or samples of ranges.

    The results are one dataset for xarray. Finished points are kept in FILE.nc.parts. After an interruption, run the
    same command again to resume. After the end, run it with another --draw to draw another picture. A failed point is
    NaN, and the variable `error` has the reason.
    """
    from hapsim.sweeping.sweep import sweep as run_sweep

    require_mode(context)
    kinds, chosen = quantities.names, points.read()
    pictures.require_writable()
    loaded = load(scene)
    drawn = _names_to_draw(loaded, kinds, chosen, draw, over) if pictures.wanted else None
    units = None if channel is None else loaded.units_of(hand_channel(loaded, channel))
    place = place_at(loaded, at, units)
    options: dict[str, Any] = {"channel": channel, "duration": duration, "jobs": jobs, "scheduler": scheduler}
    try:
        with live_words(stderr()) as show:
            options |= {"at": place, "quantities": kinds, "on_progress": _Progress(show, out)}
            dataset = run_sweep(loaded, chosen, out=out, **options)
    except KeyboardInterrupt:
        if Path(f"{out}.parts").exists():
            note_work(f"before it was finished; run the same command again to go on with what {out}.parts keeps")
        raise
    if pictures.wanted and drawn:
        from hapsim.chart.sweep_chart import draw_sweep, sweep_chart

        chart, shown = (sweep_chart(one, *drawn) for one in (dataset, _shown(dataset)))
        pictures.write(chart.columns, lambda path: draw_sweep(shown, path))
    if json:
        print(document({"scene": scene, "out": out, "points": len(chosen), **summary_of(dataset)}))
    else:
        _print(_shown(dataset), scene, out)
        pictures.print_written()


class _Progress:
    """Shows how many points are finished, and how long the others will take."""

    def __init__(self, show: Any, out: Path) -> None:
        self._show, self._out, self._calls, self._first, self._begun = show, out, 0, 0, 0.0

    def __call__(self, done: int, every: int) -> None:
        self._calls += 1
        if self._calls == 1 and done:
            going_on = "; going on" if done < every else ""
            print_line(f"{self._out}: {done} of {every} points are there from before{going_on}", sys.stderr)
        if self._calls <= 2:  # the first points to be finished wait for the compiler
            self._first, self._begun = done, time.monotonic()
        left = ""
        if self._calls > 2:
            left_s = (every - done) * (time.monotonic() - self._begun) / (done - self._first)
            left = f" · {left_s:.0f} s left" if left_s < 100.0 else f" · {left_s / 60.0:.0f} min left"
        self._show(f"swept {done} of {every} points{left}" if done < every else f"finished {every} points")


def _names_to_draw(
    scene: Scene, kinds: tuple[str, ...], points: Points, variable: str | None, over: str | None
) -> tuple[list[str], list[str]]:
    from hapsim.chart.sweep_chart import names_to_draw
    from hapsim.scene.written_units import QUANTITY
    from hapsim.sweeping.quantities import kinds_of

    variables = (name for kind in kinds for name in kinds_of(scene)[kind])
    words = {path: [one for one in column if isinstance(one, str)] for path, column in points.columns.items()}
    numbers = [path for path, each in words.items() if all(map(QUANTITY.match, each))]
    return names_to_draw(variables, numbers, variable, over.split(",") if over else [])


def _shown(dataset: xarray.Dataset) -> xarray.Dataset:
    """Returns the dataset in the units of the scene's file."""
    units = {one.si: one for one in output_units().written}
    changed = {}
    for name, values in dataset.variables.items():
        if (unit := units.get(values.attrs.get("units", ""))) is not None:
            changed[name] = (values.dims, values.values * unit.per_si, values.attrs | {"units": unit.name})
    return dataset.assign(changed)


def summary_of(dataset: xarray.Dataset) -> dict[str, Any]:
    """Returns what a sweep found, as JSON has it: of each variable the least, the median and the most."""
    import numpy as np

    found: dict[str, Any] = {}
    for name, values in dataset.data_vars.items():
        if values.dtype.kind == "f" and np.isfinite(values).any():
            known = values.values[np.isfinite(values.values)]
            found[str(name)] = {"least": known.min(), "median": float(np.median(known)), "most": known.max()}
            found[str(name)]["unit"] = values.attrs.get("units", "")
    deviations = {}
    for what in ("k", "b", "k_1", "b_1", "k_2", "b_2"):
        if {f"measured_{what}", f"predicted_{what}"} <= {*dataset.data_vars}:
            off = abs(dataset[f"measured_{what}"] - dataset[f"predicted_{what}"]).values
            scale, unsure = abs(dataset[f"predicted_{what}"]).values, dataset[f"measured_{what}_uncertainty"].values
            is_known = scale > unsure
            share = off[is_known] / scale[is_known]
            if share.size:
                deviations[what] = {"median": float(np.median(share)), "most": float(share.max())}
    errors = [str(one) for one in dataset["error"].values.ravel() if one]
    return {
        "dimensions": dict(dataset.sizes),
        "failed": len(errors),
        "errors": [*dict.fromkeys(errors)][:_ERRORS_SHOWN],
        "variables": found,
        "measured_off_predicted": deviations,
    }


def _print(dataset: xarray.Dataset, scene: str, out: Path) -> None:
    from hapsim.chart.sweep_chart import SHARES, shares_of

    summary = summary_of(dataset)
    rows = [
        (f"{name}  {one['unit']}".rstrip(), *(number(one[what]) for what in ("least", "median", "most")))
        for name, one in summary["variables"].items()
        if name not in SHARES
    ]
    if rows:
        stdout().print(table(f"{scene} at {dataset['error'].size} points", ("<", "least", "median", "most"), rows))
    for sentence in (shares_of(dataset[name]) for name in SHARES if name in summary["variables"]):
        print_line(sentence)
    for what, one in summary["measured_off_predicted"].items():
        median, most = (percent(one[which], _DEVIATION) for which in ("median", "most"))
        print_line(f"Measured {what} is off the predicted one by {most} at most, {median} in the median")
    if summary["failed"]:
        print_line(f"{plural(summary['failed'], 'point')} failed. The variable error has each reason; the first:")
        reasons = Counter(str(one) for one in dataset["error"].values.ravel() if one)
        for error in summary["errors"]:
            print_line(f"  {error}{f' ({reasons[error]} points)' if reasons[error] > 1 else ''}")
    print_line(f"Results: {out}")
