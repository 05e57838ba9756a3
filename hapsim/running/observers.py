"""Observers of a run: the notifier of systemd, and the state that `hapsim status` reads.

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
from hapsim.units import Motion

_SHARE = 1 / 3  # of the watchdog's time, between two notifications
_STATUS_S = 1.0  # between two lines of STATUS


class Notifier:
    """Notifies the service manager, if there is one. Nothing that fails here ends a run."""

    def __init__(
        self,
        reconnects: bool,
        environ: Mapping[str, str] = os.environ,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`reconnects`: the run goes on after the end of a session. `clock`: s."""
        address = environ.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._watchdog_s = _watchdog_s(environ)
        self._reconnects, self._clock = reconnects, clock
        self._ticks = 0
        self._alive_at = self._status_at = -1e9

    @property
    def observer(self) -> RunObserver:
        """Has a run notify the service manager."""
        if not self._address:
            return RunObserver()
        return RunObserver(
            started=self._started, running=self._running, over=self._over, waiting=self._waiting, tell=self._tell
        )

    def stopping(self, why: object = "") -> None:
        """Notifies that the run is over. `why`: it did not end as asked, a sentence."""
        self._send("STOPPING=1", *([f"STATUS={_one_line(why)}"] if why else []))

    @contextlib.contextmanager
    def told_of_failures(self) -> Iterator[None]:
        """Around a run: notifies of a failure before arming, too."""
        try:
            yield
        except Exception as failure:
            self.stopping(failure if isinstance(failure, HapsimError) else f"a defect of hapsim: {failure!r}")
            raise

    def _started(self, session: Session) -> None:
        self._ticks = 0
        self._send("READY=1", f"STATUS={_one_line(session.scene.path or 'the scene')} runs")

    def _running(self, progress: Progress) -> None:
        if progress.phase not in ("running", "ended"):
            self._status(progress.phase)
            return
        if progress.ticks > self._ticks and self._keep_alive():
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
        self._keep_alive()

    def _keep_alive(self) -> bool:
        """Notifies the watchdog if it is due; returns whether it was."""
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
        if self._address:
            with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sending:
                sending.setblocking(False)
                sending.sendto("\n".join(lines).encode("utf-8", "replace"), self._address)


def _one_line(sentence: object) -> str:
    return " ".join(str(sentence).split())


def _watchdog_s(environ: Mapping[str, str]) -> float | None:
    """Returns the time within which systemd expects a notification of this process; None where it expects none."""
    try:
        process, time_us = int(environ.get("WATCHDOG_PID") or os.getpid()), float(environ.get("WATCHDOG_USEC") or 0)
    except ValueError:
        return None
    return 1e-6 * time_us if 0 < time_us < float("inf") and process == os.getpid() else None


class RunState:
    """The state of a run, kept up by its `observer`."""

    def __init__(self, scene: str, port: str | None, nominal_rate_hz: float, motion: tuple[Motion, ...] = ()) -> None:
        """`scene`: its file. `port`: None for the mock. `motion`: of each channel."""
        about = {"pid": os.getpid(), "scene": scene, "port": port, "nominal_rate_hz": nominal_rate_hz}
        self._about = about | {"motion": motion}
        self._phase: Literal["starting", "running", "waiting", "ended"] = "starting"
        self._armed_since: str | None = None
        self._session: Session | None = None
        self._sessions = 0
        self._released: bool | None = None
        self._news = ""
        self._lost: str | None = None

    @property
    def observer(self) -> RunObserver:
        """Keeps the state up."""
        return RunObserver(started=self._started, over=self._over, waiting=self._waiting, tell=self._tell)

    def document(self) -> dict[str, Any]:
        """Returns the state under the names of `--json`, for the session that runs, or else the last one. Force,
        position and age are None while nothing runs: the hand does not have the last ones now."""
        runs = self._phase == "running"
        progress = Progress("waiting") if self._session is None else self._session.progress()
        return self._about | {
            "phase": self._phase,
            "armed_since": self._armed_since,
            "reconnections": max(self._sessions - 1, 0),
            "news": self._news,
            "lost": self._lost,
            "released": self._released,
            "duration_s": progress.elapsed_s if self._session else None,
            "rate_hz": progress.rate_hz if self._session else None,
            "ticks": progress.ticks,
            "force_n": progress.force if runs else None,
            "position_m": progress.position if runs else None,
            "age_samples": progress.age_samples if runs else None,
            "deadline_misses": progress.deadline_misses,
            "limited_ticks": progress.limited_ticks,
            "frozen": progress.frozen,
            "estimated_mass_kg": progress.estimated_mass_kg,
            "estimated_mass_uncertainty_kg": progress.estimated_mass_uncertainty_kg,
            "mass_explained": progress.mass_explained,
            "mass_age_s": progress.mass_age_s,
        }

    def _started(self, session: Session) -> None:
        self._session, self._sessions = session, self._sessions + 1
        self._armed_since = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._released, self._lost, self._phase = None, None, "running"

    def _over(self) -> None:
        if self._phase == "running" and self._session is not None:
            with contextlib.suppress(UsageError):  # a session whose end failed has no report
                self._released = self._session.trace.report.released
        elif self._released:
            self._released = None  # a try since then may have armed the device, and there is no report of it
        self._armed_since, self._phase = None, "ended"

    def _waiting(self) -> None:
        self._phase = "waiting"

    def _tell(self, event: str, sentence: str) -> None:
        self._news = sentence
        if event == "lost":
            self._lost = sentence  # later events are about the port
