"""What every picture shares: where it is written, and its numbers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PICTURES = (".svg", ".png", ".pdf")


def require_writable(path: Path | None, endings: tuple[str, ...] = _PICTURES) -> None:
    """UsageError where a picture or its data could not be written there: better before the run than after it."""
    if path is None:
        return
    if path.suffix not in endings:
        raise UsageError(f"{path}: found the ending '{path.suffix}', expected {', '.join(endings)}")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"{path}: there is no directory {path.resolve().parent}")


def save_figure(figure: Figure, path: Path) -> None:
    """Writes a figure; the same data give the same bytes."""
    metadata: dict[str, Any] = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    figure.savefig(path, dpi=150, metadata=metadata[path.suffix])


def save_columns(columns: dict[str, Any], path: Path) -> None:
    """Writes a picture's numbers as CSV, a column a quantity."""
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.12g")
