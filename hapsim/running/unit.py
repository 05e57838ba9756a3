"""A systemd unit for a scene: the daemon with the rights that it needs, and no others."""

from __future__ import annotations

import os
import re
import stat
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from hapsim.errors import UsageError

_WATCHDOG_S = 10
_SERIAL_GROUP = "dialout"  # of serial ports, where a system has it
_SERIAL_DRIVERS = ("ttyACM", "ttyUSB")

_OF_THE_SYSTEM = """\
{groups}RuntimeDirectory=hapsim/{name}
RuntimeDirectoryMode=0700
CacheDirectory=hapsim/{name}
Environment=XDG_CACHE_HOME=%C/hapsim/{name}
StateDirectory=hapsim/{name}
Environment=XDG_STATE_HOME=%S/hapsim/{name}
ProtectSystem=strict
ProtectHome=read-only
PrivateTmp={private_tmp}
PrivateNetwork=yes
ProtectControlGroups=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectHostname=yes
CapabilityBoundingSet=CAP_SYS_NICE CAP_IPC_LOCK
DevicePolicy=closed
# By driver, because a device that is plugged in again may get another number.
{devices}
DeviceAllow=/dev/cpu_dma_latency rw
"""

_UNIT = """\
[Unit]
Description={description}
# A device that is not there (3) is tried again for as long as it takes.
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
{user}ExecStart={command}
# The first start compiles.
TimeoutStartSec=600
TimeoutStopSec=10
WatchdogSec={watchdog_s}
Restart=on-failure
RestartSec=2
# 1: a defect of hapsim, or no hapsim; 2: a wrong scene; 4: a guard stopped the force; the service manager's own, of
# what it could not start: 200 directory, 203 interpreter, 216 group, 217 user. None gets better by itself.
RestartPreventExitStatus=1 2 4 200 203 216 217
# 130: told to stop before the device was armed.
SuccessExitStatus=130
LimitRTPRIO=80
LimitMEMLOCK=infinity
NoNewPrivileges=yes
RestrictAddressFamilies=AF_UNIX
RestrictNamespaces=yes
RestrictSUIDSGID=yes
LockPersonality=yes
UMask=0077
{system}{environment}
[Install]
WantedBy={target}
"""


def unit_name(port: str) -> str:
    """What the unit of this port's daemon is called."""
    return f"hapsim-{_plain(port)}.service"


def unit_for(scene: str, port: str, *, of_user: bool = False, watch: bool = False) -> str:
    """The text of a unit that runs the scene of this file on `port`, with this interpreter. `of_user`: for a user's own
    service manager, which grants less. UsageError for a path that no unit can hold."""
    file = os.path.abspath(scene)
    words = [sys.executable, "-m", "hapsim", "run", file, "--port", port, "--reconnect", "--realtime"]
    words += ["--log", "json", "--status", "auto", *(["--watch"] if watch else [])]
    name = _plain(port)
    system = (
        ""
        if of_user
        else _OF_THE_SYSTEM.format(
            name=name,
            groups=f"SupplementaryGroups={_SERIAL_GROUP}\n" if _has_group(_SERIAL_GROUP) else "",
            devices=_devices(port),
            private_tmp="no" if _is_in_tmp(file, sys.executable, port) else "yes",
        )
    )
    path = os.environ.get("PYTHONPATH")
    account = None if of_user else _account()
    user = "" if account is None else f"User={account.name}\n{_group_setting(account.group)}"
    return _UNIT.format(
        description=_escaped(f"hapsim: {Path(file).name} on {port}"),
        user=user,
        command=" ".join(map(_quoted, words)),
        watchdog_s=_WATCHDOG_S,
        system=system,
        environment=f"Environment={_quoted(f'PYTHONPATH={path}', command=False)}\n" if path else "",
        target="default.target" if of_user else "multi-user.target",
    )


def closed_to_service(scene: str) -> str:
    """Why the system's service could not read this scene, this interpreter or hapsim, in a sentence; "" where it can.
    It may not pass over permissions, whoever it runs as."""
    account = _account()
    user, groups = (0, [0]) if account is None else (account.number, _groups_of(account))
    for what, file in (("the scene", scene), ("the interpreter", sys.executable), ("hapsim", __file__)):
        folder = _closed_folder(file, user, groups)
        if folder is None:
            continue
        name = "root" if account is None else account.name
        return (
            f"{what}, {os.path.abspath(file)}, is below {folder}, which a service of {name} may not enter (it has no "
            "right to pass over permissions): print the unit as the user whose directory that is, or move it to where "
            "everyone may read, such as /opt or /srv"
        )
    return ""


def _closed_folder(file: str, user: int, groups: Sequence[int]) -> Path | None:
    """The first directory on the way to `file`, or to what it leads to, that this user may not enter."""
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


class _Account(NamedTuple):
    """Whose service it is."""

    name: str
    number: int
    group: int | None


def _account() -> _Account | None:
    """The user's who asks, also by sudo; None for root's."""
    import pwd

    number = os.geteuid()
    try:
        entry = pwd.getpwnam(os.environ.get("SUDO_USER", "root")) if number == 0 else pwd.getpwuid(number)
    except (KeyError, ValueError):
        return None if number == 0 else _Account(str(number), number, None)
    return None if entry.pw_uid == 0 else _Account(entry.pw_name, entry.pw_uid, entry.pw_gid)


def _groups_of(account: _Account) -> list[int]:
    return [] if account.group is None else os.getgrouplist(account.name, account.group)


def _group_setting(group: int | None) -> str:
    import grp

    if group is None:
        return ""
    try:
        return f"Group={grp.getgrgid(group).gr_name}\n"
    except KeyError:
        return f"Group={group}\n"


def _has_group(name: str) -> bool:
    import grp

    try:
        grp.getgrnam(name)
    except KeyError:
        return False
    return True


def _devices(port: str) -> str:
    found = re.match(r"tty[A-Za-z]+", os.path.basename(os.path.realpath(port)))
    drivers = (found[0],) if found else ("pts",) if os.path.realpath(port).startswith("/dev/pts/") else _SERIAL_DRIVERS
    return "\n".join(f"DeviceAllow=char-{driver} rw" for driver in drivers)


def _is_in_tmp(*paths: str) -> bool:
    return any(path.startswith(("/tmp/", "/var/tmp/")) for path in paths)


def _plain(port: str) -> str:
    return re.sub(r"[^\w.-]", "_", os.path.basename(port), flags=re.ASCII) or "mock"


def _quoted(word: str, command: bool = True) -> str:
    """As systemd.syntax(7) and, of a command, systemd.service(5) want it."""
    escaped = _escaped(word).replace("\\", "\\\\").replace('"', '\\"')
    escaped = escaped.replace("$", "$$") if command else escaped
    return escaped if re.fullmatch(r"[\w./=:,%@+-]+", escaped) else f'"{escaped}"'


def _escaped(word: str) -> str:
    if not word.isprintable():
        raise UsageError(f"found {word!r}, which has a character that no unit can hold: rename it")
    return word.replace("%", "%%")
