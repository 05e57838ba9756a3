"""Which devices were pushed or run before."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from hapsim.device.known_devices import is_new


@pytest.fixture
def port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(list_ports, "comports", list)
    (tmp_path / "ttyA").touch()
    return str(tmp_path / "ttyA")


def test_a_device_is_new_once(port: str) -> None:
    assert [is_new(port), is_new(port)] == [True, False]
    assert not is_new(f"{port}_that_is_not_there")


def test_a_device_is_known_by_its_serial_number_at_any_port(port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, number, new in (("ttyA", "1", True), ("ttyB", "1", False), ("ttyB", "2", True)):
        there = Path(port).with_name(name)
        there.touch()
        numbered = [SimpleNamespace(device=str(there), serial_number=number)]
        monkeypatch.setattr(list_ports, "comports", lambda numbered=numbered: numbered)
        assert is_new(str(there)) == new


def test_where_nothing_can_be_kept_nothing_is_said(port: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    assert not is_new(port)
