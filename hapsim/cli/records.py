"""`hapsim replay` and `export`: replay of records, and files for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapsim.cli.command_options import Json, PictureOptions, RecordOptions, argument, flag, load, option, print_written
from hapsim.cli.device_commands import Link, serve
from hapsim.cli.live import at_work
from hapsim.cli.output import document, output_units, print_line, print_message, set_output_units, stderr, warn
from hapsim.documents import pick
from hapsim.errors import RecordError, UsageError
from hapsim.number_format import number, plural

if TYPE_CHECKING:
    from hapsim.replaying.export import Columns
    from hapsim.replaying.replay import Comparison, Record


def replay(
    record: Path = argument("RECORD", "Record of `hapsim run --record`, a .trace.", default=...),
    scene: str | None = argument("[SCENE]", "Another scene for the same hand [default: the recorded scene]"),
    *,
    sound_file: Path | None = option("FILE.wav", "Write the sound of the scene's pick-ups to this file."),
    overwrite: bool = flag("--overwrite", "Replace existing files."),
    device: bool = flag(
        "--device", "Serve the record as a device on a pseudo-terminal until Ctrl-C, and print its path."
    ),
    link: Link = None,
    pictures: PictureOptions,
    json: Json = False,
) -> None:
    """Replay a record: run its positions and changes through its scene again. No device is used.

    On the same kind of processor, the forces are those of the run, to the last bit. If they differ, hapsim prints the
    first sample that does. With another scene, it computes the forces of that scene for the same motion of the hand.
    """
    if device or link is not None:
        _serve(record, link, json, device and scene is None and sound_file is None and not pictures.wanted)
        return
    from hapsim.replaying.replay import Record, compare

    pictures.require_writable()
    if sound_file is not None:
        RecordOptions(overwrite=overwrite).require_free(sound_file)
    recorded = Record(record)
    other = None if scene is None else load(scene)
    if other is not None and other.ports and recorded.scene.device_name:
        other = other.at_port(recorded.scene.device_name)
    set_output_units(recorded.scene.units, *map(recorded.scene.units_of, range(recorded.scene.channels)))
    found = compare(recorded, other, sound_file, with_curves=pictures.wanted)
    if pictures.wanted:
        _draw(found, pictures, f"{record.name}{'' if scene is None else f', answered by {Path(scene).name}'}")
    if json:
        print(document({"record": record, "scene": scene} | _document(found, recorded.reader.is_finished)))
    else:
        _print(recorded, scene, found)
        pictures.print_written()
        print_written("Sound", sound_file)
    if not recorded.reader.is_finished:
        warn(f"{record}: {unfinished(found.ticks)}", "incomplete")
    if scene is None and found.difference is not None:
        raise RecordError(f"{record}: the replay differs from sample {found.difference.sample} on")


def _serve(record: Path, link: Path | None, json: bool, is_alone: bool) -> None:
    """Serves a record as a device. `is_alone`: only --link and --json accompany --device."""
    from hapsim.replaying.replay import device_of

    if not is_alone:
        raise UsageError("--device can be combined with --link and --json only, and --link needs --device")
    served = device_of(record)
    serve(served.assemble, link, False, json, f"the record {record} as a device")
    print_message(f"{plural(served.forces, 'force')} taken since it was last armed", "served", "info")


def _draw(found: Comparison, pictures: PictureOptions, title: str) -> None:
    from hapsim.chart.trace_chart import draw_replay, replay_columns

    pictures.write(lambda: replay_columns(found), lambda path: draw_replay(found, title, path))


def _print(record: Record, scene: str | None, found: Comparison) -> None:
    ticks = f"{plural(found.ticks, 'sample')}, {plural(found.changes, 'change')}"
    if scene is None and found.difference is None:
        print_line(f"{record.path}: {ticks}: all forces are identical, to the last bit")
    elif scene is None:
        first = found.difference
        assert first is not None
        print_line(f"{record.path}: {ticks}: sample {first.sample} is the first that differs. {first.what}{found.why}")
    else:
        of_the_hand = f"{plural(found.ticks, 'sample')} of the hand, answered by {scene}"
        has_changes = any("tick" in note for note in record.notes)
        print_line(f"{record.path}: {of_the_hand}{'; changes of its own scene are ignored' if has_changes else ''}")
        for c, rms in enumerate(zip(found.rms_recorded, found.rms_replayed, found.rms_apart, strict=True)):
            was, now, apart = (output_units(c)(one, "N") for one in rms)
            print_line(f"Channel {c}: force {was} rms in the record, {now} rms in this scene; rms difference {apart}")


def _document(found: Comparison, is_complete: bool) -> dict[str, Any]:
    return {
        **pick(found, "ticks changes"),
        **{"identical": found.difference is None, "complete": is_complete},
        **pick(found, "first_difference=difference force_rms_recorded=rms_recorded force_rms_replayed=rms_replayed"),
        "force_rms_apart": found.rms_apart,
    }


def export(
    record: Path = argument("RECORD", "Record: a .trace, or the .part file that a crash left.", default=...),
    out: Path = argument(
        "OUT", "Output file: .h5, .mcap, .csv, .npz, .wav, .yaml, events.tsv or trials.tsv.", default=...
    ),
    *,
    scene_at: float | None = option(
        "S", "Write the scene as it was then, in s since the first row (required for a .yaml)."
    ),
    column: str | None = option(
        "NAME", "Signal of a .wav (required for one): column and channel, such as force.0, or a pick-up."
    ),
    overwrite: bool = flag("--overwrite", "Replace existing files."),
    json: Json = False,
) -> None:
    """Write a record for other programs: HDF5, MCAP, CSV, NumPy or sound; its trials or events as a table; or its
    scene as it was at a time."""
    from hapsim.replaying.export import Columns, require_exportable
    from hapsim.replaying.export import export as write
    from hapsim.replaying.tables import table_of

    if scene_at is not None:
        _export_scene(record, out, scene_at, column, overwrite, json)
        return
    require_exportable(out, column)
    RecordOptions(overwrite=overwrite).require_free(out)
    with at_work(stderr(), f"exporting {record}") as show:
        columns = Columns(record)
        full_scale, unit = write(columns, out, column, lambda share: show(f"exporting {record}: {100.0 * share:.0f} %"))
    missing = _missing(columns)
    if json:
        about = {
            **{"record": record, "file": out, "rows": columns.count, "channels": columns.channels},
            "columns": {column.name: columns.units_text(column) for column in columns.all},
            **{"changes": len(columns.changes), "markers": len(columns.markers)},
            **{"full_scale": full_scale or None, "full_scale_unit": unit or None, "missing": missing},
        }
        print(document(about))
        return
    for sentence in missing:
        warn(f"{record}: {sentence}", "incomplete")
    scale = f"; full scale is {number(full_scale)} {unit}".rstrip() if full_scale else ""
    of = f"{table_of(out)} of " if out.suffix == ".tsv" else ""
    print_line(f"{out}: {of}{plural(columns.count, 'row')} of {plural(columns.channels, 'channel')}{scale}")


def _export_scene(record: Path, out: Path, at: float, column: str | None, overwrite: bool, json: bool) -> None:
    from hapsim.replaying.scene_at import scene_at
    from hapsim.scene.rewrite import write_text

    if out.suffix != ".yaml" or column is not None:
        raise UsageError(f"{out}: --scene-at writes a .yaml and needs its name, without --column")
    RecordOptions(overwrite=overwrite).require_free(out)
    found = scene_at(record, at)
    write_text(out, found.text)
    if json:
        about = {"record": record, "file": out, "time_s": at} | pick(found, "changes as_written=is_as_written")
        print(document(about))
        return
    form = "" if found.is_as_written else "; all values in SI units, without comments: the record lacks the file's text"
    print_line(f"{out}: the scene at {number(at)} s, after {plural(found.changes, 'change')}{form}")


def _missing(columns: Columns) -> list[str]:
    """Returns the gaps of the record, as sentences."""
    dropped = int(columns.report["dropped_rows"])
    slow = f"{plural(dropped, 'row')} missing: the reader of the loop was too slow"
    older = "recorded by an older hapsim, without scene, changes and prediction"
    is_so = (not columns.reader.is_finished, dropped > 0, columns.scene is None)
    sentences = unfinished(columns.count), slow, older
    return [sentence for sentence, applies in zip(sentences, is_so, strict=True) if applies]


def unfinished(rows: int) -> str:
    """Returns the sentence about a record without its end."""
    return f"incomplete record of {plural(rows, 'row')}: the run goes on, or the file is cut off or damaged"
