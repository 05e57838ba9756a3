"""Properties read from a machine; any file may be missing or contain nonsense."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hapsim.doctor.advice import CpuTimes, Machine, cpu_times, load_between, machine_of
from hapsim.system_files import SystemFiles

NOTHING = Machine("", None, None, "", False, (), "", "", None, "")
A_MACHINE = {
    "/proc/cpuinfo": "processor\t: 0\nmodel name\t: Some(R)  Processor\nflags\t\t: fpu tsc\n\nmodel name\t: Other\n",
    "/proc/self/status": "Name:\tpython\nCpus_allowed_list:\t0-1,4\n",
    "/proc/sys/kernel/osrelease": "6.12.1\n",
    "/proc/sys/kernel/version": "#1 SMP PREEMPT_DYNAMIC Debian\n",
    "/sys/devices/system/cpu/online": "0-7\n",
    "/sys/devices/system/cpu/smt/active": "1\n",
    "/sys/devices/system/cpu/isolated": "2-3\n",
    "/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "powersave\n",
    "/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "performance\n",
    "/sys/devices/system/cpu/cpu2/cpufreq/scaling_governor": "powersave\n",
    "/sys/devices/system/clocksource/clocksource0/current_clocksource": "hpet\n",
}
STAT = "cpu  {0} 0 0 {1} 0 0 0 {2} 0 0\ncpu0 1 1 1 1\n"
OWN = "42 (a (strange) name) S 1 1 1 0 -1 4194560 1 2 3 4 {0} 0 0 0 20\n"


def test_a_machine_is_read_from_its_files(tree: Callable[..., SystemFiles]) -> None:
    assert machine_of(tree(A_MACHINE)) == Machine(
        cpu="Some(R) Processor",
        cores_allowed=3,
        cores_online=8,
        kernel="6.12.1",
        preempt_rt=False,
        governors=("performance", "powersave"),
        clock_source="hpet",
        virtual="",
        smt=True,
        isolated="2-3",
    )


def test_a_machine_that_reports_nothing_is_no_failure(tree: Callable[..., SystemFiles]) -> None:
    assert machine_of(tree()) == NOTHING
    nonsense = dict.fromkeys(A_MACHINE, "\x00\xff?")
    assert machine_of(tree(nonsense)).cores_allowed is None


GUEST = {"/proc/cpuinfo": "model name\t: P\nflags\t: fpu hypervisor tsc\n"}
MAKER = {"/sys/class/dmi/id/sys_vendor": "QEMU\n", "/sys/class/dmi/id/product_name": "Standard PC\n"}
BOARD = {"/proc/cpuinfo": "processor\t: 0\nBogoMIPS\t: 108\n", "/proc/device-tree/model": "Raspberry Pi 5\0"}


@pytest.mark.parametrize(
    ("files", "field", "value"),
    [
        ({"/sys/kernel/realtime": "1\n"}, "preempt_rt", True),
        ({"/proc/sys/kernel/version": "#1 SMP PREEMPT_RT Debian\n"}, "preempt_rt", True),
        (GUEST, "virtual", "of unknown make"),
        (GUEST | MAKER, "virtual", "QEMU Standard PC"),
        (A_MACHINE | MAKER, "virtual", ""),  # real hardware
        (BOARD, "cpu", "Raspberry Pi 5"),
    ],
)
def test_kernels_hypervisors_and_boards_are_recognised(
    tree: Callable[..., SystemFiles], files: dict[str, str], field: str, value: object
) -> None:
    assert getattr(machine_of(tree(files)), field) == value


def test_times_are_everybodys_ours_and_the_hosts(tree: Callable[..., SystemFiles]) -> None:
    files = {"/proc/stat": STAT.format(300, 600, 100), "/proc/self/stat": OWN.format(50)}
    assert cpu_times(tree(files)) == CpuTimes(everybody_s=3.0, ours_s=0.5, stolen_s=1.0, all_s=10.0)


@pytest.mark.parametrize("stat", ["", "cpu 1 2", "cpu a b c d e f g h", "intr 0"])
def test_times_that_cannot_be_read_are_none(tree: Callable[..., SystemFiles], stat: str) -> None:
    assert cpu_times(tree({"/proc/stat": stat, "/proc/self/stat": OWN.format(1)})) is None


def test_load_is_what_others_did_between_two_looks(tree: Callable[..., SystemFiles]) -> None:
    before, after = CpuTimes(10.0, 1.0, 0.0, 100.0), CpuTimes(14.0, 2.0, 0.4, 120.0)
    load = load_between(before, after, 2, tree({"/proc/loadavg": "1.50 0.3 0.2 1/84 662\n"}))
    assert load is not None
    assert load.others_cores == pytest.approx(3.0 / 10.0)
    assert load.stolen_share == pytest.approx(0.4 / 20.0)
    assert load.average == 1.5


def test_no_load_is_reported_where_nothing_was_seen(tree: Callable[..., SystemFiles]) -> None:
    look = CpuTimes(1.0, 1.0, 0.0, 10.0)
    assert load_between(look, look, 2, tree()) is None
    assert load_between(None, look, 2, tree()) is None
    later = load_between(look, CpuTimes(1.0, 2.0, 0.0, 11.0), 2, tree())
    assert later is not None
    assert (later.others_cores, later.average) == (0.0, None)
