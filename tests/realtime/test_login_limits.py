"""What the advice asks a user to write into the limits that are set at login."""

from __future__ import annotations

import pwd

import pytest

from hapsim.loop.realtime.privilege import login_limit


def test_the_line_names_the_user_who_reads_it(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = pwd.struct_passwd(("ada", "x", 1000, 1000, "", "/home/ada", "/bin/sh"))
    monkeypatch.setattr(pwd, "getpwuid", lambda _: entry)
    assert "'ada - rtprio 80' in /etc/security/limits.d/" in login_limit("rtprio", "80")


def test_a_user_without_a_name_is_advised_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(_number: int) -> pwd.struct_passwd:
        raise KeyError("getpwuid(): uid not found")

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    assert "'* - rtprio 80'" in login_limit("rtprio", "80")
