"""How users get what is limited for them: the limits that are set at login."""

from __future__ import annotations

import os


def is_root() -> bool:
    """Whether more rights are not to be had by becoming root. Decides what is advised, never what is tried."""
    return os.geteuid() == 0


def login_limit(item: str, value: str) -> str:
    """What raises this user's limit on `item`, as in limits.conf(5), to be said after "it takes"."""
    return f"the line '{_user()} - {item} {value}' in /etc/security/limits.d/hapsim.conf and a new login"


def _user() -> str:
    import pwd

    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # a user of a container need not be in its list
        return "*"
