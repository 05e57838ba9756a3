"""Outputs that follow the scene: a contact that is closed, the place in which a detent is.

A contact is closed in a sample in which its law has a force at the distance of its ends, whatever its damper adds. A
shape is closed while it touches, a plectrum while it grips. A detent that remembers its place is in that one; any other
is in the nearest.

The numbers are those of the sample whose force goes out with them. During a crossfade they are those of the scene that
weighs more.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocol.compiled import ONE, new_record
from hapsim.compiling import helper
from hapsim.compiling.native import address_of, array_at, record_at
from hapsim.cordis.spring_energy import (
    SLIDER,
    TABLE,
    number_at,
    spring_energy,
    springs_at,
    stored_at,
    stretch_of,
    tension_of,
)
from hapsim.cordis.stored_energy import Springs
from hapsim.cordis.substep_loop import SCENE_SLOT
from hapsim.cordis.tick import program_at
from hapsim.loop.hooks import Hook, Stage, hook
from hapsim.loop.output_words import WORDS_STATE
from hapsim.scene import Detent, Scene
from hapsim.scene.words import Output

_CLOSED, _REMEMBERS, _PLACE, _NEAREST = range(4)

EVENT = np.dtype(
    [
        ("kind", np.int64),  # one of the four above
        ("most", np.int64),  # bits of its value,
        ("shift", np.int64),  # and how many bits of the word are below it
        ("spring", np.int64),  # number of the spring whose force closes it
        ("memory", np.uint64),  # address of what a link remembers, or of a pitch
        ("zero", np.int64),  # 1: it is closed while that is 0; 0: while it is not
    ],
    align=True,
)

EVENTS = np.dtype([("stored", np.uint64), ("rows", np.uint64), ("count", np.int64)], align=True)
"""Addresses of a STORED with springs and of EVENT rows, whose values are joined, and their count."""

_words_at, _slot_at, _events_at, _rows_at = (
    record_at(WORDS_STATE),
    record_at(SCENE_SLOT),
    record_at(EVENTS),
    array_at(EVENT),
)


@hook
def follow_scene(words, _tick):
    """Writes the bits of the outputs that follow the scene, once it has moved."""
    words = _words_at(words)
    slot = _slot_at(words.slot)
    program = program_at(slot.next if slot.next != 0 and slot.weight > 0.5 else slot.program)
    position = program.rows[ONE - np.uint64(program.turn)]  # the tick has gone on to the next row
    events, word = _events_at(program.events), 0
    rows = _rows_at(events.rows, events.count)
    for i in range(np.uint64(events.count)):
        word |= (_value(events, rows[i], position) & rows[i].most) << rows[i].shift
    words.events = word
    return 0


@helper
def _value(events, event, position):
    """Returns the value of an output, whose lowest bits count."""
    stored, none = stored_at(events.stored), np.uint64(0)
    if event.kind == _REMEMBERS:
        return np.int64((number_at(event.memory, 0, stored.single) == 0.0) == (event.zero != 0))
    if event.kind == _PLACE:
        return np.int64(number_at(event.memory, 0, stored.single))
    spring = springs_at(stored.springs, stored.count)[np.uint64(event.spring)]
    d = stretch_of(stored, spring, position, none)
    if event.kind == _NEAREST:
        return np.int64(math.floor(d / number_at(event.memory, 0, stored.single) + 0.5))
    if spring.kind in (TABLE, SLIDER):
        return np.int64(tension_of(spring, d, stored.single) != 0.0)
    return np.int64(spring_energy(stored, spring, position, none) != 0.0)


class Events(Springs):
    """The outputs that follow a program's scene, for compiled code."""

    def __init__(self, program: Any, scene: Scene) -> None:
        """`program`: as of `Springs`."""
        super().__init__(program, scene)
        self._springs: list[tuple[Any, ...]] = []
        rows = [row for one in scene.outputs.values() for row in self._rows(one)]
        self._take(self._springs)
        record = self._events = new_record(EVENTS)
        record.stored, record.rows, record.count = self._record.address, self._keep(rows, EVENT), len(rows)
        program.record.events = address_of(record)

    def _rows(self, output: Output) -> list[tuple[int, ...]]:
        """Returns the EVENT rows of an output; none if programs set it."""
        name = output.when or output.of
        if name is None:
            return []
        link, bits = (self._scene.links | self._scene.plane_links)[name], (output.most, output.shift)
        if isinstance(link, Detent) and output.of and link.is_held:
            return [(_PLACE, *bits, 0, self._remembered(name)["place"], 0)]
        if output.when and link.remembers_touch is not None:
            column, touches = link.remembers_touch
            return [(_REMEMBERS, *bits, 0, self._remembered(name)[column], not touches)]
        first = len(self._springs)
        self._springs += self._of_link(name, link)
        if output.of:
            pitch = self._live(name, "period" if link.table() else "pitch")
            return [(_NEAREST, *bits, first, pitch, 0)]
        return [(_CLOSED, *bits, i, 0, 0) for i in range(first, len(self._springs))]


def events_hook(words: Any, slot: Any) -> Hook:
    """Returns the hook of a WORDS_STATE for outputs that follow the scene. `slot`: SCENE_SLOT."""
    words.slot = address_of(slot)
    return Hook(Stage.ADD, follow_scene, words)
