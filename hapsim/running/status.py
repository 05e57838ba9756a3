"""The status of a run, and the unix socket of `hapsim run --status`, which sends it to each client and hangs up.

The socket reads nothing from a client and waits for none: bytes that the kernel does not take at once are dropped. By
its mode and that of its directory, only its owner may connect.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import select
import socket
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from hapsim.errors import UsageError
from hapsim.loop.background import BackgroundWork
from hapsim.loop.counts import Progress
from hapsim.running.reconnecting import RunObserver
from hapsim.running.session import Session
from hapsim.units import Motion

AUTO = "auto"
"""Option value in place of a path: a path that `hapsim status` finds."""

_ENDING = ".sock"
_PAUSE_S = 0.01  # after each answer, so that many clients take little processor time
_TIMEOUT_S = 2.0
_LONGEST = 1 << 20


@contextlib.contextmanager
def serve_status(path: Path, document: Callable[[], str], idle_priority: bool = True) -> Iterator[None]:
    """Sends the result of `document` to each client of `path` while open. Replaces a killed process's socket. Raises
    UsageError if no socket can be made. `idle_priority`: of the answering thread."""
    listening = _listen(path)
    asked_to_stop, stop = socket.socketpair()
    try:
        work = BackgroundWork(lambda: _serve(listening, asked_to_stop, document), idle_priority)
        try:
            yield
        finally:
            stop.send(b".")
            with contextlib.suppress(Exception):  # a failure to report a run does not end it
                work.result()
    finally:
        for one in (listening, asked_to_stop, stop):
            one.close()
        path.unlink(missing_ok=True)


def path_for(port: str | None) -> Path:
    """Returns the default path for a run on this port, and makes its directory, which only its owner may enter. Raises
    UsageError if that fails or the directory belongs to another user."""
    _require_unix_sockets()
    folder = _folders()[0]
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat()
    except OSError as error:
        raise UsageError(f"--status: {folder} cannot be made: {error.strerror}; name a path") from error
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid() or status.st_mode & 0o077:
        raise UsageError(
            f"--status: {folder} is not a directory of this user's alone (mode 0700): found mode "
            f"{stat.S_IMODE(status.st_mode):04o}, owner {status.st_uid}; name a path, or remove it"
        )
    return folder / (_name(port) + _ENDING)


def sockets(port: str | None = None) -> list[Path]:
    """Returns every default socket, of any port or of this one, without those of other users."""
    _require_unix_sockets()
    name = ("*" if port is None else _name(port)) + _ENDING
    found: dict[Path, None] = {}
    for folder in _folders():
        with contextlib.suppress(OSError):
            if folder.stat().st_uid in (os.geteuid(), 0):
                paths = [*folder.glob(name), *folder.glob(f"*/{name}")]
                found |= dict.fromkeys(path for path in sorted(paths) if path.is_socket())
    return list(found)


def is_served(path: Path) -> bool:
    """Returns whether a run listens at `path`: a killed run leaves its socket behind."""
    with _unix_socket() as connection:
        return connection.connect_ex(str(path)) in (0, errno.EAGAIN)  # EAGAIN: its queue of clients is full


def request_status(path: Path) -> str:
    """Returns the status that the run at `path` sends. Raises UsageError if none answers."""
    with _unix_socket() as connection:
        try:
            connection.connect(str(path))
            received = b""
            while (part := connection.recv(1 << 16)) and len(received) < _LONGEST:
                received += part
        except OSError as error:
            raise UsageError(f"{path}: no hapsim answers there ({error.strerror or error})") from error
    return received.decode("utf-8", "replace")


def _folders() -> list[Path]:
    """Returns the directories of a service, of a login and of the system; a new socket goes into the first."""
    given = [Path(folder) for folder in os.environ.get("RUNTIME_DIRECTORY", "").split(":") if folder]
    login = os.environ.get("XDG_RUNTIME_DIR")
    own = Path(login) / "hapsim" if login else Path(tempfile.gettempdir()) / f"hapsim-{os.geteuid()}"
    return [*given, own, Path("/run/hapsim")]


def _name(port: str | None) -> str:
    return re.sub(r"[^\w.-]", "_", Path(port).name) if port else "mock"


def _listen(path: Path) -> socket.socket:
    _make_room(path)
    listening, before = _unix_socket(), os.umask(0o177)
    try:
        listening.bind(str(path))
        listening.listen(8)
    except OSError as error:
        listening.close()
        raise UsageError(f"--status {path}: no socket can be made there: {error.strerror or error}") from error
    finally:
        os.umask(before)
    listening.setblocking(False)
    return listening


def _make_room(path: Path) -> None:
    """Removes the socket of a killed run, and nothing else."""
    try:
        status = path.lstat()
    except OSError:  # nothing to remove; `bind` reports an invalid path
        return
    if not stat.S_ISSOCK(status.st_mode):
        raise UsageError(f"--status {path}: there is a file that is no socket; it was not touched")
    if is_served(path):
        raise UsageError(f"--status {path}: another hapsim reports its status there; name another path")
    path.unlink()


def _require_unix_sockets() -> None:
    if not hasattr(socket, "AF_UNIX"):
        raise UsageError("--status and `hapsim status` take unix sockets, which this system does not have")


def _unix_socket() -> socket.socket:
    _require_unix_sockets()
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    made.settimeout(_TIMEOUT_S)
    return made


def _serve(listening: socket.socket, asked_to_stop: socket.socket, document: Callable[[], str]) -> None:
    while asked_to_stop not in select.select([listening, asked_to_stop], [], [])[0]:
        with contextlib.suppress(OSError):  # the client is gone again, or does not read
            connection, _ = listening.accept()
            with connection:
                connection.setblocking(False)
                connection.send(_made(document))
        time.sleep(_PAUSE_S)


def _made(document: Callable[[], str]) -> bytes:
    try:
        return document().encode("utf-8", "replace")
    except Exception as error:  # the next request may succeed
        return f'{{"error": "the status cannot be reported: {type(error).__name__}"}}'.encode()


class RunState:
    """The state of a run, updated by its `observer`."""

    def __init__(self, scene: str, port: str | None, nominal_rate_hz: float, motion: tuple[Motion, ...] = ()) -> None:
        """`scene`: path of its file. `port`: None for the mock. `motion`: of each channel."""
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
        """Observer that updates the state."""
        return RunObserver(started=self._started, over=self._over, waiting=self._waiting, report=self._report)

    def document(self) -> dict[str, Any]:
        """Returns the state by the names of `--json`, for the running or the last session. Force, position and age are
        None while nothing runs: the hand does not feel the last ones now."""
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
            **progress.status(),
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
            self._released = None  # a try since then may have armed the device without a report
        self._armed_since, self._phase = None, "ended"

    def _waiting(self) -> None:
        self._phase = "waiting"

    def _report(self, event: str, sentence: str) -> None:
        self._news = sentence
        if event == "lost":
            self._lost = sentence  # later events are about the port
