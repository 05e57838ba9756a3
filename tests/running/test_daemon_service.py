"""A daemon under a service manager: what it tells it, and the unit that starts it."""

from __future__ import annotations

import grp
import os
import pwd
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hapsim.errors import UsageError
from hapsim.loop.counts import Progress
from hapsim.running.service import Notifier, service_access_problem, unit_for
from tests.port_scenes import TWO

SCENE = """
version: 1
rate: 1000
device: {mass: 0.2, clock: lockstep, friction: 1.0, port: /dev/ttyACM0}
modules:
  hand:  {type: device, channel: 0}
"""


class Manager:
    """A service manager, as far as a service hears of it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.setblocking(False)

    def notifications(self) -> list[str]:
        """Every datagram since the last look."""
        found = []
        while True:
            try:
                found.append(self._socket.recv(1 << 16).decode())
            except BlockingIOError:
                return found

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def manager() -> Iterator[Manager]:
    with tempfile.TemporaryDirectory() as short:  # for the name of a socket
        made = Manager(Path(short) / "notify")
        yield made
        made.close()


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "my scene.yaml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def notifier(manager: Manager, now: list[float], reconnects: bool = False, **environ: str) -> Notifier:
    environ = {"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": "3000000"} | environ
    return Notifier(reconnects, environ, clock=lambda: now[0])


def test_the_watchdog_is_notified_only_while_the_ticks_go_on(manager: Manager) -> None:
    now = [0.0]
    observer = notifier(manager, now).observer
    observer.started(SimpleNamespace(scene=SimpleNamespace(path="touch.yaml")))  # type: ignore[arg-type]
    assert manager.notifications() == ["READY=1\nSTATUS=touch.yaml runs"]
    notified = []
    for now[0], ticks in ((0.0, 0), (1.0, 500), (1.5, 900), (2.0, 900), (4.0, 900), (6.0, 900), (6.1, 901)):
        observer.running(Progress("running", ticks=ticks))
        notified.append("WATCHDOG=1" in manager.notifications())
    assert notified == [False, True, False, True, False, False, True]
    now[0] = 9.0
    observer.waiting()
    assert manager.notifications() == ["WATCHDOG=1"]
    observer.report("lost", "the device\nwent away")
    assert manager.notifications() == ["STATUS=the device went away"]
    observer.over()
    assert manager.notifications() == ["STOPPING=1"]


@pytest.mark.parametrize(
    ("environ", "is_notified"),
    [
        ({}, True),
        ({"WATCHDOG_PID": str(os.getpid())}, True),
        ({"WATCHDOG_PID": "1"}, False),
        ({"WATCHDOG_USEC": "0"}, False),
        ({"WATCHDOG_USEC": "soon"}, False),
        ({"WATCHDOG_USEC": "1" + 400 * "0"}, False),
    ],
)
def test_the_watchdog_is_notified_if_it_asks_for_it(
    manager: Manager, environ: dict[str, str], is_notified: bool
) -> None:
    observer = notifier(manager, [0.0], **environ).observer
    observer.running(Progress("running", ticks=5))
    assert ("WATCHDOG=1" in manager.notifications()) == is_notified


def test_a_run_that_may_reconnect_is_not_over_with_a_session(manager: Manager) -> None:
    notifying = notifier(manager, [0.0], reconnects=True)
    notifying.observer.over()
    assert manager.notifications() == []
    notifying.stopping()
    assert manager.notifications() == ["STOPPING=1"]
    notifying.stopping(RuntimeError("the force swung\n at its limit"))
    assert manager.notifications() == ["STOPPING=1\nSTATUS=the force swung at its limit"]


def test_a_manager_that_is_gone_ends_nothing(manager: Manager, tmp_path: Path) -> None:
    manager.close()
    for where in (str(manager.path), str(tmp_path / "nowhere"), "@hapsim/nobody", ""):
        notifying = Notifier(False, {"NOTIFY_SOCKET": where})
        notifying.observer.report("lost", "gone")
        notifying.stopping()


def test_the_command_notifies_of_arming_and_end(
    manager: Manager, hapsim: Callable[..., Any], scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(manager.path))
    monkeypatch.setenv("WATCHDOG_USEC", "1000")
    assert hapsim("run", scene, "--mock", "--duration", 0.05, "--json").status == 0
    notifications = [
        line for datagram in manager.notifications() for line in datagram.split("\n") if "compiling" not in line
    ]
    assert (notifications[0], notifications[1], notifications[-1]) == ("READY=1", f"STATUS={scene} runs", "STOPPING=1")
    assert "WATCHDOG=1" in notifications
    assert hapsim("run", scene, "--port", "/dev/ttyNOPE7").status == 3
    notifications = manager.notifications()
    assert "READY=1" not in notifications
    assert notifications[-1].startswith("STOPPING=1\nSTATUS=/dev/ttyNOPE7: ")
    assert hapsim("run", scene.with_name("none.yaml"), "--mock").status == 2
    assert "none.yaml: no such file" in manager.notifications()[-1]


def test_a_defect_is_reported_and_a_name_is_no_command(manager: Manager) -> None:
    notifying = notifier(manager, [0.0])
    with pytest.raises(ZeroDivisionError), notifying.notify_failures():
        _ = 1 // 0
    (notifications,) = manager.notifications()
    assert notifications.startswith("STOPPING=1\nSTATUS=a defect of hapsim: ZeroDivisionError(")
    notifying.observer.started(SimpleNamespace(scene=SimpleNamespace(path="a\nSTOPPING=1\nb")))  # type: ignore[arg-type]
    assert manager.notifications() == ["READY=1\nSTATUS=a STOPPING=1 b runs"]


def settings(unit: str) -> dict[str, list[str]]:
    lines = [line.split("=", 1) for line in unit.splitlines() if "=" in line and not line.startswith("#")]
    return {name: [value for other, value in lines if other == name] for name, _ in lines}


def test_the_unit_has_no_more_rights_than_it_needs(hapsim: Callable[..., Any], scene: Path, tmp_path: Path) -> None:
    document = hapsim("service", scene, "--json").document
    found = settings(document["unit"])
    words = shlex.split(found["ExecStart"][0])
    assert words[:5] == [sys.executable, "-m", "hapsim", "run", str(scene)]
    assert words[5:8] == ["--port", "/dev/ttyACM0", "--reconnect"]
    assert "--unstable" not in words
    assert found["RestartPreventExitStatus"] == ["1 2 4 200 203 216 217"]
    assert found["DeviceAllow"] == ["char-ttyACM rw", "/dev/cpu_dma_latency rw"]
    assert found["PrivateNetwork"] == found["NoNewPrivileges"] == ["yes"]
    assert found["RuntimeDirectory"] == found["StateDirectory"] == found["CacheDirectory"] == ["hapsim/ttyACM0"]
    assert "XDG_STATE_HOME=%S/hapsim/ttyACM0" in found["Environment"]  # else no report of a fault can be written
    of_user = settings(hapsim("service", scene, "--user", "--json").document["unit"])
    assert of_user["WantedBy"] == ["default.target"]
    assert not of_user.keys() & {"SupplementaryGroups", "ProtectSystem", "User"}
    if shutil.which("systemd-analyze"):
        file = tmp_path / document["name"]
        file.write_text(document["unit"], encoding="utf-8")
        verified = subprocess.run(["systemd-analyze", "verify", file], capture_output=True, text=True, check=False)
        assert (verified.returncode, verified.stderr) == (0, "")


def test_what_a_unit_reads_otherwise_is_escaped_and_what_it_cannot_hold_is_refused() -> None:
    found = settings(unit_for('/a "b" 5%/$c.yaml', "/dev/serial/by-id/usb-1"))
    assert '"/a \\"b\\" 5%%/$$c.yaml"' in found["ExecStart"][0]
    assert found["DeviceAllow"][:2] == ["char-ttyACM rw", "char-ttyUSB rw"]
    with pytest.raises(UsageError, match="no unit can hold"):
        unit_for("/a\nExecStart=/bin/sh", "/dev/ttyACM0")


def test_the_service_of_one_of_several_devices_runs_that_one(hapsim: Callable[..., Any], scene: Path) -> None:
    scene.write_text(TWO, encoding="utf-8")
    one = "--device", "right", "--port", "/dev/ttyACM1"
    words = shlex.split(settings(hapsim("service", scene, "--json", *one).document["unit"])["ExecStart"][0])
    assert words[words.index("--device") + 1] == "right"
    assert words[words.index("--port") + 1] == "/dev/ttyACM1"
    assert "--watch: found --device right too" in hapsim("service", scene, "--watch", *one).sentence
    assert "name one, such as --device left" in hapsim("service", scene).sentence


def test_a_scene_without_a_port_has_no_service(hapsim: Callable[..., Any], scene: Path) -> None:
    scene.write_text(SCENE.replace(", port: /dev/ttyACM0", ""), encoding="utf-8")
    assert "found no port" in hapsim("service", scene).sentence


def test_a_scene_that_will_be_refused_has_its_unit_and_a_warning(hapsim: Callable[..., Any], scene: Path) -> None:
    assert "will refuse" not in hapsim("service", scene).err
    wall = (
        "  wall:  {type: ground}\n  touch: {type: viscoelastic, between: [hand, wall], stiffness: 50000, damping: 2}\n"
    )
    scene.write_text(SCENE + wall, encoding="utf-8")
    answer = hapsim("service", scene)
    assert (answer.status, "ExecStart=" in answer.out) == (0, True)
    assert "`hapsim run` will refuse this scene" in answer.err


def test_the_service_has_the_user_s_account(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nobody = pwd.getpwnam("nobody")
    monkeypatch.setattr(os, "geteuid", lambda: nobody.pw_uid)
    found = settings(unit_for(str(scene), "/dev/ttyACM0"))
    assert (found["User"], found["Group"]) == (["nobody"], [grp.getgrgid(nobody.pw_gid).gr_name])
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.delenv("SUDO_USER", raising=False)
    assert "User" not in settings(unit_for(str(scene), "/dev/ttyACM0"))
    closed = {str(tmp_path): 0o40750}
    stat_of = Path.stat
    monkeypatch.setattr(Path, "stat", lambda path, **how: _as_nobodys(stat_of(path, **how), closed.get(str(path))))
    assert f"the scene, {scene}, is below {tmp_path}, which a service of root may not enter" in service_access_problem(
        str(scene)
    )
    closed[str(tmp_path)] = 0o40751
    assert "the scene" not in service_access_problem(str(scene))


def _as_nobodys(found: os.stat_result, mode: int | None) -> os.stat_result:
    return found if mode is None else os.stat_result([mode, *found[1:4], 65534, 65534, *found[6:]])


def test_with_sound_the_unit_may_open_a_sound_card() -> None:
    silent, sounding = (settings(unit_for("/a.yaml", "/dev/ttyACM0", sound=sound)) for sound in (False, True))
    assert "char-alsa rw" in sounding["DeviceAllow"]
    assert "char-alsa rw" not in silent["DeviceAllow"]
    assert sounding["ExecStart"][0].endswith(" --sound")
    assert "audio" in sounding["SupplementaryGroups"][0]
    assert "audio" not in str(silent)


def test_a_unit_that_serves_may_reach_the_network_and_write_records(
    hapsim: Callable[..., Any], scene: Path, tmp_path: Path
) -> None:
    options = (
        "--serve",
        "--osc",
        "--serve-at",
        "127.0.0.1:7000",
        "--osc-from",
        "127.0.0.1",
        "--record-dir",
        str(tmp_path),
    )
    found = settings(hapsim("service", scene, *options, "--json").document["unit"])
    assert tuple(shlex.split(found["ExecStart"][0])[-len(options) :]) == options
    assert found["PrivateNetwork"] == ["no"]
    assert "AF_INET6" in found["RestrictAddressFamilies"][0]
    assert found["ReadWritePaths"] == [str(tmp_path)]
    assert "--osc-from is missing" in hapsim("service", scene, "--osc-at", "0.0.0.0").sentence


def test_a_unit_of_a_device_behind_a_network_may_reach_it(hapsim: Callable[..., Any], scene: Path) -> None:
    port = "tcp://192.168.7.2:7472"
    found = settings(hapsim("service", scene, "--port", port, "--json").document["unit"])
    assert port in found["ExecStart"][0]
    assert found["PrivateNetwork"] == ["no"]
    assert "AF_INET6" in found["RestrictAddressFamilies"][0]
