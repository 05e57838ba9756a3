"""`hapsim export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hapsim.cli.live import at_work
from hapsim.cli.options import Json, RecordOptions, flag, option
from hapsim.cli.output import document, say, stderr, warn
from hapsim.number_format import number, plural
from hapsim.replaying.export import Columns, require_exportable
from hapsim.replaying.export import export as write


def export(
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="A .trace, or the .part that a crash left.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The file: .h5, .mcap, .csv, .npz or .wav.")],
    *,
    column: Annotated[
        str | None, option("NAME", "Of a .wav: position.0, force.0, another column and channel, or a pick-up.")
    ] = None,
    overwrite: Annotated[bool, flag("--overwrite", "Replace a file that exists.")] = False,
    json: Json = False,
) -> None:
    """Write a record for other programs: HDF5, MCAP, CSV, NumPy or sound."""
    require_exportable(out, column)
    RecordOptions(overwrite=overwrite).require_free(out)
    with at_work(stderr(), f"exporting {record}") as show:
        columns = Columns(record)
        full_scale, unit = write(columns, out, column, lambda share: show(f"exporting {record}: {100.0 * share:.0f} %"))
    missing = _missing(columns)
    if json:
        about = {
            "record": str(record),
            "file": str(out),
            "rows": columns.count,
            "channels": columns.channels,
            "columns": {column.name: columns.units_text(column) for column in columns.all},
            "changes": len(columns.changes),
            "markers": len(columns.markers),
            "full_scale": full_scale or None,
            "full_scale_unit": unit or None,
            "missing": missing,
        }
        print(document(about))
        return
    for sentence in missing:
        warn(f"{record}: {sentence}", "incomplete")
    scale = f"; full scale is {number(full_scale)} {unit}".rstrip() if full_scale else ""
    say(f"{out}: {plural(columns.count, 'row')} of {plural(columns.channels, 'channel')}{scale}")


def _missing(columns: Columns) -> list[str]:
    """Returns what the record lacks, as sentences."""
    dropped = int(columns.report["dropped_rows"])
    slow = f"{plural(dropped, 'row')} missing: the reader of the loop was too slow"
    older = "an older hapsim recorded it: without its scene, changes and prediction"
    is_so = (not columns.reader.is_finished, dropped > 0, columns.scene is None)
    sentences = unfinished(columns.count), slow, older
    return [sentence for sentence, applies in zip(sentences, is_so, strict=True) if applies]


def unfinished(rows: int) -> str:
    """Returns what is said of a record without its end."""
    return f"the run goes on, or the record is cut off or damaged: it has {plural(rows, 'row')}"
