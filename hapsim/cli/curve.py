"""`hapsim curve`: the curve of a link, and a scene with it, from what an instrument recorded."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape

from hapsim.cli.command_options import (
    Json,
    PictureOptions,
    argument,
    flag,
    load,
    option,
    print_next,
    print_written,
    require_positive,
    require_units,
)
from hapsim.cli.live import at_work
from hapsim.cli.output import Line, document, set_output_units, show, stderr, stdout
from hapsim.documents import pick
from hapsim.errors import UsageError
from hapsim.number_format import plural, rounded_up
from hapsim.whole_file import whole_file

if TYPE_CHECKING:
    from hapsim.curves.made_curve import Deviation, MadeCurve, Maker
    from hapsim.units import Units

_BASES = {"linear": "first_touch", "rotary": "knob_24"}
_ROWS = 3  # of the parts that are too steep


def curve(
    recording: list[str] = argument("RECORDING", "CSV file, or one of pressing and one of releasing.", default=...),
    output: Path | None = option("FILE.csv", "Write the curve to this file.", "--output", "-o"),
    new: Path | None = option("FILE.yaml", "Write a scene with the curve to this file, too."),
    scene: str | None = option("SCENE", "Scene whose device it is for [default: first_touch, of a knob knob_24]"),
    units: str | None = option("UNITS", "Units of the columns in place of the file's head, such as -,mm,gf."),
    within: float | None = option("N", "Largest distance from the smooth recording [default: 1 % of it]", unit="N"),
    turn: float | None = option("X", "Way from branch to branch [default: 2 % of the way, or more]", unit="m"),
    one_branch: bool = flag("--one-branch", "Take the mean of press and release."),
    *,
    picture: PictureOptions,
    json: Json = False,
) -> None:
    """Make the curve of a `nonlinear` link from a recording of force over distance.

    The recording may have several strokes, repeated distances and noise. The curve has as few points as stay close to
    it, and is no steeper than the device of the scene can render.
    """
    from hapsim.curves.made_curve import Maker
    from hapsim.curves.recording import recording_of
    from hapsim.scene.curve_file import read_table

    output = output or (new and new.with_suffix(".csv"))
    picture.require_writable()
    _require_new(recording, output, new)
    found = recording_of([read_table(one, units or "") for one in recording])
    maker = Maker(load(scene or _BASES[found.motion]), found)
    set_output_units(found.units, found.units)
    require_units(found.units, within, turn)
    require_positive("--within", within, found.units.si.name("N"))
    require_positive("--turn", turn, found.units.si.name("m"))
    with at_work(stderr(), "searching for the curve"):
        made = maker.make(within and float(within), turn and float(turn), one_branch)
    if output is not None:
        _write(maker, made, output, new, recording)
    if picture.wanted:
        from hapsim.chart.curve_chart import columns_of, draw_curve

        picture.write(lambda: columns_of(made), lambda path: draw_curve(made, path))
    if json:
        print(document(pick(made, made.DOCUMENT) | {"curve": output, "scene": new}))
        return
    show(stdout(), _lines(made, maker, ", ".join(recording)))
    print_written("Curve", output)
    print_written("Scene", new)
    picture.print_written()
    if new is not None:
        print_next("check" if made.prediction.stable else "check --explain", str(new))


def _require_new(recording: list[str], output: Path | None, new: Path | None) -> None:
    """Raises UsageError if a file cannot be written, or would replace another one than a curve."""
    from hapsim.recording.background_file import require_writable

    if len(recording) > 2:
        raise UsageError(f"found {len(recording)} recordings, expected one, or those of pressing and releasing")
    if output is not None:
        require_writable(output, ".csv")
    if new is not None:
        require_writable(new, ".yaml", ".yml")
    if output is not None and any(
        os.path.exists(one) and output.exists() and output.samefile(one) for one in recording
    ):
        raise UsageError(f"{output}: this is the recording itself, and is not replaced; name another file")
    if new is not None and os.path.lexists(new):
        raise UsageError(f"{new}: the file exists and is not replaced; name another")


def _write(maker: Maker, made: MadeCurve, output: Path, new: Path | None, recording: list[str]) -> None:
    """Writes the curve in the units of the recording, and the scene."""
    units, curve = made.recording.units, made.curve
    columns = [units.scaled(curve.x, "m"), *(units.scaled(force, "N") for force in curve.branches)]
    rows = [",".join([units.name("m"), *[units.name("N")] * len(curve.branches)])]
    rows += [",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True)]
    with whole_file(output) as file:
        file.write_text("\n".join([*rows, ""]), encoding="utf-8")
    if new is None:
        return
    name = os.path.relpath(output.resolve(), new.resolve().parent)
    value = name if curve.turn is None else {"file": name, "turn": units(curve.turn, "m", 4)}
    made_of, base = ", ".join(map(os.path.basename, recording)), os.path.basename(maker.base.path or "")
    head = (
        f"# A curve of {made_of}, made by `hapsim curve`: {_closeness(made.rendered, units)}\n"
        "# from the recording where the device can render it. Rate, delay, mass and counts are those of "
        f"{base or _BASES[made.recording.motion]}.\n"
    )
    with whole_file(new) as file:
        file.write_text(maker.text(value, maker.damping, maker.base.rate, head), encoding="utf-8")


def _closeness(one: Deviation, units: Units) -> str:
    return f"{units(one.rms, 'N', 2)} rms, {units(one.largest, 'N', 2)} at most"


def _range(low: float, high: float, units: Units) -> str:
    return units(" to ".join(units.number(one, "mm", 4) for one in (low, high)), "mm")


def _lines(made: MadeCurve, maker: Maker, name: str) -> Iterator[Line]:
    """Yields what was made, how close it is, and what is predicted."""
    from hapsim.prediction.turning import turning_sentences

    recording, curve, units = made.recording, made.curve, made.recording.units
    strokes = f", {plural(recording.strokes, 'stroke')}" if recording.strokes else ""
    yield f"{escape(name)}: {plural(recording.rows, 'row')}{strokes}"
    yield from recording.notes
    branches = "press and release" if len(curve.branches) > 1 else "one branch"
    turn = "" if curve.turn is None else f", which cross over {units(curve.turn, 'mm', 3)} (turn)"
    way = _range(float(curve.x[0]), float(curve.x[-1]), units)
    yield f"Curve: {plural(curve.x.size, 'point')} of {branches}, {way}{turn}"
    if made.steep:
        yield from _limits(made, maker)
    close = f"within {units(made.within, 'N', 2)} of the recording without noise"
    yield f"{'Elsewhere' if made.steep else 'It is'} {close}; from its rows {_closeness(made.rendered, units)}"
    yield from turning_sentences(made.prediction.scene)
    yield from [] if made.prediction.stable else [f"This scene is {made.prediction.verdict}"]


def _limits(made: MadeCurve, maker: Maker) -> Iterator[str]:
    """Yields which parts of the recording the device cannot render, and what would help."""
    units, config = made.recording.units, made.prediction.felt[0].configuration
    device = f"{maker.base.rate:g} Hz, delay {config.delay:g}, {units(config.mass, 'kg', 3)}"
    dampings = [units(one, "N·s/m", 3) for one in (config.friction, made.damping)]
    rendered = f"{units(made.steepest, 'N/m', 3)}{', crossing included' * (made.curve.turn is not None)}"
    yield f"The device can render {rendered}: {device}, friction {dampings[0]}, the scene's damping {dampings[1]}"
    for one in made.steep[:_ROWS]:
        slope = f"up to {units(one.slope, 'N/m', 3)}{', which would buzz' * one.buzzes}"
        yield f"  {_range(one.low, one.high, units)}: {slope}"
    if more := made.steep[_ROWS:]:
        yield f"  and {plural(len(more), 'other')}"
    ways = [f"a damping of {units(made.needed_damping, 'N·s/m', rounded_up)}"] * math.isfinite(made.needed_damping)
    ways += [f"a rate of {rounded_up(made.needed_rate)} Hz"] * math.isfinite(made.needed_rate)
    off = f"The curve is up to {units(made.deviation.largest, 'N', 2)} from the recording there"
    yield f"{off}{'; all of it would be stable with ' * bool(ways)}{', or with '.join(ways)}"
