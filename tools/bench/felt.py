"""Share of the plane of stiffness and damping that the hand feels with each correction, measured on the mock in virtual
time.

    tools/bench/felt [--grid 24x12] [--only CONDITION ...] [--corrections NAME ...] [--processes N] [--json FILE]
                     [--from FILE.json]

The plane is that of a hand on one spring and damper, with K T²/m from 1e-4 to 2 (logarithmic) and a damping ratio from
0 to 1.5. It is divided into cells, each measured at its middle. A cell is felt if the k and b identified from the run
are off by at most 5 % (b: of itself, or of 0.1 sqrt(k m) if that is more). A cell without identification is not felt.
It is pressed if it is stable and the stiffness against a steady push is off by at most 5 %. Nothing is predicted here.
One device is enough, 50 g at 1 kHz, since only K T²/m, B T/m and the delay in samples count.

The hand is released at rest from a deflection and pushed every 32 samples, so that a motion that ends within three
samples is seen sixty times. If the identification is not certain to 0.1 %, the cell is measured again with other
intervals between the pushes; the measurement with the smallest stated uncertainty counts. The steady push is that of
`mock.hand`, on a hand that starts at its end position. Its mean position over whole periods counts, two seconds later.

`--json` saves every cell, `--from` prints the table of a saved file.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import statistics
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import hapsim
from hapsim.errors import HapsimError
from hapsim.prediction.correction import felt_error
from hapsim.running import Excitation
from hapsim.scene import Device, DevicePoint, Ground, Hand, Initial, Mock, Scene, Span, ViscoElastic

MASS, RATE = 0.05, 1000.0  # kg, Hz: declared
FROM, TO, MOST_RATIO = 1e-4, 2.0, 1.5  # K T²/m; damping ratio
WITHIN = (0.01, 0.05, 0.1)

FORCE_LIMIT = 100.0  # N
DEFLECTED, FURTHEST = 25.0, 0.1  # N that hold the hand before its release, and m at most
PUSH = 25.0  # N
PUSHES = ((32, 40), (8, 20), (23, 40), (4, 40), (16, 100), (11, 30))  # samples: every, from which on
DURATION = 2.0  # s
CERTAIN = 0.001  # what is identified so well is not measured again
SURELY = 2.0  # uncertainties by which a k or b is below 0 that counts as unstable
ROOM, COUNTS = 16.0, 2.0**31  # range of the position counts over how far the hand moves


class Contender(NamedTuple):
    """Correction of a device; ``settles``: time before the measurement, s."""

    name: str
    device: dict[str, Any]
    settles: float = 0.0


SENSED = {"correction": "sensed", "sensors": ("velocity", "acceleration")}
CONTENDERS = (
    Contender("none", {}),
    Contender("poles", {"correction": "poles"}),
    Contender("predictor", {"correction": "predictor"}),
    Contender("adaptive", {"correction": "adaptive", "mass": Span(least=0.5 * MASS, most=2.0 * MASS)}, settles=4.0),
    Contender("sensed", SENSED),
    Contender("sensed, one force old", SENSED | {"acceleration_age": 1}),
)
NONE = CONTENDERS[0].name

AS_DECLARED = "as declared"
CONDITIONS: dict[str, dict[str, Any]] = {
    AS_DECLARED: {},
    **{f"true mass × {factor:g}": {"mock": {"mass": factor * MASS}} for factor in (0.5, 0.9, 1.1, 2.0)},
    "1 µm counts": {"mock": {"quantum": 1e-6}},
    "12-bit force": {"mock": {"force_quantum": FORCE_LIMIT / 2048.0}},
    "1 % of the forces late": {"mock": {"misses": 0.01}},
    **{f"delay {delay:g}": {"device": {"delay": delay}} for delay in (0.0, 0.37, 2.0, 3.0)},
}
"""Differences from a delay of 1 sample, a zero-order hold and no friction, on a mock with the finest counts."""


FIELDS = ("error", "uncertainty", "stable", "pressed")


class Cell(NamedTuple):
    """Measurement at one point of the plane."""

    error: float
    """Infinite where nothing was identified."""
    uncertainty: float
    """Uncertainty stated by the identification."""
    stable: bool
    pressed: float = math.inf
    """Deviation of the stiffness against a steady push; infinite if unknown."""


def plane(columns: int, rows: int) -> Iterator[tuple[float, float]]:
    """The middles of the cells: (K T²/m, damping ratio)."""
    for i in range(columns):
        for j in range(rows):
            yield FROM * (TO / FROM) ** ((i + 0.5) / columns), MOST_RATIO * (j + 0.5) / rows


def scene_of(kappa: float, ratio: float, contender: Contender, condition: dict[str, Any], push: float = 0.0) -> Scene:
    """A hand that is released from a deflection, on a mock whose counts are as fine as the motion allows. With a
    `push` (N), it pushes instead, from the position to which the push should bring it."""
    k, b = desired(kappa, ratio)
    start = push / k if push else min(DEFLECTED / k, FURTHEST)
    pushed = PUSH / (MASS * RATE) / math.sqrt(k / MASS)  # m: how far a push of one sample swings it
    quantum = ROOM * max(start, pushed) / COUNTS
    device = {"clock": "lockstep", "mass": MASS, "force_limit": FORCE_LIMIT} | contender.device
    return Scene(
        version=1,
        rate=RATE,
        device=Device(**(device | condition.get("device", {}))),
        mock=Mock(
            **(
                {"initial": Initial(position=start), "quantum": quantum, "hand": Hand(force=push)}
                | condition.get("mock", {})
            )
        ),
        modules={
            "hand": DevicePoint(channel=0),
            "wall": Ground(),
            "touch": ViscoElastic(between=("hand", "wall"), stiffness=k, damping=b),
        },
    )


def desired(kappa: float, ratio: float) -> tuple[float, float]:
    """(k, b) in N/m and N·s/m: the scene's K and B, since nothing of the device is real."""
    k = kappa * MASS * RATE**2
    return k, 2.0 * ratio * math.sqrt(k * MASS)


def measured(kappa: float, ratio: float, contender: Contender, condition: dict[str, Any]) -> Cell:
    """The measurement that is most certain of itself. A run that fails was unstable."""
    scene = scene_of(kappa, ratio, contender, condition)
    best = Cell(math.inf, math.inf, stable=False)
    for every, first in PUSHES:
        cell = measured_once(scene, desired(kappa, ratio), contender.settles, every, first)
        if cell.uncertainty < best.uncertainty or (cell.stable and not best.stable):
            best = cell
        if best.uncertainty <= CERTAIN or not cell.stable:
            break
    return Cell(*best[:3], pressed=pressed(kappa, ratio, contender, condition)) if best.stable else best


def pressed(kappa: float, ratio: float, contender: Contender, condition: dict[str, Any]) -> float:
    """Returns the deviation of the stiffness against a steady push; infinite if the run fails."""
    k, _ = desired(kappa, ratio)
    push = min(DEFLECTED, FURTHEST * k)
    try:
        trace = hapsim.run(
            scene_of(kappa, ratio, contender, condition, push), duration=2.0 * DURATION, transport="loopback"
        )
    except HapsimError:
        return math.inf
    period = 2.0 * math.pi / math.sqrt(kappa)  # samples
    whole = round(max(1.0, DURATION * RATE // period) * period)
    found = push / float(trace.position[-whole:, 0].mean())
    return abs(found - k) / k


def measured_once(scene: Scene, wanted: tuple[float, float], settles: float, every: int, first: int) -> Cell:
    """One run, and what is identified from it."""
    mass, settling = scene.mock_device.mass[0], round(settles * RATE)
    pushes = Excitation(0, PUSH, 1, every, first, first=False)
    try:
        trace = hapsim.run(scene, duration=settles + DURATION, transport="loopback", excitation=pushes)
    except HapsimError:
        return Cell(math.inf, math.inf, stable=False)
    try:
        found = hapsim.measure_trace(trace.since(settling), mass)
    except HapsimError:
        return Cell(math.inf, math.inf, stable=stays(trace))
    k, b = wanted
    error = float(felt_error((found.k, found.b), wanted, mass))
    of_b = found.b_uncertainty / max(b, 0.1 * math.sqrt(k * mass))
    uncertainty = max(found.k_uncertainty / k, of_b)
    holds = found.k > -SURELY * found.k_uncertainty and found.b > -SURELY * found.b_uncertainty
    stable = holds or (not uncertainty <= CERTAIN and stays(trace))
    return Cell(error, uncertainty if math.isfinite(uncertainty) else math.inf, stable)


def stays(trace: hapsim.Trace) -> bool:
    """Returns whether a motion without identification dies out: between the last pushes the force falls far below its
    limit."""
    last = np.abs(trace.asked_force[-2 * max(every for every, _ in PUSHES) :, 0])
    return bool(last.size and last.min() < 0.1 * FORCE_LIMIT and last.max() < FORCE_LIMIT)


def cell_of(name: str, condition: str, scene: Scene) -> dict[str, float]:
    """Returns the measurement of the cell with this scene's stiffness and damping."""
    touch = scene.links["touch"]
    assert isinstance(touch, ViscoElastic)
    kappa, ratio = touch.stiffness / (MASS * RATE**2), 0.5 * touch.damping / math.sqrt(touch.stiffness * MASS)
    contender = next(one for one in CONTENDERS if one.name == name)
    cell = measured(kappa, ratio, contender, CONDITIONS[condition])
    return {f"cell_{field}": value for field, value in zip(FIELDS, cell, strict=True)}


def measure_all(columns: int, rows: int, conditions: list[str], names: list[str], processes: int) -> dict[str, Any]:
    """Every cell of every condition with some corrections, as the document that is kept."""
    wanted = (desired(*at) for at in plane(columns, rows))
    points = [{"touch.stiffness": k, "touch.damping": b} for k, b in wanted]
    carrier = scene_of(0.01, 0.5, CONTENDERS[0], {})
    cells: dict[str, dict[str, list[list[Any]]]] = {condition: {} for condition in conditions}
    for condition, name in itertools.product(conditions, names):
        what = f"{condition}, {name}"
        found = hapsim.sweep(
            carrier,
            points,
            quantities=(),
            function=partial(cell_of, name, condition),
            jobs=processes,
            on_progress=lambda done, _, what=what: print(f"\r{what}: {done}   ", end="", file=sys.stderr, flush=True),
        )
        if failed := [one for one in found["error"].values if one]:
            raise RuntimeError(failed[0])
        columns_of = zip(*(found[f"cell_{field}"].values for field in FIELDS), strict=True)
        cells[condition][name] = [
            [
                bool(value) if field == "stable" else _kept(float(value))
                for field, value in zip(FIELDS, cell, strict=True)
            ]
            for cell in columns_of
        ]
    print(file=sys.stderr)
    about = {"order": "damping ratio after damping ratio, then the next K T²/m", "fields": FIELDS}
    return {"columns": columns, "rows": rows, **about, "cells": cells}


def _kept(value: float | bool) -> float | bool | None:
    """A number in few digits; null where there is none."""
    if isinstance(value, bool):
        return value
    return float(f"{value:.3g}") if math.isfinite(value) else None


def table(document: dict[str, Any]) -> str:
    """The shares for a page, felt and pressed; of the cells of each correction, how many are not identified to 0.1 %,
    and how many were stable without it and are not with it."""
    names = list(next(iter(document["cells"].values())))
    lines = [
        "| within 5 % | "
        + " | ".join(f"{name}: felt | pressed" for name in names)
        + " | uncertainty, median | not sure to 0.1 % | made unstable |",
        "|---|" + "---|" * (2 * len(names) + 3),
    ]
    for condition, of_contenders in document["cells"].items():
        every = {name: [_cell(row) for row in rows] for name, rows in of_contenders.items()}
        shares = [_share(cells, of_contenders[name], what) for name, cells in every.items() for what in FIELDS[::3]]
        corrected = [cells for name, cells in every.items() if name != NONE]
        spoilt = [str(made_unstable(every[NONE], cells)) for cells in corrected] if NONE in every else ["?"]
        known = [cell.uncertainty for cells in every.values() for cell in cells if math.isfinite(cell.uncertainty)]
        unsure = [str(sum(cell.uncertainty > CERTAIN for cell in cells)) for cells in every.values()]
        words = [condition, *shares, f"{statistics.median(known):.0e}", ", ".join(unsure), ", ".join(spoilt)]
        lines.append("| " + " | ".join(words) + " |")
    return "\n".join(lines)


def _share(cells: list[Cell], rows: list[list[Any]], what: str) -> str:
    """Nothing, where the kept rows are of a time when that was not measured."""
    return f"{share(cells, what, 0.05):.3f}" if len(rows[0]) > FIELDS.index(what) else ""


def _cell(row: list[Any]) -> Cell:
    return Cell(*(math.inf if value is None else value for value in row))


def share(cells: list[Cell], what: str, within: float) -> float:
    """Returns the share of the plane within a deviation. `what`: a field of the cells."""
    return sum(getattr(cell, what) <= within for cell in cells) / len(cells)


def made_unstable(without: list[Cell], corrected: list[Cell]) -> int:
    """Cells that were stable without a correction and are not with it."""
    return sum(one.stable and not other.stable for one, other in zip(without, corrected, strict=True))


def main() -> int:
    parser = argparse.ArgumentParser(
        "tools/bench/felt", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--grid", default="24x12", help="cells along K T²/m and along the damping ratio")
    parser.add_argument("--only", nargs="+", choices=list(CONDITIONS), metavar="CONDITION", help="; ".join(CONDITIONS))
    every = [one.name for one in CONTENDERS]
    parser.add_argument("--corrections", nargs="+", choices=every, default=every, metavar="NAME", help="; ".join(every))
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--json", type=Path, help="keep every cell")
    parser.add_argument("--from", dest="kept", type=Path, help="print the table of what --json kept")
    arguments = parser.parse_args()
    if arguments.kept:
        document = json.loads(arguments.kept.read_text(encoding="utf-8"))
    else:
        columns, rows = (int(number) for number in arguments.grid.split("x"))
        conditions = arguments.only or list(CONDITIONS)
        document = measure_all(columns, rows, conditions, arguments.corrections, arguments.processes)
    if arguments.json:
        arguments.json.write_text(json.dumps(document, ensure_ascii=False) + "\n", encoding="utf-8")
    print(table(document))
    return 0


if __name__ == "__main__":
    sys.exit(main())
