"""Following a scene's file while the scene runs: what is edited there is felt at once."""

from __future__ import annotations

import os
from dataclasses import dataclass

from hapsim.errors import UsageError
from hapsim.running.session import Session
from hapsim.scene import Scene, load_scene

_OVER_S = 0.05  # in which a change is led to the hand


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

    def look(self, session: Session) -> News | None:
        """Where the file was written since the last look, changes the running scene to what it says; None otherwise.

        A file that is wrong, gone, or asks for what cannot change while the scene runs, changes nothing.
        """
        stamp = _stamp(self._path)
        if stamp == self._stamp:
            return None
        self._stamp = stamp
        if stamp is None:
            return None  # an editor that writes a new file and then renames it
        before = session.scene
        try:
            wanted = load_scene(self._path)
            # The port may have been given with the command, which counts more than the file.
            device = wanted.device.model_copy(update={"port": before.device.port})
            session.adopt(wanted.model_copy(update={"device": device}), _OVER_S)
        except UsageError as error:
            return News(refused=str(error))
        return News(changed=_differences(before, session.scene))


def _stamp(path: str) -> tuple[int, int] | None:
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def _differences(before: Scene, after: Scene) -> tuple[str, ...]:
    return tuple(
        f"{name}.{key} {getattr(module, key):g} → {getattr(after.modules[name], key):g}"
        for name, module in before.modules.items()
        for key in module.live
        if getattr(module, key) != getattr(after.modules[name], key)
    )
