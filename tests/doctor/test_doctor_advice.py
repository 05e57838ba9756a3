"""Each piece of advice is given where it applies, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hapsim.doctor.advice import Advice, Load, Machine, Situation, advice_on
from hapsim.loop.realtime import PrivilegeResult
from hapsim.system_files import SystemFiles

Case = Callable[..., Situation]
SOUND = Machine("P", 4, 4, "6.12", True, ("performance",), "tsc", "", False, "")
FTDI = "/sys/bus/usb-serial/devices/ttyUSB0/latency_timer"
SWAP = "MemTotal: 8000000 kB\nSwapTotal: 4000000 kB\nSwapFree: {0} kB\n"
DENIED, LOCKED = PrivilegeResult("SCHED_FIFO", False, "it takes a limit"), PrivilegeResult("memory locked", True, "")
MODEM = {"/proc/17/comm": "ModemManager\n", "/proc/18/comm": "bash\n"}
RT, LATE = {"grants": None}, {"worst_wakeup_s": 2e-3}


@pytest.fixture
def case(tree: Callable[..., SystemFiles]) -> Case:
    """A machine on which all is well, but for what is given; `files` are added to its tree."""

    def make(files: dict[str, str] | None = None, machine: dict[str, Any] | None = None, **known: Any) -> Situation:
        sound: dict[str, Any] = {"grants": [], "worst_wakeup_s": 5e-5, "load": Load(0.1, 0.0, 0.5)}
        return Situation(tree=tree(files), machine=replace(SOUND, **(machine or {})), **sound | known)

    return make


def only(case: Situation) -> Advice:
    """The one piece of advice that there is, which is whole."""
    (advice,) = advice_on(case)
    assert advice.found.endswith(".")
    assert advice.why.endswith(".")
    assert advice.do.endswith(":" if advice.commands else ".")
    return advice


def test_a_machine_that_reports_nothing_gets_no_advice(tree: Callable[..., SystemFiles]) -> None:
    unknown = Machine("", None, None, "", False, (), "", "", None, "")
    assert advice_on(Situation(tree(), unknown, port="/dev/ttyACM0")) == []


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({"load": Load(1.0, 0.0, None)}, "kept 1 of 4 cores busy while this measured."),
        ({"load": Load(0.0, 0.0, 4.5)}, "the load average was 4.5."),
        ({"load": Load(3.0, 0.0, 5.0)}, "the loop and its serial port wait for a core"),
        ({"load": Load(0.6, 0.0, 3.5), "machine": {"cores_online": 2}}, "0.6 of 2 cores"),
        ({"files": {FTDI: "16\n"}, "port": "/dev/ttyUSB0"}, "up to 16 ms"),
        ({"files": {FTDI: "2\n"}, "port": "/dev/ttyUSB0"}, f"echo 1 | sudo tee {FTDI}"),
        ({"files": MODEM, "port": "/dev/ttyACM0"}, 'ENV{ID_MM_DEVICE_IGNORE}="1"'),
        ({"files": MODEM, "port": "/dev/ttyACM0"}, "sudo systemctl disable --now ModemManager"),
        ({"grants": [DENIED, LOCKED]}, "Not granted: SCHED_FIFO."),
        ({"grants": [DENIED, LOCKED]}, "SCHED_FIFO: it takes a limit."),
        (RT | {"keeps_up": False}, "hapsim doctor --realtime"),
        (RT | LATE, "hapsim doctor --realtime"),
        (RT | LATE | {"again": "hapsim doctor mine.yaml"}, "hapsim doctor mine.yaml --realtime"),
        ({"machine": {"governors": ("performance", "powersave")}}, "the governor powersave."),
        ({"machine": {"clock_source": "hpet"}}, "the time from hpet."),
        ({"machine": {"clock_source": "acpi_pm"}}, "the time from acpi_pm."),
        ({"machine": {"cores_allowed": 1}}, "taskset -cp $$"),
        ({"machine": {"cores_allowed": 1, "cores_online": 1}}, "This machine has one core only."),
        (
            {"files": {"/proc/self/cgroup": "0::/\n", "/sys/fs/cgroup/cpu.max": "50000 100000\n"}},
            "50 ms of processor time in every 100 ms",
        ),
        (
            {"files": {"/proc/self/cgroup": "1:x:/\n0::/a/b\n", "/sys/fs/cgroup/a/b/cpu.max": "500 1000\n"}},
            "0.5 ms of processor time in every 1 ms",
        ),
        (
            {"files": {"/proc/self/cgroup": "0::/a/b\n", "/sys/fs/cgroup/a/cpu.max": "500 1000\n"}},
            "0.5 ms of processor time in every 1 ms",  # of the group that its own is in
        ),
        (
            {
                "files": {
                    "/proc/self/cgroup": "4:cpu,cpuacct:/docker/1\n0::/\n",
                    "/sys/fs/cgroup/cpu/cpu.cfs_quota_us": "20000\n",
                    "/sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000\n",
                }
            },
            "20 ms of processor time in every 100 ms",
        ),
        ({"files": {"/proc/meminfo": SWAP.format(3_897_600)}}, "100 MB"),
        (LATE | {"machine": {"preempt_rt": False}}, "2 ms late"),
        (LATE | {"machine": {"virtual": "QEMU"}}, "a virtual machine (QEMU)."),
        ({"load": Load(0.0, 0.03, None), "machine": {"virtual": "QEMU"}}, "took 3.0 %"),
    ],
)
def test_one_piece_of_advice_is_given_in_these_words(case: Case, known: dict[str, Any], words: str) -> None:
    advice = only(case(**known))
    assert words in "\n".join((advice.found, advice.why, advice.do, *advice.commands))


@pytest.mark.parametrize(
    "known",
    [
        {},
        {"load": Load(0.6, 0.0, 3.5)},
        {"files": {FTDI: "1\n"}, "port": "/dev/ttyUSB0"},
        {"files": {FTDI: ""}, "port": "/dev/ttyUSB0"},
        {"files": {FTDI: "?"}, "port": "/dev/ttyUSB0"},
        {"files": {FTDI: "16\n"}, "port": "/dev/ttyUSB1"},
        {"files": MODEM, "port": "/dev/ttyUSB0"},
        {"files": MODEM},
        {"files": {"/proc/18/comm": "bash\n"}, "port": "/dev/ttyACM0"},
        {"grants": [LOCKED]},
        RT,
        {"machine": {"governors": ()}},
        {"machine": {"clock_source": "arch_sys_counter"}},
        {"machine": {"clock_source": ""}},
        {"files": {"/proc/self/cgroup": "0::/\n", "/sys/fs/cgroup/cpu.max": "max 100000\n"}},
        {"files": {"/proc/self/cgroup": "0::/\n", "/sys/fs/cgroup/cpu.max": "400000 100000\n"}},  # all 4 cores
        {"files": {"/proc/meminfo": SWAP.format(4_000_000)}},
        {"files": {"/proc/meminfo": SWAP.format(3_897_600)}, "grants": [LOCKED]},
        {"machine": {"preempt_rt": False}},
        LATE,
        {"machine": {"virtual": "QEMU"}},
        {"load": Load(0.0, 0.03, None)},
    ],
)
def test_none_is_given_where_there_is_no_need(case: Case, known: dict[str, Any]) -> None:
    assert advice_on(case(**known)) == []


def test_a_port_that_may_not_be_opened(case: Case) -> None:
    asked: list[Path] = []

    def may_open(path: Path) -> bool:
        asked.append(path)
        return False

    denied = case({"/dev/ttyUSB0": ""}, port="/dev/ttyUSB0", may_open=may_open)
    assert only(denied).commands == ("sudo usermod -aG dialout $USER",)
    assert asked == [denied.tree.root / "dev/ttyUSB0"]
    assert advice_on(replace(denied, may_open=lambda _: True)) == []
    assert advice_on(replace(denied, port="/dev/ttyUSB1")) == []  # that it is not there, the run says


def test_a_converter_is_found_behind_a_link(case: Case) -> None:
    gathering = case({FTDI: "16\n", "/dev/ttyUSB0": ""}, port="/dev/serial/by-id/usb-FTDI", may_open=lambda _: True)
    links = gathering.tree.root / "dev/serial/by-id"
    links.mkdir(parents=True)
    (links / "usb-FTDI").symlink_to("../../ttyUSB0")
    assert "ttyUSB0/latency_timer" in only(gathering).commands[0]


def test_what_helps_most_comes_first(case: Case) -> None:
    machine = {"preempt_rt": False, "governors": ("powersave",), "virtual": "QEMU"}
    several = advice_on(case(machine=machine, load=Load(2.0, 0.0, None), grants=None, **LATE))
    words = ("Other programs", "These figures", "The cores", "A wake-up", "This is a virtual machine")
    assert [advice.found.startswith(begins) for advice, begins in zip(several, words, strict=True)] == [True] * 5
