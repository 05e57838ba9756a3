"""Common parts of all pictures: fonts, sizes, the file of the picture, and the file of its numbers."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapsim.units import LINEAR, Units
from hapsim.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.text import Text

_DOTS_PER_INCH = 150
_LONG = 40  # characters
_FONTS: Any = {
    "font.size": 9,
    "axes.labelsize": 10,
    "axes.titlesize": 10,
    "figure.titlesize": 10,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "axes.linewidth": 0.8,
    "axes.axisbelow": True,
    "grid.color": "0.88",
    "grid.linewidth": 0.6,
    "hatch.linewidth": 0.5,
    "pdf.fonttype": 42,
    "svg.hashsalt": "hapsim",  # names in an SVG are random without it
}
_METADATA: dict[str, Any] = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""Metadata to omit, so that the same data give the same bytes."""


_units = [LINEAR]


@contextmanager
def labelled_in(units: Units) -> Iterator[None]:
    """Has the figures that are drawn in the block in these units; others are in those of a line."""
    _units.append(units)
    try:
        yield
    finally:
        _units.pop()


def drawn_in() -> Units:
    """Returns the units of the figure that is drawn."""
    return _units[-1]


def _fit(text: Text) -> None:
    """Puts a long text with the units of a rotation, longer than those of a line, into smaller letters."""
    words = text.get_text()
    if len(words) > _LONG and any(unit in words for unit in ("rad", "N·m", "kg·m²")):
        text.set_fontsize(0.85 * float(text.get_fontsize()))


def _require_fonts() -> None:
    """Adds matplotlib's own fonts where its list of fonts, which it keeps between runs, lacks them: it would print a
    line for each font that a formula looks for."""
    import matplotlib as mpl
    from matplotlib.font_manager import fontManager

    listed = {entry.fname for entry in fontManager.ttflist}
    for file in Path(mpl.get_data_path(), "fonts", "ttf").glob("*.ttf"):
        if str(file) not in listed:
            fontManager.addfont(file)


@contextmanager
def figure_to(path: Path, width: float, height: float) -> Iterator[Figure]:
    """Yields a figure of this size in inches, and writes it to `path` at the end: .svg, .png or .pdf."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    _require_fonts()
    with mpl.rc_context(_FONTS):
        figure = Figure(figsize=(width, height), dpi=_DOTS_PER_INCH, layout="constrained")
        FigureCanvasAgg(figure)  # measures texts
        yield figure
        if _units[-1].is_rotary:
            for text in figure.findobj(Text):
                _fit(text)
        with whole_file(path) as file:
            figure.savefig(file, dpi=_DOTS_PER_INCH, format=path.suffix[1:], metadata=_METADATA[path.suffix])


def legend_below(figure: Any, columns: int, **options: Any) -> None:
    """Adds one legend for all panels below the figure, in `columns` columns."""
    if "handles" not in options:
        named: dict[str, Any] = {}
        for axes in figure.axes:
            named |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        options |= {"handles": list(named.values()), "labels": list(named)}
    figure.legend(loc="outside lower center", ncols=columns, **({"columnspacing": 1.5} | options))


def once(label: str, used: set[str]) -> str:
    """Returns the label for the first that has it; then one that no legend shows."""
    shown = "_" if label in used else label
    used.add(label)
    return shown


def save_rows(columns: Mapping[str, Iterable[Any]], path: Path) -> None:
    """Writes a picture's numbers as CSV, with every digit; nan stands where a line is broken."""
    with whole_file(path) as file, file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
