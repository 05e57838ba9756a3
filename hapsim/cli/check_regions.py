"""What `hapsim check` prints of a hand that feels different springs and dampers at different places, and of contacts
that move masses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.markup import escape

from hapsim.cli.output import Table, table
from hapsim.number_format import duration, number, rounded_up
from hapsim.units import Units

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.prediction import Prediction, Region
    from hapsim.scene import Scene

_ROWS = 10  # of a table; of more regions those that are alike share a row, and of these the others are summed up
_ALIKE = 6  # digits
_NOISY = 20  # regions below a count; nobody designs more
_GROWING = 3  # states of contacts in which something grows


@dataclass(frozen=True)
class _Row:
    region: Region
    alike: int
    is_here: bool
    """Whether the hand is taken to be in it, or in one like it."""


def show_regions(out: Console, scene: Scene, prediction: Prediction) -> None:
    """Prints a table for each hand with regions; hands that feel the same share one."""
    from hapsim.scene import Detent

    shared: dict[tuple[tuple[tuple[str, ...], ...], tuple[str, ...]], list[str]] = {}
    for name, regions in prediction.regions.items():
        rows, others = _rows(regions, prediction.region_here[name])
        key = tuple(map(_cells, rows)), (others, _narrow(regions), _bounces(regions), regions[0].hand.units.name("m"))
        shared.setdefault(key, []).append(name)
    for (cells, (*sentences, _unit)), names in shared.items():
        out.print(_table(", ".join(names), cells, prediction.regions[names[0]][0].hand.units))
        for sentence in filter(None, sentences):
            out.print(sentence)
    for name, swing in prediction.judge.swings.items():
        if swing is not None:
            unnoticed = ": less than a count" if swing.is_unnoticed else ""
            ways = swing.sentence(scene.units_of(scene.device_points[name].channel))
            out.print(f"Where it is unstable, {escape(name)} swings by {ways}{unnoticed}")
    for name, link in scene.links.items():
        if isinstance(link, Detent) and scene.device.travel is None and prediction.regions.keys() & set(link.between):
            out.print(f"{escape(name)} repeats every {scene.units(link.pitch, 'mm', 4)}; --at X shows others.")


def show_hand(out: Console, name: str, regions: tuple[Region, ...]) -> None:
    """Prints the table of one hand."""
    rows, others = _rows(regions)
    out.print(_table(name, [_cells(row) for row in rows], regions[0].hand.units))
    if others:
        out.print(others)


def _bounces(regions: tuple[Region, ...]) -> str:
    """Returns that bounces can grow though each region is stable, and what would be enough, in a sentence; "" where
    passivity forbids it, or where it is not derived."""
    held = [one.felt for one in regions if one.kind == "held"]
    needed = max((one.needed_friction for one in held), default=0.0)
    has, unit = regions[0].felt.configuration.friction, regions[0].hand.units.name("N·s/m")
    if not all(one.is_stable for one in regions) or not needed > has:
        return ""
    return f"Not passive: bounces can grow below {rounded_up(needed)} {unit} of friction (declared: {number(has)})"


def _narrow(regions: tuple[Region, ...]) -> str:
    """Returns how many regions are narrower than a count, in a sentence; "" where none is."""
    places = {(one.piece.low, one.piece.high): one.hand.count for one in regions}
    narrow = sum(high - low < count for (low, high), count in places.items())
    if not narrow:
        return ""
    count = regions[0].hand.units(regions[0].hand.count, "µm", 3)
    noise = ": noise of the recording?" if narrow > _NOISY else ""
    return f"{narrow} of {len(places)} regions are narrower than a count of the mock ({count}){noise}"


def _table(names: str, rows: Sequence[tuple[str, ...]], units: Units) -> Table:
    headings = (f"<position  {units.name('mm')}", f"K  {units.name('N/m')}", "B", "felt k", "felt b", "<")
    caption = "← where the table above holds" if any("←" in row[-1] for row in rows) else ""
    return table(f"By region, {escape(names)}", headings, rows, caption, box=None)


def _rows(regions: tuple[Region, ...], here: Region | None = None) -> tuple[list[_Row], str]:
    """All regions, or one of each kind, that nearest to position 0, with how many there are; of more kinds than fit the
    most telling, and what the others are, in a sentence."""
    if len(regions) <= _ROWS:
        return [_Row(one, 1, one is here) for one in regions], ""
    alike: dict[tuple[object, ...], list[Region]] = {}
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


def _summed_up(kinds: list[Region], count: int) -> str:
    """Returns what these regions are, `count` in all, in a sentence; "" where there are none."""
    if not kinds:
        return ""
    low, high = (number(of(one.piece.stiffness for one in kinds), 4) for of in (min, max))
    unstable, snaps = sum(not one.is_stable for one in kinds), sum(one.kind == "snap" for one in kinds)
    words = f"{f', {unstable} unstable' if unstable else ''}{f', {snaps} snaps' if snaps else ''}"
    return f"and {count} others with K from {low} to {high}{words} (--json lists them)"


def _cells(row: _Row) -> tuple[str, ...]:
    region, piece = row.region, row.region.piece
    felt = ("", "") if region.kind != "held" else (number(region.felt.k), number(region.felt.b, 5))
    alike = f", {row.alike} of these" if row.alike > 1 else ""
    here = " ←" if row.is_here else ""
    return (
        _range(piece.low, piece.high, region.hand.units),
        number(piece.stiffness),
        number(piece.damping),
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
    """Returns whether it is stable and passive, or a snap, in a few words."""
    slides = "sliding, " if region.piece.sliding else ""
    if not region.is_stable:
        return f"{slides}[red]unstable: buzzes[/red]"
    if region.kind == "snap":
        return f"{slides}[yellow]snap[/yellow] {number(1e3 * region.snap_energy, 3)} mJ"
    if region.kind == "free":
        return f"{slides}no spring" + (f", {region.hand.units(abs(region.force), 'N', 3)}" if region.force else "")
    return f"{slides}stable{', passive' if region.felt.passive else ''}"


def show_states(out: Console, prediction: Prediction) -> None:
    """Prints in how many states the scene's other contacts can be, and what grows in which."""
    states = prediction.states
    for one in sorted(states.growing, key=lambda one: -one.growth)[:_GROWING]:
        whose = f"the motion of {escape(one.module)}" if one.module else "a motion"
        fast = f"e-fold in {duration(1.0 / (prediction.rate * math.log(one.growth)))}"
        out.print(f"[red]Unstable[/red] while {escape(one.state)}: {whose} grows {fast} by itself")
    if len(states.growing) > _GROWING:
        out.print(f"and in {len(states.growing) - _GROWING} other ways (--json lists them)")
    if states.unjudged:
        which = f"{states.unjudged} of {states.count}" if states.is_complete else "some of more than 1000"
        out.print(f"[yellow]Not judged[/yellow]: {which} states of its contacts")
    elif states.count > 1 and prediction.stable:
        out.print(f"Stable {states.words}")
