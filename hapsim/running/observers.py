"""What observes a run on behalf of others: the notifier of systemd, and the state that `hapsim status` reads.

The notifier sends datagrams to $NOTIFY_SOCKET, as sd_notify(3): ready, running, stopping. It sends WATCHDOG=1 only if
the loop has ticked since the last one, or while it waits for a device. systemd kills and restarts a loop that hangs;
the device has released its force by then.
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, Literal

from hapsim.errors import HapsimError, UsageError
from hapsim.progress import Progress
from hapsim.running.reconnecting import RunObserver
from hapsim.running.session import Session

_SHARE = 1 / 3  # of the watchdog's time, after which it hears from us again
_STATUS_S = 1.0  # between two lines of STATUS


class Notifier:
    """Tells nothing where no service manager listens. Nothing that fails here ends a run."""

    def __init__(
        self,
        reconnects: bool,
        environ: Mapping[str, str] = os.environ,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`reconnects`: the end of a session is not yet that of the run. `clock`: s."""
        self._address = environ.get("NOTIFY_SOCKET", "")
        self._watchdog_s = _watchdog_s(environ)
        self._reconnects, self._clock = reconnects, clock
        self._ticks = 0
        self._alive_at = self._status_at = -1e9

    @property
    def observer(self) -> RunObserver:
        """What has it tell."""
        if not self._address:
            return RunObserver()
        return RunObserver(
            started=self._started, running=self._running, over=self._over, waiting=self._waiting, tell=self._tell
        )

    def stopping(self, why: object = "") -> None:
        """The run is over; what is left is written. `why`: it did not end as asked, a sentence."""
        self._send("STOPPING=1", *([f"STATUS={_one_line(why)}"] if why else []))

    @contextlib.contextmanager
    def told_of_failures(self) -> Iterator[None]:
        """Around a run: what ends it before anything is armed is reported, too."""
        try:
            yield
        except HapsimError as failure:
            self.stopping(failure)
            raise
        except Exception as failure:
            self.stopping(f"a defect of hapsim: {failure!r}")
            raise

    def _started(self, session: Session) -> None:
        self._ticks = 0
        self._send("READY=1", f"STATUS={_one_line(session.scene.path or 'the scene')} runs")

    def _running(self, progress: Progress) -> None:
        if progress.phase != "running":
            self._status(progress.phase)
            return
        if progress.ticks > self._ticks and self._alive():
            self._ticks = progress.ticks
        rate = "" if progress.seen_rate_hz is None else f" {progress.seen_rate_hz:.1f} Hz,"
        self._status(f"running {progress.elapsed_s:.0f} s,{rate} deadline misses {progress.deadline_misses}")

    def _over(self) -> None:
        if not self._reconnects:
            self.stopping()

    def _tell(self, _event: str, sentence: str) -> None:
        self._status_at = -1e9
        self._status(sentence)

    def _waiting(self) -> None:
        self._alive()

    def _alive(self) -> bool:
        """Tells it, unless that was only just told; whether it did."""
        if self._watchdog_s is None or self._clock() - self._alive_at < self._watchdog_s * _SHARE:
            return False
        self._alive_at = self._clock()
        self._send("WATCHDOG=1")
        return True

    def _status(self, sentence: str) -> None:
        if self._clock() - self._status_at >= _STATUS_S:
            self._status_at = self._clock()
            self._send(f"STATUS={_one_line(sentence)}")

    def _send(self, *lines: str) -> None:
        if not self._address:
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sending:
            sending.setblocking(False)
            sending.sendto("\n".join(lines).encode("utf-8", "replace"), address)


def _one_line(sentence: object) -> str:
    return " ".join(str(sentence).split())


def _watchdog_s(environ: Mapping[str, str]) -> float | None:
    """The time within which it has to hear from this process; None where it does not ask."""
    try:
        process, time_us = int(environ.get("WATCHDOG_PID") or os.getpid()), int(environ.get("WATCHDOG_USEC") or 0)
        watchdog_s = 1e-6 * time_us
    except (ValueError, OverflowError):
        return None
    return watchdog_s if watchdog_s > 0 and process == os.getpid() else None


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
    def observer(self) -> RunObserver:
        """What keeps it up."""
        return RunObserver(started=self._started, over=self._over, waiting=self._waiting, tell=self._tell)

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
