"""Watching a scene's file while the scene runs: an edit acts as soon as it is saved, and changes what it changed in the
file: other live values stay."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from pydantic import BaseModel

from hapsim.errors import SceneError, UsageError
from hapsim.running.changes import OVER
from hapsim.running.live_parameters import MOCK_HAND, parts_of
from hapsim.running.saving import merged, unsaved
from hapsim.running.session import Session
from hapsim.scene import Scene, load_scene
from hapsim.scene.quantity import expectation_of
from hapsim.scene.written_units import has_dimension
from hapsim.units import Units

_OVER_S = 0.05  # the ramp of a change
_NEXT_START = " (initial state: takes effect at the next start)"
_MOST_MISSES = 10  # checks of a missing file: an editor may be replacing it


@dataclass(frozen=True)
class EditResult:
    """The result of an edit."""

    changed: tuple[str, ...] = ()
    """Phrases such as "touch.stiffness 2000 N/m → 500 N/m"."""
    refused: str = ""
    """Reason why nothing was changed."""


class WatchedFile:
    """The file that a running scene was loaded from, and those of its curves."""

    def __init__(self, path: str, scene: Scene | None = None) -> None:
        """`scene`: as read from it [default: as it is now]."""
        self._missed, self._refused = 0, False
        self._begin(path, scene or load_scene(path))

    def _begin(self, path: str, scene: Scene) -> None:
        self._path, self._then, self._files = path, scene, (path, *scene.files)
        self._stamp = self._stamp_now()

    def check(self, session: Session) -> EditResult | None:
        """Changes the running scene to that of the file, if it was written since the last check; else returns None.
        Once the scene was saved in another file, that one is watched.

        A file that is invalid, missing in ten checks, or needs a change that a running scene cannot make, changes
        nothing.
        """
        running = session.scene
        if running.path not in (None, self._path) and running.origin is not None:
            self._begin(running.path, running.origin.scene)
        stamp = self._stamp_now()
        gone = [path for path, now, seen in zip(self._files, stamp, self._stamp, strict=True) if seen and not now]
        self._missed = self._missed + 1 if gone else 0
        if self._missed == _MOST_MISSES:
            self._stamp = stamp
            return self._refuse(f"{gone[0]}: the file is gone; the scene continues unchanged")
        if gone or stamp == self._stamp:
            return None
        seen, self._stamp = self._stamp, stamp
        before = session.scene
        try:
            wanted = load_scene(self._path)
            self._follow(wanted.files)
            after = merged(self._then, wanted, before)
            # The command's --port overrides the file.
            device = after.device.model_copy(update={"port": before.device.port})
            session.adopt(after.model_copy(update={"device": device}), _OVER_S)
            self._then = wanted
        except SceneError as error:
            self._follow(error.files)
            return self._refuse(str(error))
        except UsageError as error:
            if str(error) == OVER:  # the next session may take it
                self._stamp = seen
                return None
            return self._refuse(f"{self._path}: {error}")
        except Exception as error:
            return self._refuse(f"{self._path}: a defect of hapsim itself: {type(error).__name__}: {error}")
        changed = tuple(_differences(before, after))
        if not changed and not self._refused:
            return None
        self._refused = False
        kept = f", but for the live values {', '.join(names)}" if (names := unsaved(session.scene)) else ""
        return EditResult(changed=changed or (f"nothing: the file matches the running scene{kept}",))

    def _stamp_now(self) -> tuple[tuple[int, ...] | None, ...]:
        return tuple(map(_stamp, self._files))

    def _follow(self, files: Iterable[str]) -> None:
        """Watches these curves from now on."""
        known = dict(zip(self._files, self._stamp, strict=True))
        self._files = (self._path, *files)
        self._stamp = tuple(known[path] if path in known else _stamp(path) for path in self._files)

    def _refuse(self, why: str) -> EditResult:
        self._refused = True
        return EditResult(refused=why)


def _stamp(path: str) -> tuple[int, ...] | None:
    """Returns values that identify a version of the file; None if it is missing, empty or not a regular file."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    if not stat.S_ISREG(status.st_mode) or status.st_size == 0:
        return None
    return status.st_mtime_ns, status.st_ctime_ns, status.st_ino, status.st_size


def _differences(before: Scene, after: Scene) -> Iterator[str]:
    """Yields a phrase for each difference between two scenes."""
    yield from _different_keys("", before, after, ("scheme", "precision"), after.units)
    if before.mock is not None and after.mock is not None and before.mock.initial != after.mock.initial:
        yield f"mock.initial{_NEXT_START}"
    hand, moved = parts_of(before)[MOCK_HAND], parts_of(after)[MOCK_HAND]
    yield from _different_keys(f"{MOCK_HAND}.", hand, moved, hand.live, after.units)
    for name in {**before.modules, **after.modules}:
        old, new = before.modules.get(name), after.modules.get(name)
        if old is None or new is None:
            yield f"{name}: removed ({old.type})" if old else f"{name}: added ({after.modules[name].type})"
        elif old.type != new.type:
            yield f"{name}: {old.type} → {new.type}"
        else:
            units = after.units_at(name)
            yield from _different_keys(f"{name}.", old, new, type(old).model_fields, units, old.initial)
    for name, pick_up in before.sound.items():  # the names are the same: others are rejected
        keys = type(pick_up).model_fields
        yield from _different_keys(f"sound.{name}.", pick_up, after.sound[name], keys, after.units)


def _different_keys(
    prefix: str, before: BaseModel, after: BaseModel, keys: Iterable[str], units: Units, initial: Iterable[str] = ()
) -> Iterator[str]:
    for key in keys:
        old, new = getattr(before, key), getattr(after, key)
        if old != new:
            expected = expectation_of(type(before).model_fields[key])
            unit = expected.unit if expected and has_dimension(expected.unit) else ""
            shown = (_text(one, unit, units) for one in (old, new))
            yield f"{prefix}{key} {' → '.join(shown)}{_NEXT_START if key in initial else ''}"


def _text(value: object, unit: str, units: Units) -> str:
    if isinstance(value, BaseModel):
        fields = value.model_dump(exclude_none=True).items()
        return ", ".join(f"{name} {_text(one, '', units)}" for name, one in fields)
    if isinstance(value, tuple | list):
        return f"[{', '.join(_text(one, '', units) for one in value)}]"
    if not isinstance(value, float):
        return str(value)
    return units(value, unit, "g") if unit else f"{value:g}"
