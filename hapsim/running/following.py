"""Following a scene's file while the scene runs: what is edited there is felt at once."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass

from hapsim.errors import SceneError, UsageError
from hapsim.running.session import Session
from hapsim.scene import Scene, load_scene

_OVER_S = 0.05  # in which a change is led to the hand
_PATIENCE = 10  # looks at a file that is not there


@dataclass(frozen=True)
class News:
    """What an edit came to."""

    changed: tuple[str, ...] = ()
    """Such as "touch.stiffness 2000 → 500"."""
    refused: str = ""
    """Why nothing was changed."""


class FollowedFile:
    """The file that a running scene was loaded from."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._stamp = _stamp(path)
        self._missed = 0
        self._refused = False

    def look(self, session: Session) -> News | None:
        """Where the file was written since the last look, changes the running scene to what it says; None otherwise.

        A file that is wrong, gone for ten looks, or asks for what cannot change while the scene runs, changes nothing.
        """
        stamp = _stamp(self._path)
        if stamp is None:
            return self._gone()
        self._missed = 0
        if stamp == self._stamp:
            return None
        self._stamp = stamp
        before = session.scene
        try:
            wanted = load_scene(self._path)
            # The port may have been given with the command, which counts more than the file.
            device = wanted.device.model_copy(update={"port": before.device.port})
            session.adopt(wanted.model_copy(update={"device": device}), _OVER_S)
        except SceneError as error:
            return self._refuse(str(error))
        except UsageError as error:
            return self._refuse(f"{self._path}: {error}")
        changed = _differences(before, session.scene)
        if not changed and not self._refused:
            return None
        self._refused = False
        return News(changed=changed or ("nothing: the file says what runs",))

    def _gone(self) -> News | None:
        """An editor may take a file away and put another in its place: only one that stays away is told."""
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
    if not stat.S_ISREG(status.st_mode):
        return None
    return status.st_mtime_ns, status.st_ctime_ns, status.st_ino, status.st_size


def _differences(before: Scene, after: Scene) -> tuple[str, ...]:
    return tuple(
        f"{name}.{key} {getattr(module, key):g} → {getattr(after.modules[name], key):g}"
        for name, module in before.modules.items()
        for key in module.live
        if getattr(module, key) != getattr(after.modules[name], key)
    )
