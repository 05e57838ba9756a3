"""A systemd unit for a scene: the daemon with the rights that it needs, and no others."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from hapsim.errors import UsageError

_WATCHDOG_S = 10
_SERIAL_DRIVERS = ("ttyACM", "ttyUSB")

_OF_THE_SYSTEM = """\
SupplementaryGroups=dialout
RuntimeDirectory=hapsim/{name}
RuntimeDirectoryMode=0700
CacheDirectory=hapsim/{name}
Environment=XDG_CACHE_HOME=%C/hapsim/{name}
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
# A device that is not there yet is tried again for as long as it takes.
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
# 2: a wrong scene; 4: a guard stopped the force. Neither gets better by itself.
RestartPreventExitStatus=2 4
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
            name=name, devices=_devices(port), private_tmp="no" if _is_in_tmp(file, sys.executable, port) else "yes"
        )
    )
    path = os.environ.get("PYTHONPATH")
    user = "" if of_user else _user()
    return _UNIT.format(
        description=_escaped(f"hapsim: {Path(file).name} on {port}"),
        user=f"User={user}\n" if user else "",
        command=" ".join(map(_quoted, words)),
        watchdog_s=_WATCHDOG_S,
        system=system,
        environment=f"Environment={_quoted(f'PYTHONPATH={path}', command=False)}\n" if path else "",
        target="default.target" if of_user else "multi-user.target",
    )


def _user() -> str:
    """Whose service it is: the user's who asks, also by sudo; "" for root's."""
    import pwd

    if os.geteuid() == 0:
        return os.environ.get("SUDO_USER", "").replace("root", "")
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


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
