"""Verdicts that were found before, by all that they depend on: a change of a running scene is judged by what it
touches.

A verdict is found again only if everything that it was made of is the same to the last bit, so that it is the one that
would be found from nothing.
"""

from __future__ import annotations

import hashlib
import pickle
import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Mapping
from typing import Any, NamedTuple

_MOST = 4096  # verdicts; the one that was not asked for longest is dropped


class _Found(NamedTuple):
    value: Any
    of: Mapping[str, Any]
    """Things that it depends on beside its key, by name."""


class Memory:
    """Verdicts by their keys, for any thread."""

    def __init__(self, most: int = _MOST) -> None:
        self._most, self._found, self._lock = most, OrderedDict[Hashable, _Found](), threading.Lock()

    def recall(
        self, key: Hashable, find: Callable[[], tuple[Any, Collection[str]]], now: Mapping[str, Any] | None = None
    ) -> Any:
        """Returns the value of this key. `now`: things by name, of which the value may depend on some. `find`: returns
        the value anew, and the names of those; it is called where the key is unknown, or one of them differs."""
        now = now or {}
        with self._lock:
            known = self._found.get(key)
        if known is None or not all(now.get(name) is one or now.get(name) == one for name, one in known.of.items()):
            value, names = find()
            known = _Found(value, {name: now.get(name) for name in names})
        with self._lock:
            self._found[key] = known
            self._found.move_to_end(key)
            if len(self._found) > self._most:
                self._found.popitem(last=False)
        return known.value

    def clear(self) -> None:
        """Forgets everything."""
        with self._lock:
            self._found.clear()


VERDICTS = Memory()
"""The verdicts of this process."""


def content_of(*values: Any) -> bytes:
    """Returns a digest of values and arrays: another one for another content."""
    return hashlib.blake2b(pickle.dumps(values, pickle.HIGHEST_PROTOCOL), digest_size=20).digest()
