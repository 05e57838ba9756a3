"""A systemd unit for a scene: `hapsim run` as a service, with the rights that it needs and no others.

`hapsim.service` beside this file is the template.
"""

from __future__ import annotations

import os
import re
import stat
import sys
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import NamedTuple

from hapsim.errors import UsageError

_TEMPLATE = Path(__file__).with_name("hapsim.service")
_OF_SYSTEM = re.compile(r"# Only the system's service manager.*?\n\n", re.DOTALL)
_SERIAL_GROUP, _SOUND_GROUP = "dialout", "audio"  # of serial ports and sound cards, where a system has them
_SERIAL_DRIVERS = ("ttyACM", "ttyUSB")
_TEMPORARY = ("/tmp/", "/var/tmp/")


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
) -> str:
    """Returns the text of a unit that runs this scene file on `port`, with this interpreter. `of_user`: for a user's
    own service manager, which grants less; `sound`: with its sound; `live`: options that serve it over a network;
    `record_dir`: where it may write. Raises UsageError for a path that no unit can hold."""
    import grp

    file = os.path.abspath(scene)
    words = [sys.executable, "-m", "hapsim", "run", file, "--port", port, "--reconnect", "--realtime"]
    words += ["--log", "json", "--status", "auto", *["--watch"] * watch, *["--sound"] * sound, *live]
    groups = {group.gr_name for group in grp.getgrall()} & {_SERIAL_GROUP, *[_SOUND_GROUP] * sound}
    is_temporary = any(path.startswith(_TEMPORARY) for path in (file, sys.executable, port))
    path = os.environ.get("PYTHONPATH")
    template = _TEMPLATE.read_text(encoding="utf-8")
    return Template(_OF_SYSTEM.sub("", template) if of_user else template).substitute(
        description=_escaped(f"hapsim: {Path(file).name} on {port}"),
        account="" if of_user else _account_settings(),
        command=" ".join(map(_quoted, words)),
        groups=f"SupplementaryGroups={' '.join(sorted(groups, reverse=True))}\n" if groups else "",
        name=_plain(port),
        sockets="AF_UNIX AF_INET AF_INET6 AF_NETLINK" if live else "AF_UNIX",
        private_network="no" if live else "yes",
        writable=f"ReadWritePaths={_quoted(os.path.abspath(record_dir), command=False)}\n" if record_dir else "",
        private_tmp="no" if is_temporary else "yes",
        devices="\n".join(f"DeviceAllow=char-{driver} rw" for driver in (*_drivers(port), *["alsa"] * sound)),
        environment=f"Environment={_quoted(f'PYTHONPATH={path}', command=False)}\n" if path else "",
        target="default.target" if of_user else "multi-user.target",
    )


def closed_to_service(scene: str) -> str:
    """Returns why the system's service could not read the scene, the interpreter or hapsim; "" where it can."""
    account = _account()
    groups = [0] if account.number == 0 else os.getgrouplist(account.name, account.group)
    for what, file in (("the scene", scene), ("the interpreter", sys.executable), ("hapsim", __file__)):
        folder = _closed_folder(file, account.number, groups)
        if folder is not None:
            return (
                f"{what}, {os.path.abspath(file)}, is below {folder}, which a service of {account.name} may not enter "
                "(it has no right to pass over permissions): print the unit as the user whose directory that is, or "
                "move it to where everyone may read, such as /opt or /srv"
            )
    return ""


def _closed_folder(file: str, user: int, groups: list[int]) -> Path | None:
    """Returns the first directory above `file`, or above what it links to, that this user may not enter."""
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
    """The user whom the service runs as."""

    name: str
    number: int
    group: int


def _account() -> _Account:
    """Returns the account of the user who asks, through sudo or not."""
    import pwd

    number = os.geteuid()
    try:
        entry = pwd.getpwnam(os.environ.get("SUDO_USER", "root")) if number == 0 else pwd.getpwuid(number)
    except KeyError:  # a container's user need not be in the list
        return _Account("root" if number == 0 else str(number), number, os.getegid())
    return _Account(entry.pw_name, entry.pw_uid, entry.pw_gid)


def _account_settings() -> str:
    """Returns the lines with user and group; "" for root."""
    import grp

    account = _account()
    if account.number == 0:
        return ""
    try:
        group = grp.getgrgid(account.group).gr_name
    except KeyError:
        group = str(account.group)
    return f"User={account.name}\nGroup={group}\n"


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
    """Quotes a word as systemd.syntax(7) and, for a `command`, systemd.service(5) say."""
    escaped = _escaped(word).replace("\\", "\\\\").replace('"', '\\"')
    escaped = escaped.replace("$", "$$") if command else escaped
    return escaped if re.fullmatch(r"[\w./=:,%@+-]+", escaped) else f'"{escaped}"'


def _escaped(word: str) -> str:
    if not word.isprintable():
        raise UsageError(f"found {word!r}, which has a character that no unit can hold: rename it")
    return word.replace("%", "%%")
