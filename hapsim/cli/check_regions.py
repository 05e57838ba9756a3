"""Lines of `hapsim check` about the regions of a hand's travel."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rich.markup import escape

from hapsim.cli.output import Line, Table, table
from hapsim.laws import flank_stiffness
from hapsim.number_format import number, plural, rounded_up
from hapsim.units import Units

if TYPE_CHECKING:
    from hapsim.prediction import Prediction, Region
    from hapsim.prediction.characteristic import Characteristic, Flank
    from hapsim.scene import Detent, Scene


_ROWS = 10  # of a table; of more regions those that are alike share a row, and of these the others are summed up
_ALIKE = 6  # digits
_MANY = 4  # regions of a flank that are one row
_NOISY = 20  # regions below a count; nobody designs more
_BRANCHES = {"stuck": ("", "softest", "steepest"), "pressed": ("pressed",), "released": ("released",)}


@dataclass(frozen=True)
class _Row:
    region: Region
    alike: int
    is_here: bool
    """True for the assumed region of the hand, or one like it."""


def region_lines(scene: Scene, prediction: Prediction) -> Iterator[Line]:
    """Yields a table for each hand with regions. Hands that feel the same share a table."""
    from hapsim.scene import Detent

    shared: dict[tuple[tuple[tuple[str, ...], ...], tuple[str, ...]], list[str]] = {}
    for part in prediction.parts:
        if not (regions := part.regions):
            continue
        if any(one.piece.branch for one in regions):
            yield from _branch_lines(part.names[0], regions)
            continue
        rows, others = _rows(regions, part.region_here)
        key = tuple(map(_cells, rows)), (others, _narrow(regions), _bounces(regions), regions[0].hand.units.name("m"))
        shared.setdefault(key, []).append(part.names[0])
    for (cells, (*sentences, _unit)), names in shared.items():
        yield _table(", ".join(names), cells, prediction.regions[names[0]][0].hand.units)
        if any(one.piece.is_curved for one in prediction.regions[names[0]]):
            yield "K, B, felt k and felt b of a curved region hold where the hand rests in it, or else in its middle."
        if any("pieces" in cell[-1] for cell in cells):
            yield "K of several pieces is that over their flank, to the steepest; felt k and b are of the steepest."
        yield from filter(None, sentences)
    for name, swing in prediction.judge.swings.items() if scene.device.law == "host" else ():
        if swing is not None:
            unnoticed = ": less than a count" if swing.is_unnoticed else ""
            yield f"Where it is unstable, {escape(name)} swings by {swing.sentence(scene.units_at(name))}{unnoticed}"
    for name, link in scene.links.items():
        held = [one for one in link.between if one in prediction.regions]
        if isinstance(link, Detent) and link.is_held and held:
            yield _holds(name, link, scene, prediction.regions[held[0]][0].hand)
        if isinstance(link, Detent) and link.pitch and scene.device.travel is None and held:
            pitch = prediction.regions[held[0]][0].hand.units(link.pitch, "mm", 4)
            yield f"{escape(name)} repeats every {pitch}; --at X shows others."


def _branch_lines(name: str, regions: tuple[Region, ...]) -> Iterator[Line]:
    """Yields the table of a hand on curves with two branches, a row for each piece, the least stable ones if these are
    many."""
    pieces: dict[tuple[float, float], list[Region]] = {}
    for one in regions:
        pieces.setdefault((one.piece.low, one.piece.high), []).append(one)
    every = sorted(pieces.items(), key=lambda item: -max(one.growth for one in item[1]))
    units, rows = regions[0].hand.units, []
    for (low, high), here in sorted(every[:_ROWS]):
        slopes = [[one.piece.stiffness for one in here if one.piece.branch in states] for states in _BRANCHES.values()]
        ends = [dict.fromkeys(units.number(end(one), "N/m", 4) for end in (min, max) if one) for one in slopes]
        rows.append((_range(low, high, units), *(" to ".join(one) for one in ends), _branch_verdict(here)))
    headings = (f"<position  {units.name('mm')}", f"K stuck  {units.name('N/m')}", "K pressed", "K released", "<")
    yield table(f"By region, {escape(name)}", headings, rows, box=None)
    if len(every) > _ROWS:
        yield f"and {len(every) - _ROWS} others, no less stable (--json lists them)"
    yield from filter(None, [_narrow(regions), _bounces(regions)])


def _branch_verdict(regions: list[Region]) -> str:
    """Returns a few words: in which states it is unstable, or the largest energy of a snap, or stable."""
    wrong = {one.piece.branch for one in regions if not one.is_stable}
    if wrong:
        where = [how for how, states in _BRANCHES.items() if wrong & {*states}]
        return "[red]unstable: buzzes[/red]" + f" {' and '.join(where)}" * (len(where) < len(_BRANCHES))
    snaps = [one for one in regions if one.kind == "snap"]
    if snaps:
        return _verdict(max(snaps, key=lambda one: one.snap_energy))
    return "stable" if any(one.kind == "held" for one in regions) else "no spring"


def _holds(name: str, link: Detent, scene: Scene, hand: Characteristic) -> str:
    """Returns a sentence on a detent that remembers its place, with what a jump to the next may add when sampled."""
    if not (way := max(link.ways)):
        return f"{escape(name)} remembers its place, the only one"
    took, late = link.passage(way), 1.0 if scene.device.law == "board" else 0.5 + scene.device.delay
    stiffness = flank_stiffness(link.depth, link.hold, way, link.free)
    units, adds = hand.units, stiffness * way * hand.crossing * scene.period * late
    sampled = f"within {units(adds, 'mJ', 2)} when sampled at {units(hand.crossing, 'm/s', 3)}"
    holds = f"it holds for {number(link.hold, 4)} of the way to the next"
    return f"{escape(name)} remembers its place: {holds}, and a passage takes {units(took, 'mJ', 3)}, {sampled}"


def hand_lines(name: str, regions: tuple[Region, ...]) -> Iterator[Line]:
    """Yields the table of one hand."""
    rows, others = _rows(regions)
    yield _table(name, [_cells(row) for row in rows], regions[0].hand.units)
    yield from filter(None, [others])


def _bounces(regions: tuple[Region, ...]) -> str:
    """Returns the friction below which bounces can grow though each region is stable, in a sentence; "" if the scene is
    passive, or if passivity is not derived."""
    held = [one.felt for one in regions if one.kind == "held"]
    needed = max((one.needed_friction for one in held), default=0.0)
    has, units = regions[0].felt.configuration.friction, regions[0].hand.units
    if not all(one.is_stable for one in regions) or not needed > has:
        return ""
    declared = f"(declared: {units.number(has, 'N·s/m')})"
    below = f"below {units(needed, 'N·s/m', rounded_up)} of" if math.isfinite(needed) else "at any"
    return f"Not passive: bounces can grow {below} friction {declared}"


def _narrow(regions: tuple[Region, ...]) -> str:
    """Returns the number of regions narrower than a count, in a sentence; "" if there are none."""
    places = {(one.piece.low, one.piece.high): one.hand.count for one in regions}
    narrow = sum(high - low < count for (low, high), count in places.items())
    if not narrow:
        return ""
    count = regions[0].hand.units(regions[0].hand.count, "µm", 3)
    noise = ": noise of the recording?" if narrow > _NOISY else ""
    return f"{narrow} of {len(places)} regions are narrower than a count of the mock ({count}){noise}"


def _table(names: str, rows: Sequence[tuple[str, ...]], units: Units) -> Table:
    headings = (f"<position  {units.name('mm')}", f"K  {units.name('N/m')}", "B", "felt k", "felt b", "<")
    caption = "← region of the table above" if any("←" in row[-1] for row in rows) else ""
    return table(f"By region, {escape(names)}", headings, rows, caption, box=None)


def _rows(regions: tuple[Region, ...], here: Region | None = None) -> tuple[list[_Row], str]:
    """Returns all regions if they fit; otherwise of each kind the one nearest to position 0, and how many there are. If
    even these do not fit, returns the least stable ones, and a sentence about the others."""
    if len(regions) <= _ROWS:
        return [_Row(one, 1, one is here) for one in regions], ""
    regions, here = _joined(regions, here)
    alike: dict[tuple[object, ...], list[Region]] = {}
    if len(regions) <= _ROWS:
        return [_Row(one, 1, one is here) for one in regions], ""
    for one in regions:
        piece = one.piece
        values = (piece.stiffness, piece.damping, piece.high - piece.low, one.force if one.kind == "free" else 0.0)
        end = piece.low if math.isinf(piece.high - piece.low) else 0.0  # what has no other end is like nothing else
        alike.setdefault((end, *(number(value, _ALIKE) for value in values), piece.sliding, one.kind), []).append(one)
    rows = [
        _Row(min(group, key=lambda one: abs(one.piece.place)), len(group), any(one is here for one in group))
        for group in alike.values()
    ]
    rows.sort(key=lambda row: (not row.is_here, -row.region.growth, row.region.piece.low - row.region.piece.high))
    shown = sorted(rows[:_ROWS], key=lambda row: row.region.piece.low)
    return shown, _summed_up([row.region for row in rows[_ROWS:]], sum(row.alike for row in rows[_ROWS:]))


def _joined(regions: tuple[Region, ...], here: Region | None) -> tuple[tuple[Region, ...], Region | None]:
    """Returns these regions with one in place of the many of each flank, with the flank's K: that of them which is the
    least stable, or else the steepest. And that which has the place of `here`."""
    hand = regions[0].hand
    members: dict[tuple[Flank | int, tuple[str, ...]], list[Region]] = {}
    for one in regions:
        piece = one.piece
        is_whole = math.isfinite(piece.high - piece.low) and not piece.is_curved
        flank = (hand.flank_at(0.5 * (piece.low + piece.high)) if is_whole else None) or id(one)
        members.setdefault((flank, piece.sliding), []).append(one)
    found: list[Region] = []
    for (flank, _), every in members.items():
        if isinstance(flank, int) or len(every) < _MANY:
            found += every
            continue
        falls = flank.stiffness < 0.0
        worst = max(every, key=lambda one: (one.growth, -one.felt.stiffness if falls else one.felt.stiffness))
        low, high = every[0].piece.low, every[-1].piece.high
        piece = worst.piece._replace(low=low, high=high, stiffness=flank.stiffness, place=0.5 * (low + high))
        found.append(replace(worst, piece=piece, pieces=len(every)))
        here = found[-1] if any(one is here for one in every) else here
    return tuple(found), here


def _summed_up(kinds: list[Region], count: int) -> str:
    """Returns a summary of these regions, `count` in all, in a sentence; "" if there are none."""
    if not kinds:
        return ""
    units = kinds[0].hand.units
    low, high = (units.number(of(one.piece.stiffness for one in kinds), "N/m", 4) for of in (min, max))
    unstable, snaps = sum(not one.is_stable for one in kinds), sum(one.kind == "snap" for one in kinds)
    words = f", {unstable} unstable" * bool(unstable) + f", {plural(snaps, 'snap')}" * bool(snaps)
    return f"and {count} others with K from {low} to {high}{words} (--json lists them)"


def _cells(row: _Row) -> tuple[str, ...]:
    region, piece, units = row.region, row.region.piece, row.region.hand.units
    felt = ("", "")
    if region.kind == "held":
        felt = units.number(region.felt.k, "N/m"), units.number(region.felt.b, "N·s/m", 5)
    alike = f", {row.alike} of these" if row.alike > 1 else ""
    stiffness = units.number(piece.stiffness, "N/m")
    if region.pieces > 1:
        stiffness = f"{units.number(piece.stiffness, 'N/m', 4)} to {units.number(region.felt.stiffness, 'N/m', 4)}"
        alike = f", {region.pieces} pieces{alike}"
    here = " ←" if row.is_here else ""
    return (
        _range(piece.low, piece.high, units),
        stiffness,
        units.number(piece.damping, "N·s/m"),
        *felt,
        _verdict(region) + alike + here,
    )


def _range(low: float, high: float, units: Units) -> str:
    ends = units.number(low, "mm", 4), units.number(high, "mm", 4)
    if math.isfinite(low) and math.isfinite(high):
        return " to ".join(ends)
    if math.isfinite(low):
        return f"above {ends[0]}"
    return f"below {ends[1]}" if math.isfinite(high) else "everywhere"


def _verdict(region: Region) -> str:
    """Returns a few words: stable, passive, unstable, or a snap."""
    slides = "sliding, " if region.piece.sliding else ""
    if not region.is_stable:
        return f"{slides}[red]unstable: buzzes[/red]"
    if region.kind == "snap":
        return f"{slides}[yellow]snap[/yellow] {region.hand.units(region.snap_energy, 'mJ', 3)}"
    if region.kind == "free":
        return f"{slides}no spring" + (f", {region.hand.units(abs(region.force), 'N', 3)}" if region.force else "")
    return f"{slides}stable{', passive' if region.felt.passive else ''}"
