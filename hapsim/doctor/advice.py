"""The machine as its system files describe it, and what would help: each piece of advice says what was found, why it
matters to a haptic loop, and what to do about it.

The sentences are in `advice.yaml`; here is when they apply, and the values in them. Nothing here changes the machine.
"""

from __future__ import annotations

import itertools
import math
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from hapsim.number_format import plural, share_in_percent, short_duration
from hapsim.system_files import SystemFiles, cores_in

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult


@dataclass(frozen=True)
class Machine:
    """A machine in a few words; "" and None if it does not say."""

    cpu: str  # its model
    cores_allowed: int | None  # cores that this process may run on
    cores_online: int | None
    kernel: str
    preempt_rt: bool  # whether the kernel is a real-time one (PREEMPT_RT)
    governors: tuple[str, ...]
    """Frequency governors of the cores: performance, powersave, …; none on most virtual machines."""
    clock_source: str  # what the kernel reads the time from
    virtual: str  # the hypervisor of a virtual machine, by its name if that is known
    smt: bool | None  # whether two threads share a core
    isolated: str  # cores that the kernel keeps free of other work, such as 2-3
    system: str = "Linux"  # with its version where it is another one


def machine_of(tree: SystemFiles) -> Machine:
    """Returns the machine that a tree of /sys and /proc describes."""
    cpus, processor = "sys/devices/system/cpu", tree.fields("proc/cpuinfo")
    # x86 has "model name", ARM boards "Model", or nothing here but a name in the device tree.
    model = processor.get("model name") or processor.get("Model") or processor.get("Hardware")
    hypervisor, names = tree.text("sys/hypervisor/type"), ("sys_vendor", "product_name")
    made_by = " ".join(filter(None, (tree.text(f"sys/class/dmi/id/{name}") for name in names)))
    made_by = made_by or hypervisor or "of unknown make"
    return Machine(
        cpu=" ".join((model or tree.text("proc/device-tree/model").strip("\0")).split()),
        cores_allowed=len(cores_in(tree.fields("proc/self/status").get("Cpus_allowed_list", ""))) or None,
        cores_online=len(cores_in(tree.text(f"{cpus}/online"))) or None,
        kernel=tree.text("proc/sys/kernel/osrelease"),
        preempt_rt=tree.text("sys/kernel/realtime") == "1" or "PREEMPT_RT" in tree.text("proc/sys/kernel/version"),
        governors=tuple(sorted(set(tree.texts(f"{cpus}/cpu[0-9]*/cpufreq/scaling_governor")))),
        clock_source=tree.text("sys/devices/system/clocksource/clocksource0/current_clocksource"),
        virtual=made_by if "hypervisor" in processor.get("flags", "").split() else hypervisor,
        smt={"1": True, "0": False}.get(tree.text(f"{cpus}/smt/active")),
        isolated=tree.text(f"{cpus}/isolated"),
    )


def machine_without_linux() -> Machine:
    """Returns what Python knows about this machine, whose system has no such files."""
    cores = os.cpu_count()
    return Machine(platform.processor(), cores, cores, "", False, (), "", "", None, "", platform.platform())


_TICKS_PER_SECOND = 100.0  # USER_HZ: the unit of /proc's times, fixed on every architecture that hapsim runs on


@dataclass(frozen=True)
class CpuTimes:
    """Seconds since some beginning, over all cores."""

    everybody_s: float  # spent working, by any program or the kernel
    ours_s: float  # spent working by this process
    stolen_s: float  # in which the host ran something else than this virtual machine
    all_s: float  # of all cores, idle or not


@dataclass(frozen=True)
class Load:
    """The load between two reads of the system files."""

    others_cores: float  # cores that others kept busy: 0.5 is half a core
    stolen_share: float  # of the time of all cores (0 to 1), taken by the host of a virtual machine
    average: float | None  # the kernel's load average over a minute: how many tasks run or wait to


def cpu_times(tree: SystemFiles) -> CpuTimes | None:
    """Returns the times so far; None if the tree does not have them."""
    try:
        user, nice, system, idle, wait, irq, soft, stolen = map(int, tree.text("proc/stat").split()[1:9])
        # The name, in parentheses, may have blanks in it.
        ours = tree.text("proc/self/stat").rpartition(")")[2].split()[11:13]
        busy, own = user + nice + system + irq + soft, sum(map(int, ours))
    except ValueError:
        return None
    return CpuTimes(*(ticks / _TICKS_PER_SECOND for ticks in (busy, own, stolen, busy + idle + wait + stolen)))


def load_between(before: CpuTimes | None, after: CpuTimes | None, cores: int | None, tree: SystemFiles) -> Load | None:
    """Returns the load between two looks; None if nothing is known of it, or no time passed."""
    if before is None or after is None or not after.all_s > before.all_s:
        return None
    span_s = after.all_s - before.all_s
    others_s = (after.everybody_s - before.everybody_s) - (after.ours_s - before.ours_s)
    stolen_s = max(after.stolen_s - before.stolen_s, 0.0)
    try:
        average = float(tree.text("proc/loadavg").split()[0])
    except (IndexError, ValueError):
        average = None
    return Load(max(others_s, 0.0) / (span_s / (cores or 1)), stolen_s / span_s, average)


_LATE_S = 0.5e-3  # a wake-up that much late is half a period at 1 kHz; a real-time kernel stays far below
_BUSY_SHARE = 0.2  # of the cores, kept busy by others
_STOLEN_SHARE = 0.005
#: Those that are read without a system call, one of them on each kind of machine.
_QUICK_CLOCKS = ("", "tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "riscv_clocksource")


@dataclass(frozen=True)
class Advice:
    """One thing that can be done, in sentences."""

    found: str
    why: str
    do: str
    commands: tuple[str, ...] = ()  # for a shell, if some do it


@dataclass(frozen=True)
class Situation:
    """The facts about the machine from which the advice follows."""

    tree: SystemFiles
    machine: Machine
    port: str | None = None  # the device's, if there is one
    grants: Sequence[PrivilegeResult] | None = None
    """The real-time privileges that were requested; None if none were."""
    worst_wakeup_s: float | None = None
    keeps_up: bool = True  # whether every rate was a yes
    shortest_sleep_s: float | None = None  # where the system is not Linux
    again: str = "hapsim doctor"  # what examines the same again, for a shell
    load: Load | None = None
    may_open: Callable[[Path], bool] = lambda path: os.access(path, os.R_OK | os.W_OK)

    @property
    def wakes_late(self) -> bool:
        """True if a wake-up came late enough to justify advice."""
        return self.worst_wakeup_s is not None and self.worst_wakeup_s > _LATE_S


Found = Iterator[tuple[str, dict[str, str]]]
"""The names of what would help, with the values in its sentences."""


def advice_on(case: Situation) -> list[Advice]:
    """Returns everything that would help, what helps most first."""
    table = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))
    on_linux = itertools.chain(_about_machine(case), _about_port(case), _about_limits(case))
    python_loop = {"system": case.machine.system, "sleep": short_duration(case.shortest_sleep_s)}
    applies = dict(on_linux) if case.machine.system == "Linux" else {"python_loop": python_loop}
    advice = []
    for name in filter(applies.__contains__, table):
        commands = tuple(command.format(**applies[name]) for command in table[name].pop("commands", ()))
        sentences = {key: sentence.format(**applies[name]) for key, sentence in table[name].items()}
        advice.append(Advice(**sentences, commands=commands))
    return advice


def _about_machine(case: Situation) -> Found:
    machine, cores, load = case.machine, case.machine.cores_online, case.load
    if (
        load is not None
        and cores is not None
        and (load.others_cores >= _BUSY_SHARE * cores or (load.average or 0.0) > cores)
    ):
        average = "" if load.average is None else f", and the load average was {load.average:.3g}"
        yield "busy", {"others": f"{load.others_cores:.2g}", "cores": plural(cores, "core"), "average": average}
    if case.grants is None and (case.wakes_late or not case.keeps_up):
        yield "not_asked", {"again": case.again}
    if denied := [grant for grant in case.grants or () if not grant.granted]:
        details = "; ".join(f"{grant.privilege}: {grant.detail}" for grant in denied)
        yield "denied", {"privileges": ", ".join(grant.privilege for grant in denied), "details": details}
    if slow := [governor for governor in machine.governors if governor != "performance"]:
        yield "governor", {"governors": " and ".join(slow)}
    if machine.clock_source not in _QUICK_CLOCKS:
        yield "clock_source", {"source": machine.clock_source}
    if machine.cores_allowed == 1:
        yield "single_core" if (cores or 1) > 1 else "only_core", {}
    stolen = 0.0 if load is None else load.stolen_share
    if case.wakes_late and not machine.preempt_rt:
        yield "kernel", {"late": short_duration(case.worst_wakeup_s)}
    if machine.virtual and (case.wakes_late or stolen >= _STOLEN_SHARE):
        taken = f", whose host took {share_in_percent(stolen)} of the time for others"
        yield "host", {"virtual": machine.virtual, "taken": taken if stolen >= _STOLEN_SHARE else ""}


def _about_port(case: Situation) -> Found:
    if case.port is None:
        return
    resolved = case.tree.resolve(case.port)
    device, path = resolved.name, case.tree.root / resolved.relative_to("/")  # ttyUSB0, whatever link leads there
    latency = case.tree.text(f"sys/bus/usb-serial/devices/{device}/latency_timer")
    if path.exists() and not case.may_open(path):
        yield "port_not_permitted", {"port": case.port}
    if latency.isdigit() and int(latency) > 1:
        yield "ftdi_gathers", {"port": case.port, "device": device, "latency": latency}
    if device.startswith("ttyACM") and "ModemManager" in case.tree.texts("proc/[0-9]*/comm"):
        yield "modem_manager", {"port": case.port}


def _about_limits(case: Situation) -> Found:
    quotas = []
    for words in map(str.split, case.tree.group_limits("cpu", ("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us"))):
        if len(words) == 2 and all(word.isdigit() for word in words) and int(words[1]):
            limit, period = map(int, words)
            quotas.append((limit / period, limit, period))
    if quotas and min(quotas)[0] < (case.machine.cores_online or math.inf):
        _, limit, period = min(quotas)
        yield "quota", {"limit": f"{limit / 1e3:g}", "period": f"{period / 1e3:g}"}
    sizes = {
        name: int(size.split()[0])
        for name, size in case.tree.fields("proc/meminfo").items()
        if size.split(" ")[0].isdigit()
    }
    used_mb = (sizes.get("SwapTotal", 0) - sizes.get("SwapFree", 0)) / 1024
    locked = any(grant.granted and "mem" in grant.privilege.lower() for grant in case.grants or ())
    if used_mb >= 1.0 and not locked:
        yield "swap", {"used": f"{used_mb:.0f}"}
