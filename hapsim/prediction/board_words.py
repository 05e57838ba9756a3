"""The force law on the board, in words: what it would change for a scene, and what of it is not judged."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from itertools import pairwise, takewhile
from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.errors import SceneError, UsageError
from hapsim.number_format import frequency, number
from hapsim.prediction.felt_alone import Felt
from hapsim.prediction.linear import fastest_motion
from hapsim.prediction.part import Part
from hapsim.prediction.predict import predict
from hapsim.prediction.prediction import Prediction
from hapsim.prediction.swings import NetworkVerdict
from hapsim.prediction.timing import on_wire, time_to_live_samples
from hapsim.scene import Scene

if TYPE_CHECKING:
    from firmware_protocol.lines import Lines


_ROUNDED = 1e-6  # relative: less is not said
_AT_EDGE = 1e-6  # of a piece's width


def on_board(scene: Scene) -> Scene:
    """Returns the scene with `device.law: board`, at the whole multiple of its rate next to `device.board_rate`. Raises
    SceneError if something in it does not fit."""
    steps = max(1, round(scene.device.board_rate / scene.rate))
    return scene.changed({"device.law": "board", "device.board_rate": steps * scene.rate})


def board_sentences(prediction: Prediction, lines: Lines | None, explain: bool) -> Iterator[str]:
    """Yields what the wire and the board do to the lines of each hand. `lines`: as of `sent_sentences`. `explain`: also
    how many answers may be lost, and what `law: board` would change."""
    yield from sent_sentences(prediction, lines)
    yield from crossing_sentences(prediction.scene, prediction)
    if explain:
        yield from loss_sentences(prediction)
        yield from change_sentences(prediction.scene, prediction)


def change_sentences(scene: Scene, prediction: Prediction) -> Iterator[str]:
    """Yields what the law on the board would change for a scene whose host evaluates it; nothing at rates at which no
    board is faster."""
    if scene.device.law == "board" or scene.device.is_admittance or scene.device.board_rate < 2.0 * scene.rate:
        return
    try:
        other = predict(on_board(scene), with_margins=False)
    except (SceneError, UsageError) as why:
        first = str(why).split("; ")[0]
        yield f"`law: board` under `device` does not fit this scene: {first}."
        return
    at = frequency(other.scene.device.board_rate)
    yield f"With `law: board` under `device`, on a board at {at}, the scene would be {other.verdict}:"
    for now, then in zip(prediction.parts, other.parts, strict=True):
        yield f"  {', '.join(now.names)}: {'; '.join(_changes(prediction, now, then))}."


def _changes(prediction: Prediction, now: Part, then: Part) -> Iterator[str]:
    """Yields phrases on what a part is like now, and would be."""
    units, before = prediction.scene.units_of(now.channels[0]), {one.hand: one for one in now.rows if not one.of}
    for one in then.rows:
        if not one.of:
            was = before.get(one.hand)
            k, b = units(one.k, "N/m", 6), units(one.b, "N·s/m", 4)
            words = "no pair" if was is None else f"{units.number(was.k, 'N/m')}, {units.number(was.b, 'N·s/m', 4)}"
            yield f"{one.hand} feels k = {k}, b = {b} (now {words})"
    if now.alone is not None and then.alone is not None and math.isfinite(then.alone.stiffness_factor):
        factors = (number(one.stiffness_factor, 4) for one in (then.alone, now.alone))
        yield "stable up to {} times the stiffness (now {})".format(*factors)
    needed = [float(np.max(one.needed_friction)) for one in (then, now)]
    if not math.isnan(sum(needed)):
        least, at_host = units(needed[0], "N·s/m", 4), units.number(needed[1], "N·s/m", 4)
        yield f"stable in any hand with {least} of friction (now {at_host})"


def sent_sentences(prediction: Prediction, lines: Lines | None) -> Iterator[str]:
    """Yields for each hand the stiffness and damping of its line as the wire carries them, and what it feels of these,
    where they are not those of the scene. `lines`: of the device; None: it follows none."""
    for one in prediction.felt if lines is not None else ():
        try:
            (k, b), found = _carried(prediction, one, lines)
        except ValueError as why:
            yield f"{one.name}: the wire does not carry its line: {why}."
            continue
        asked = one.stiffness, one.damping
        if not np.allclose((k, b), asked, rtol=_ROUNDED, atol=0.0):
            units = prediction.scene.units_of(one.channel)
            whole = (f"{units(k, 'N/m')}, {units(b, 'N·s/m')}" for k, b in (asked, (k, b), (found.k, found.b)))
            yield "{}: the wire carries {} as {}, felt as {}.".format(one.name, *whole)


def _carried(prediction: Prediction, felt: Felt, lines: Any) -> tuple[tuple[float, float], Felt]:
    """Returns a hand's line as the wire carries it, and what the hand feels of it. ValueError if it is beyond the
    device's largest.

    The host's force is that of the scene's stiffness at the sample. So what k lacks acts there: later than the board's
    by the host's delay and half a sample, less half a local period, which costs so much damping.
    """
    from firmware_protocol.lines import as_sent

    k, b = as_sent(felt.stiffness, felt.damping, lines, felt.channel)
    scene, steps = on_wire(prediction.scene), felt.configuration.steps
    later = (scene.device.delay + 0.5 - 0.5 / steps) * scene.period
    return (k, b), replace(felt, damping=b - (felt.stiffness - k) * later)


def carried(prediction: Prediction, lines: Lines | None) -> Prediction:
    """Returns the prediction with what each hand feels of its line as the wire carries it. A line beyond the device's
    largest stays: the run is refused. `lines`: as of `sent_sentences`."""
    if lines is None:
        return prediction
    found, felt = copy(prediction), list(prediction.felt)
    for i, one in enumerate(felt):
        with contextlib.suppress(ValueError):
            felt[i] = _carried(prediction, one, lines)[1]
    found.felt = tuple(felt)
    found.__dict__.pop("parts", None)  # they are made of these
    return found


def crossing_sentences(scene: Scene, prediction: Prediction) -> Iterator[str]:
    """Yields for each hand of a scene on the board the links of which it crosses a whole piece between two lines, each
    with the speed from which on, and the links whose swings from piece to piece are not simulated."""
    if scene.device.law != "board":
        return
    way, simulated = fastest_motion(scene) / scene.rate, {name for part in prediction.lined for name in part.points}
    for name in scene.device_points:
        widths = dict[tuple[str, ...], float]()
        for links, width in _pieces_of(scene, prediction, name):
            widths[links] = min(width, widths.get(links, math.inf))
        units = scene.units_at(name)
        for links, width in widths.items():
            if width < way:
                what = f"a piece of {links[0]}" if len(links) == 1 else f"the way between {' and '.join(links)}"
                speed = units(width * scene.rate, "m/s", 3)
                yield f"{name}: faster than {speed} it crosses {what}, {units(width, 'mm', 3)}, between two lines."
        if widths and name not in simulated:
            yield f"{name}: swings from one piece of its links to another are not judged."


def _pieces_of(scene: Scene, prediction: Prediction, name: str) -> Iterator[tuple[tuple[str, ...], float]]:
    """Yields the links at whose edges a piece of this hand's law ends, and its width, m; of a hand that moves more than
    itself those of each link alone."""
    for region in prediction.regions.get(name, ()):
        low, high = region.piece.low, region.piece.high
        near = _AT_EDGE * (high - low) if math.isfinite(high - low) else 0.0
        ends = {
            at: [x for x in (low, high) if link.edges(x - near, x + near)]
            for at, link in region.hand.links.items()
            if near
        }
        yield tuple(at for at, found in ends.items() if found), high - low
    for at, link in scene.links.items() if name not in prediction.regions else ():
        edges = link.law().edges if name in link.between else ()
        more = [edges[0] + link.law().period] if edges and link.law().period else []
        for low, high in pairwise([*edges, *more]):
            yield (at,), high - low


def loss_sentences(prediction: Prediction) -> Iterator[str]:
    """Yields how many answers in a row may be lost on the way to a board: it keeps its line, so that each is a sample
    of delay more. Nothing for hands that move nothing else, whose lines are as good later."""
    network = prediction.network
    if network.board is None or prediction.is_lone or not prediction.stable_as_taken:
        return
    most = time_to_live_samples(network.rate)
    stable = (
        NetworkVerdict(replace(network, delay=network.delay + n), prediction.points).settles for n in range(1, most)
    )
    lost = sum(takewhile(bool, stable))
    yield f"Stable with up to {lost} answers lost in a row{' (then the board releases)' if lost == most - 1 else ''}."
