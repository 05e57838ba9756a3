"""A scene as a service of systemd: its unit, and a run's notifications to the service manager.

The unit runs `hapsim run` with the rights that it needs and no others; `hapsim.service` in this directory is the
template. The notifier sends datagrams to $NOTIFY_SOCKET, as sd_notify(3): ready, running, stopping. It sends WATCHDOG=1
only if the loop has ticked since the last one, or while the run waits for a device. systemd kills and restarts a loop
that hangs; the device has released its force by then.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import stat
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from string import Template

from hapsim.errors import HapsimError, UsageError
from hapsim.loop.counts import Progress
from hapsim.running.reconnecting import RunObserver
from hapsim.running.session import Session
from hapsim.scene.addresses import is_address

_TEMPLATE = Path(__file__).with_name("hapsim.service")
_OF_SYSTEM = re.compile(r"# Only the system's service manager.*?\n\n", re.DOTALL)
_SERIAL_GROUP, _SOUND_GROUP = "dialout", "audio"  # of serial ports and sound cards, where a system has them
_SERIAL_DRIVERS = ("ttyACM", "ttyUSB")
_TEMPORARY = ("/tmp/", "/var/tmp/")
_SHARE = 1 / 3  # of the watchdog's time, between two notifications
_STATUS_S = 1.0  # between two lines of STATUS


def unit_name(port: str) -> str:
    """Returns the name of the unit that runs a scene on this port."""
    return f"hapsim-{_plain(port)}.service"


def unit_for(
    scene: str,
    port: str,
    *,
    of_user: bool = False,
    watch: bool = False,
    sound: bool = False,
    live: Sequence[str] = (),
    record_dir: Path | None = None,
    device: str | None = None,
) -> str:
    """Returns the text of a unit that runs this scene file on `port` with this interpreter. `of_user`: for a user's own
    service manager, which grants less. `sound`: with its sound. `live`: options that serve it over a network.
    `record_dir`: a writable directory. `device`: name of the scene's device, of several. Raises UsageError for a path
    that no unit can hold."""
    import grp

    file = os.path.abspath(scene)
    words = [sys.executable, "-m", "hapsim", "run", file, "--port", port, "--reconnect", "--realtime"]
    words += [] if device is None else ["--device", device]
    words += ["--log", "json", "--status", "auto", *["--watch"] * watch, *["--sound"] * sound, *live]
    groups = {group.gr_name for group in grp.getgrall()} & {_SERIAL_GROUP, *[_SOUND_GROUP] * sound}
    has_network = bool(live) or is_address(port)
    is_temporary = any(path.startswith(_TEMPORARY) for path in (file, sys.executable, port))
    path = os.environ.get("PYTHONPATH")
    template = _TEMPLATE.read_text(encoding="utf-8")
    return Template(_OF_SYSTEM.sub("", template) if of_user else template).substitute(
        description=_escaped(f"hapsim: {Path(file).name} on {port}"),
        account="" if of_user else _account_settings(),
        command=" ".join(map(_quoted, words)),
        groups=f"SupplementaryGroups={' '.join(sorted(groups, reverse=True))}\n" if groups else "",
        name=_plain(port),
        sockets="AF_UNIX AF_INET AF_INET6 AF_NETLINK" if has_network else "AF_UNIX",
        private_network="no" if has_network else "yes",
        writable=f"ReadWritePaths={_quoted(os.path.abspath(record_dir), command=False)}\n" if record_dir else "",
        private_tmp="no" if is_temporary else "yes",
        devices="\n".join(f"DeviceAllow=char-{driver} rw" for driver in (*_drivers(port), *["alsa"] * sound)),
        environment=f"Environment={_quoted(f'PYTHONPATH={path}', command=False)}\n" if path else "",
        target="default.target" if of_user else "multi-user.target",
    )


def service_access_problem(scene: str) -> str:
    """Returns why the system's service cannot read the scene, the interpreter or hapsim; "" if it can."""
    user, number, group = _account()
    groups = [0] if number == 0 else os.getgrouplist(user, group)
    for what, file in (("the scene", scene), ("the interpreter", sys.executable), ("hapsim", __file__)):
        folder = _closed_folder(file, number, groups)
        if folder is not None:
            return (
                f"{what}, {os.path.abspath(file)}, is below {folder}, which a service of {user} may not enter "
                "(it has no right to pass over permissions): print the unit as the user whose directory that is, or "
                "move it to where everyone may read, such as /opt or /srv"
            )
    return ""


def _closed_folder(file: str, user: int, groups: list[int]) -> Path | None:
    """Returns the first directory above `file` or its link's target that this user may not enter, if any."""
    ways = [Path(os.path.abspath(file)), Path(os.path.realpath(file))]
    for folder in (folder for way in ways for folder in reversed(way.parents)):
        try:
            status = folder.stat()
        except OSError:
            return folder
        bit = stat.S_IXUSR if status.st_uid == user else stat.S_IXGRP if status.st_gid in groups else stat.S_IXOTH
        if not status.st_mode & bit:
            return folder
    return None


def _account() -> tuple[str, int, int]:
    """Returns the user of the service, behind sudo or not: name, user number, group number."""
    import pwd

    number = os.geteuid()
    try:
        entry = pwd.getpwnam(os.environ.get("SUDO_USER", "root")) if number == 0 else pwd.getpwuid(number)
    except KeyError:  # a container need not list its user
        return "root" if number == 0 else str(number), number, os.getegid()
    return entry.pw_name, entry.pw_uid, entry.pw_gid


def _account_settings() -> str:
    """Returns the lines with user and group; "" for root."""
    import grp

    user, number, group_number = _account()
    if number == 0:
        return ""
    try:
        group = grp.getgrgid(group_number).gr_name
    except KeyError:
        group = str(group_number)
    return f"User={user}\nGroup={group}\n"


def _drivers(port: str) -> tuple[str, ...]:
    """Returns the drivers of the devices that the service may open."""
    path = os.path.realpath(port)
    if path.startswith("/dev/pts/"):
        return ("pts",)
    found = re.match(r"tty[A-Za-z]+", os.path.basename(path))
    return (found[0],) if found else _SERIAL_DRIVERS


def _plain(port: str) -> str:
    return re.sub(r"[^\w.-]", "_", os.path.basename(port), flags=re.ASCII) or "mock"


def _quoted(word: str, command: bool = True) -> str:
    """Returns a word quoted for systemd.syntax(7) and, in a `command`, systemd.service(5)."""
    escaped = _escaped(word).replace("\\", "\\\\").replace('"', '\\"')
    escaped = escaped.replace("$", "$$") if command else escaped
    return escaped if re.fullmatch(r"[\w./=:,%@+-]+", escaped) else f'"{escaped}"'


def _escaped(word: str) -> str:
    if not word.isprintable():
        raise UsageError(f"found {word!r}, which has a character that no unit can hold: rename it")
    return word.replace("%", "%%")


class Notifier:
    """Notifies the service manager, if there is one. No failure here ends a run."""

    def __init__(
        self, reconnects: bool, environ: Mapping[str, str] = os.environ, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """`reconnects`: the run continues after the end of a session. `clock`: returns s."""
        address = environ.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._watchdog_s = _watchdog_s(environ)
        self._reconnects, self._clock = reconnects, clock
        self._ticks = 0
        self._alive_at = self._status_at = -1e9

    @property
    def observer(self) -> RunObserver:
        """Observer that notifies the service manager of a run's events."""
        if not self._address:
            return RunObserver()
        return RunObserver(
            started=self._started, running=self._running, over=self._over, waiting=self._waiting, report=self._report
        )

    def stopping(self, why: object = "") -> None:
        """Notifies that the run is over. `why`: a sentence about a failure."""
        self._send("STOPPING=1", *([f"STATUS={_one_line(why)}"] if why else []))

    @contextlib.contextmanager
    def notify_failures(self) -> Iterator[None]:
        """Notifies of every failure while open, also before arming."""
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

    def _report(self, _event: str, sentence: str) -> None:
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
    """Returns the time in s within which systemd expects a notification of this process; None if it expects none."""
    try:
        process, time_us = int(environ.get("WATCHDOG_PID") or os.getpid()), float(environ.get("WATCHDOG_USEC") or 0)
    except ValueError:
        return None
    return 1e-6 * time_us if 0 < time_us < float("inf") and process == os.getpid() else None
