"""How a daemon is doing, for whoever asks from beside: read from any thread, and nobody waits for it."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from typing import Any, Literal

from hapsim.daemon.reconnecting import Observer
from hapsim.running.session import Session


class RunState:
    """Kept up by its `observer`."""

    def __init__(self, scene: str, port: str | None, nominal_rate_hz: float) -> None:
        """`scene`: its file. `port`: None for the mock."""
        self._about = {"pid": os.getpid(), "scene": scene, "port": port, "nominal_rate_hz": nominal_rate_hz}
        self._phase: Literal["starting", "running", "waiting", "ended"] = "starting"
        self._armed_since: str | None = None
        self._session: Session | None = None
        self._sessions = 0
        self._news = ""

    @property
    def observer(self) -> Observer:
        """What keeps it up."""
        return Observer(started=self._started, over=self._over, waiting=self._waiting, tell=self._tell)

    def document(self) -> dict[str, Any]:
        """As `--json` names it, of the session that runs, or else the last one; a value that is not there is None."""
        session = self._session
        progress = None if session is None else session.progress()
        return self._about | {
            "phase": self._phase,
            "armed_since": self._armed_since,
            "reconnections": max(self._sessions - 1, 0),
            "news": self._news,
            "duration_s": None if progress is None else progress.elapsed_s,
            "rate_hz": None if progress is None else progress.rate_hz,
            "ticks": 0 if progress is None else progress.ticks,
            "force_n": () if progress is None else progress.force,
            "position_m": () if progress is None else progress.position,
            "age_samples": 0 if progress is None else progress.age_samples,
            "deadline_misses": 0 if progress is None else progress.deadline_misses,
            "limited_ticks": 0 if progress is None else progress.limited_ticks,
            "estimated_mass_kg": () if progress is None else progress.estimated_mass_kg,
        }

    def _started(self, session: Session) -> None:
        self._session, self._sessions = session, self._sessions + 1
        self._armed_since = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._phase = "running"

    def _over(self) -> None:
        self._armed_since, self._phase = None, "ended"

    def _waiting(self) -> None:
        self._phase = "waiting"

    def _tell(self, _event: str, sentence: str) -> None:
        self._news = sentence
