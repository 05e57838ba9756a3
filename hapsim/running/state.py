"""How a daemon is doing, for whoever asks from beside: read from any thread, and nobody waits for it."""

from __future__ import annotations

import contextlib
import os
from datetime import UTC, datetime
from typing import Any, Literal

from hapsim.errors import UsageError
from hapsim.running.reconnecting import Observer
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
        self._released: bool | None = None
        self._news = ""
        self._lost: str | None = None

    @property
    def observer(self) -> Observer:
        """What keeps it up."""
        return Observer(started=self._started, over=self._over, waiting=self._waiting, tell=self._tell)

    def document(self) -> dict[str, Any]:
        """As `--json` names it, of the session that runs, or else the last one; a value that is not there is None, as
        force, position and age are while nothing runs: the last ones are not what the hand has now."""
        session = self._session
        progress = None if session is None else session.progress()
        now = progress if self._phase == "running" else None
        return self._about | {
            "phase": self._phase,
            "armed_since": self._armed_since,
            "reconnections": max(self._sessions - 1, 0),
            "news": self._news,
            "lost": self._lost,
            "released": self._released,
            "duration_s": None if progress is None else progress.elapsed_s,
            "rate_hz": None if progress is None else progress.rate_hz,
            "ticks": 0 if progress is None else progress.ticks,
            "force_n": None if now is None else now.force,
            "position_m": None if now is None else now.position,
            "age_samples": None if now is None else now.age_samples,
            "deadline_misses": 0 if progress is None else progress.deadline_misses,
            "limited_ticks": 0 if progress is None else progress.limited_ticks,
            "estimated_mass_kg": () if progress is None else progress.estimated_mass_kg,
            "estimated_mass_uncertainty_kg": () if progress is None else progress.estimated_mass_uncertainty_kg,
            "mass_explained": () if progress is None else progress.mass_explained,
        }

    def _started(self, session: Session) -> None:
        self._session, self._sessions = session, self._sessions + 1
        self._armed_since = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._released, self._lost, self._phase = None, None, "running"

    def _over(self) -> None:
        if self._phase == "running" and self._session is not None:
            with contextlib.suppress(UsageError):  # a session whose end failed has no report: not known
                self._released = self._session.trace.report.released
        elif self._released:
            self._released = None  # what was tried since then may have armed it, and no report tells
        self._armed_since, self._phase = None, "ended"

    def _waiting(self) -> None:
        self._phase = "waiting"

    def _tell(self, event: str, sentence: str) -> None:
        self._news = sentence
        if event == "lost":
            self._lost = sentence  # what comes while it is waited for is about the port
