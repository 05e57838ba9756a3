"""Notes of a record that act: changes of the scene and whatever else another thread asked of the loop, each with the
tick that it began in. A kind is one entry of `KINDS`, by the key that its notes have."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from hapsim.errors import UsageError
from hapsim.running.changed_scene import changed
from hapsim.running.changes import LiveScene
from hapsim.running.live_parameters import words_of
from hapsim.running.pulse_shapes import Pulse
from hapsim.scene import Scene
from hapsim.scene.issue import one_of
from hapsim.scene.load import parse_scene, recorded_scene

Note = Mapping[str, Any]


class NoteKind(NamedTuple):
    """A kind of note."""

    apply: Callable[[LiveScene, Note], object]
    """Does in a replay what was done in the run, before the tick of the note."""
    scene_after: Callable[[Scene, Note], Scene] = lambda scene, _: scene
    """Returns the scene with it [default: unchanged]."""


def _adopt(live: LiveScene, note: Note) -> None:
    wanted = parse_scene(json.dumps(note["adopt"]), "the adopted scene")
    live.adopt(wanted.model_copy(update={"mock": live.scene.mock}), note["over"])


def _adopted(scene: Scene, note: Note) -> Scene:
    return recorded_scene(note["adopt"], "the adopted scene", scene.written)


def _ask_for_lease(live: LiveScene, note: Note) -> None:
    text = note.get("fallback")
    live.ask_for_lease(note["lease"], text and parse_scene(json.dumps(text), "the fallback"))


def _changed(scene: Scene, note: Note) -> Scene:
    return changed(scene, {name: values for name, values in note["set"].items() if name not in words_of(scene)})


def _begin(live: LiveScene, note: Note) -> None:
    live.trial(note["trial"], note["set"], note["restart"], note["over"])


KINDS: dict[str, NoteKind] = {
    "trial": NoteKind(_begin, _changed),  # before "set", which its notes have, too
    "set": NoteKind(lambda live, note: live.set(note["set"], note["over"]), _changed),
    "adopt": NoteKind(_adopt, _adopted),
    "pulse": NoteKind(lambda live, note: live.pulse(Pulse(**note["pulse"]))),
    "lease": NoteKind(_ask_for_lease),
}


def kind_of(note: Note) -> str:
    """Returns the kind of a note that acts. Raises UsageError for one that this hapsim does not know."""
    for name in KINDS:
        if name in note:
            return name
    raise UsageError(f"found a note with {one_of(list(note))}, expected {one_of(list(KINDS))}: it takes a newer hapsim")
