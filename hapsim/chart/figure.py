"""What every picture shares: how it looks, where it is written, and its numbers."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PICTURES = (".svg", ".png", ".pdf")
_DOTS_PER_INCH = 150
_LOOK: Any = {
    "font.size": 9,
    "axes.labelsize": 10,
    "axes.titlesize": 10,
    "legend.fontsize": 9,
    "axes.linewidth": 0.8,
    "hatch.linewidth": 0.5,
    "pdf.fonttype": 42,
}
_NAMES_IN_SVG: Any = {"svg.hashsalt": "hapsim"}  # otherwise they are drawn by lot


def require_writable(path: Path | None, endings: tuple[str, ...] = _PICTURES) -> None:
    """UsageError where a picture or its data could not be written there: better before the run than after it."""
    if path is None:
        return
    if path.suffix not in endings:
        raise UsageError(f"{path}: found the ending '{path.suffix}', expected {', '.join(endings)}")
    directory = path.resolve().parent
    if not directory.is_dir():
        raise UsageError(f"{path}: there is no directory {directory}")
    if path.is_dir() or not os.access(path if path.exists() else directory, os.W_OK):
        raise UsageError(f"{path}: no file can be written there")


@contextmanager
def figure_to(path: Path, width: float, height: float) -> Iterator[Figure]:
    """A figure of so many inches to draw on; it is written to `path` at the end."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(_LOOK):
        figure = Figure(figsize=(width, height), dpi=_DOTS_PER_INCH, layout="constrained")
        FigureCanvasAgg(figure)  # by which texts are measured
        yield figure
        save_figure(figure, path)


def save_figure(figure: Figure, path: Path) -> None:
    """Writes a figure; the same data give the same bytes."""
    import matplotlib as mpl

    metadata: dict[str, Any] = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with mpl.rc_context(_NAMES_IN_SVG):
        figure.savefig(path, dpi=_DOTS_PER_INCH, metadata=metadata[path.suffix])


def save_columns(columns: dict[str, Any], path: Path) -> None:
    """Writes a picture's numbers as CSV, a column a quantity."""
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.12g")


def save_rows(columns: Mapping[str, Iterable[Any]], path: Path) -> None:
    """Writes a picture's numbers as CSV, names among them; every digit of a number, and nan where a line is broken."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
