"""`hapsim export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapsim.cli.live import at_work
from hapsim.cli.options import Json, RecordOptions, flag, option
from hapsim.cli.output import document, say, stderr, warn
from hapsim.number_format import number, plural

if TYPE_CHECKING:
    from hapsim.replaying.columns import Columns
    from hapsim.replaying.export import Exported


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
    from hapsim.replaying.export import export as write
    from hapsim.replaying.export import require_exportable

    require_exportable(out, column)
    RecordOptions(overwrite=overwrite).require_free(out)
    with at_work(stderr(), f"exporting {record}") as show:
        columns, written = write(record, out, column, lambda share: show(f"exporting {record}: {100.0 * share:.0f} %"))
    missing = _missing(columns)
    if json:
        print(document(_document(columns, written) | {"record": str(record), "file": str(out), "missing": missing}))
        return
    for sentence in missing:
        warn(f"{record}: {sentence}", "incomplete")
    scale = f"; 1.0 is {number(written.full_scale)} {written.unit}".rstrip() if written.full_scale else ""
    say(f"{out}: {plural(written.rows, 'row')} of {plural(columns.channels, 'channel')}{scale}")


def _missing(columns: Columns) -> list[str]:
    """Returns what the record lacks, as sentences."""
    sentences = []
    if not columns.reader.is_finished:
        sentences.append(f"the record is cut off or damaged: it stops after {plural(columns.count, 'row')}")
    if columns.dropped:
        sentences.append(f"{plural(columns.dropped, 'row')} are missing: the reader of the loop was too slow")
    if not columns.run:
        sentences.append("an older hapsim recorded it: without its scene, changes and prediction")
    return sentences


def _document(columns: Columns, written: Exported) -> dict[str, Any]:
    return {
        "rows": written.rows,
        "channels": columns.channels,
        "columns": {column.name: columns.units_text(column) for column in columns.all},
        "changes": len(columns.changes),
        "markers": len(columns.markers),
        "full_scale": written.full_scale,
        "full_scale_unit": written.unit or None,
    }
