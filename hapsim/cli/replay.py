"""`hapsim replay`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapsim.cli.device import Link, serve
from hapsim.cli.export import unfinished
from hapsim.cli.options import Json, PictureOptions, RecordOptions, flag, load, option, say_written
from hapsim.cli.output import complain, document, say, speak_in, warn
from hapsim.errors import RecordError, UsageError
from hapsim.number_format import number, plural

if TYPE_CHECKING:
    from hapsim.replaying.replay import Comparison, Record


def replay(
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="A .trace of `hapsim run --record`.")],
    scene: Annotated[
        str | None,
        typer.Argument(metavar="[SCENE]", help="Another scene for the same hand [default: the recorded one]"),
    ] = None,
    *,
    sound_file: Annotated[Path | None, option("FILE.wav", "Write what the scene's pick-ups hear.")] = None,
    overwrite: Annotated[bool, flag("--overwrite", "Replace a file that exists.")] = False,
    device: Annotated[
        bool, flag("--device", "Serve the record as a device on a pseudo-terminal until Ctrl-C, and print its path.")
    ] = False,
    link: Link = None,
    pictures: PictureOptions,
    json: Json = False,
) -> None:
    """Run a record again, without a device: its positions and changes through its scene.

    The forces are those of the run, to the last bit, on the same kind of processor; else it names the first sample
    that differs. With another scene it computes what that scene would have answered to the same hand. It opens no
    port.
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
    speak_in(recorded.scene.units, *map(recorded.scene.units_of, range(recorded.scene.channels)))
    found = compare(recorded, other, sound_file, with_curves=pictures.wanted)
    if pictures.wanted:
        _draw(found, pictures, f"{record.name}{'' if scene is None else f', answered by {Path(scene).name}'}")
    if json:
        print(document({"record": str(record), "scene": scene} | _document(found, recorded.reader.is_finished)))
    else:
        _say(recorded, scene, found)
        pictures.say_written()
        say_written("Sound", sound_file)
    if not recorded.reader.is_finished:
        warn(f"{record}: {unfinished(found.ticks)}", "incomplete")
    if scene is None and found.difference is not None:
        raise RecordError(f"{record}: the replay differs from sample {found.difference.sample} on")


def _serve(record: Path, link: Path | None, json: bool, is_alone: bool) -> None:
    """`is_alone`: whether --device has nothing beside it but --link and --json."""
    from hapsim.replaying.replay import device_of

    if not is_alone:
        raise UsageError("--device serves the record alone: it goes with --link and --json, and --link goes with it")
    served = device_of(record)
    serve(served.assemble, link, False, json)
    complain(f"{plural(served.forces, 'force')} taken since it was last armed", "served", "info")


def _draw(found: Comparison, pictures: PictureOptions, title: str) -> None:
    from hapsim.chart.trace import draw_replay, replay_columns

    pictures.write(lambda: replay_columns(found), lambda path: draw_replay(found, title, path))


def _say(record: Record, scene: str | None, found: Comparison) -> None:
    ticks = f"{plural(found.ticks, 'sample')}, {plural(found.changes, 'change')}"
    if scene is None and found.difference is None:
        say(f"{record.path}: {ticks}: every force is as it was, to the last bit")
    elif scene is None:
        first = found.difference
        assert first is not None
        say(f"{record.path}: {ticks}: sample {first.sample} is the first that differs. {first.what}{found.why}")
    else:
        of_the_hand = f"{plural(found.ticks, 'sample')} of the hand, answered by {scene}"
        has_changes = any("tick" in note for note in record.notes)
        say(f"{record.path}: {of_the_hand}{'; the changes of its own scene do not apply' if has_changes else ''}")
        for c, rms in enumerate(zip(found.rms_recorded, found.rms_replayed, found.rms_apart, strict=True)):
            was, now, apart = map(number, rms)
            say(f"Channel {c}: the force was {was} N rms and would be {now} N rms; they are {apart} N rms apart")


def _document(found: Comparison, is_complete: bool) -> dict[str, Any]:
    first = found.difference
    return {
        "ticks": found.ticks,
        "changes": found.changes,
        "identical": first is None,
        "complete": is_complete,
        "first_difference": None if first is None else {"tick": first.tick, "sample": first.sample, "what": first.what},
        "force_rms_recorded": found.rms_recorded,
        "force_rms_replayed": found.rms_replayed,
        "force_rms_apart": found.rms_apart,
    }
