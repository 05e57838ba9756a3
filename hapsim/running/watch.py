"""Following a scene's file while the scene runs: what is edited there is felt at once."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from hapsim.errors import SceneError, UsageError
from hapsim.running.changes import OVER
from hapsim.running.session import Session
from hapsim.scene import Scene, load_scene
from hapsim.scene.modules import Module

_OVER_S = 0.05  # in which a change is led to the hand
_AT_THE_NEXT_START = " (how it begins: felt at the next start)"
_PATIENCE = 10  # looks at a file that is not there


@dataclass(frozen=True)
class News:
    """What an edit came to."""

    changed: tuple[str, ...] = ()
    """Such as "touch.stiffness 2000 → 500"."""
    refused: str = ""
    """Why nothing was changed."""


class WatchedFile:
    """The file that a running scene was loaded from."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._stamp = _stamp(path)
        self._missed = 0
        self._refused = False

    def look(self, session: Session) -> News | None:
        """Where the file was written since the last look, changes the running scene to what it says; None otherwise.

        A file that is wrong, gone for ten looks, or asks for what cannot change while a scene runs, changes nothing.
        """
        stamp = _stamp(self._path)
        if stamp is None:
            return self._gone()
        self._missed = 0
        if stamp == self._stamp:
            return None
        seen, self._stamp = self._stamp, stamp
        before = session.scene
        try:
            wanted = load_scene(self._path)
            # The port may have been given with the command, which counts more than the file.
            device = wanted.device.model_copy(update={"port": before.device.port})
            session.adopt(wanted.model_copy(update={"device": device}), _OVER_S)
        except SceneError as error:
            return self._refuse(str(error))
        except UsageError as error:
            if str(error) == OVER:  # the next session may take it
                self._stamp = seen
                return None
            return self._refuse(f"{self._path}: {error}")
        except Exception as error:
            return self._refuse(f"{self._path}: a defect of hapsim itself: {type(error).__name__}: {error}")
        changed = _differences(before, wanted)
        if not changed and not self._refused:
            return None
        self._refused = False
        return News(changed=changed or ("nothing: the file says what runs",))

    def _gone(self) -> News | None:
        """An editor may take a file away and put another in its place: only one that stays away is reported."""
        self._missed += 1
        if self._missed != _PATIENCE:
            return None
        self._stamp = None
        return self._refuse(f"{self._path}: the file is gone; the scene goes on as it was")

    def _refuse(self, why: str) -> News:
        self._refused = True
        return News(refused=why)


def _stamp(path: str) -> tuple[int, ...] | None:
    """What tells one state of a file from another; None where there is no file. One that is none (a pipe) would keep
    its reader waiting."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    if not stat.S_ISREG(status.st_mode) or status.st_size == 0:  # which it is while some editors write it
        return None
    return status.st_mtime_ns, status.st_ctime_ns, status.st_ino, status.st_size


def _differences(before: Scene, after: Scene) -> tuple[str, ...]:
    """What the one has that the other has not, thing by thing."""
    changed = [
        f"{key} {_text(a)} → {_text(b)}"
        for key in ("scheme", "precision")
        for a, b in [_both(before, after, key)]
        if a != b
    ]
    if before.mock is not None and after.mock is not None and before.mock.initial != after.mock.initial:
        changed.append(f"mock.initial{_AT_THE_NEXT_START}")
    for name, module in before.modules.items():
        if name not in after.modules:
            changed.append(f"{name}: removed ({module.type})")
        elif module.type != after.modules[name].type:
            changed.append(f"{name}: {module.type} → {after.modules[name].type}")
        else:
            changed += _different_keys(name, module, after.modules[name])
    changed += [f"{name}: added ({one.type})" for name, one in after.modules.items() if name not in before.modules]
    return tuple(changed)


def _different_keys(name: str, before: Module, after: Module) -> Iterator[str]:
    for key in type(before).model_fields:
        old, new = _both(before, after, key)
        if old != new:
            later = _AT_THE_NEXT_START if key in before.initial else ""
            yield f"{name}.{key} {_text(old)} → {_text(new)}{later}"


def _both(before: object, after: object, key: str) -> tuple[Any, Any]:
    return getattr(before, key), getattr(after, key)


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple | list):
        return f"[{', '.join(_text(one) for one in value)}]"
    return str(value)
