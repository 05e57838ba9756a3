"""What `hapsim run` says on standard error: sentences for people, or the same sentences as lines of JSON for a log.

A line of JSON has `time` (UTC), `level` (info, warning, error), `event`, `message` and `fields`. Of one event about one
thing a line comes at most once a second; the next one, or the last line of all, has in `left_out` how many did not.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, Literal

from hapsim.cli.sentences import say

Level = Literal["info", "warning", "error"]

_PERIOD_S = 1.0


class JsonLog:
    """Lines of JSON, from any thread."""

    def __init__(self, write: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        """`write`: takes a line with its end. `clock`: s."""
        self._write, self._clock = write, clock
        self._lock = threading.Lock()
        self._last: dict[tuple[str, str], float] = {}
        self._left_out: dict[tuple[str, str], int] = {}

    def say(self, level: Level, event: str, message: str, about: str = "", **fields: Any) -> None:
        """Writes it, or counts it as left out. `about`: what tells it from others of its event."""
        key = event, about
        with self._lock:
            now = self._clock()
            if key in self._last and now - self._last[key] < _PERIOD_S:
                self._left_out[key] = self._left_out.get(key, 0) + 1
                return
            self._last = {one: at for one, at in self._last.items() if now - at < _PERIOD_S} | {key: now}
            self._write_line(level, event, message, fields, self._left_out.pop(key, 0))

    def close(self) -> None:
        """Says what was left out and never followed by another of its kind."""
        with self._lock:
            for (event, _), count in self._left_out.items():
                self._write_line("info", event, f"{count} more of these were left out", {}, count)
            self._left_out.clear()

    def _write_line(self, level: Level, event: str, message: str, fields: dict[str, Any], left_out: int) -> None:
        from hapsim.cli.as_json import plain

        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = {"time": now, "level": level, "event": event, "message": message, "fields": plain(fields)}
        if left_out:
            line["left_out"] = left_out
        self._write(json.dumps(line, allow_nan=False) + "\n")


_json: JsonLog | None = None


def use_json_log() -> JsonLog:
    """From now on everything that goes to standard error does as JSON, until `use_sentences`."""
    global _json  # noqa: PLW0603 (standard error is the whole process's, too)

    def write(line: str) -> None:
        sys.stderr.write(line)
        sys.stderr.flush()

    _json = JsonLog(write)
    return _json


def use_sentences() -> None:
    """As it is at first."""
    global _json  # noqa: PLW0603
    if _json is not None:
        _json.close()
    _json = None


def json_log() -> JsonLog | None:
    """None where people read."""
    return _json


def complain(problem: object, event: str = "failed", level: Level = "error") -> None:
    """What went wrong, on standard error."""
    if _json is not None:
        _json.say(level, event, str(problem), about=str(problem))
    else:
        say(f"Warning: {problem}" if level == "warning" else problem, sys.stderr)
