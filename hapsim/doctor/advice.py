"""What would help: each piece says what was found, why it matters to a haptic loop, and what to do about it.

The sentences are in `advice.yaml`; here is when they apply, and the values in them. Nothing here changes the machine.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from hapsim.doctor.machine import Load, Machine, SystemFiles
from hapsim.number_format import plural, share_in_percent, short_duration

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult

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
    commands: tuple[str, ...] = ()
    """For a shell, if some do it."""


@dataclass(frozen=True)
class Situation:
    """What is known of the machine when it is advised upon."""

    tree: SystemFiles
    machine: Machine
    port: str | None = None
    """The device's, if there is one."""
    grants: Sequence[PrivilegeResult] | None = None
    """The real-time privileges that were requested; None if none were."""
    worst_wakeup_s: float | None = None
    keeps_up: bool = True
    """Whether every rate was a yes."""
    again: str = "hapsim doctor"
    """What examines the same again, for a shell."""
    load: Load | None = None
    may_open: Callable[[Path], bool] = lambda path: os.access(path, os.R_OK | os.W_OK)

    @property
    def wakes_late(self) -> bool:
        """Whether a wake-up came so late that it is worth doing something about."""
        return self.worst_wakeup_s is not None and self.worst_wakeup_s > _LATE_S


Found = Iterator[tuple[str, dict[str, str]]]
"""The names of what would help, with the values in its sentences."""


def advice_on(case: Situation) -> list[Advice]:
    """Returns everything that would help, what helps most first."""
    table = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))
    about = (_about_load, _about_port, _about_privileges, _about_processor, _about_limits, _about_kernel)
    applies = dict(itertools.chain.from_iterable(find(case) for find in about))
    advice = []
    for name in filter(applies.__contains__, table):
        commands = tuple(command.format(**applies[name]) for command in table[name].pop("commands", ()))
        sentences = {key: sentence.format(**applies[name]) for key, sentence in table[name].items()}
        advice.append(Advice(**sentences, commands=commands))
    return advice


def _about_load(case: Situation) -> Found:
    cores, load = case.machine.cores_online, case.load
    if load is None or cores is None:
        return
    if load.others_cores >= _BUSY_SHARE * cores or (load.average or 0.0) > cores:
        average = "" if load.average is None else f", and the load average was {load.average:.3g}"
        yield "busy", {"others": f"{load.others_cores:.2g}", "cores": plural(cores, "core"), "average": average}


def _about_port(case: Situation) -> Found:
    if case.port is None:
        return
    resolved = case.tree.resolve(case.port)
    device, path = (
        resolved.name,
        case.tree.root / resolved.relative_to("/"),
    )  # such as ttyUSB0, whatever link leads there
    latency = case.tree.text(f"sys/bus/usb-serial/devices/{device}/latency_timer")
    if path.exists() and not case.may_open(path):
        yield "port_not_permitted", {"port": case.port}
    if latency.isdigit() and int(latency) > 1:
        yield "ftdi_gathers", {"port": case.port, "device": device, "latency": latency}
    if device.startswith("ttyACM") and "ModemManager" in case.tree.texts("proc/[0-9]*/comm"):
        yield "modem_manager", {"port": case.port}


def _about_privileges(case: Situation) -> Found:
    if case.grants is None and (case.wakes_late or not case.keeps_up):
        yield "not_asked", {"again": case.again}
    if denied := [grant for grant in case.grants or () if not grant.granted]:
        details = "; ".join(f"{grant.privilege}: {grant.detail}" for grant in denied)
        yield "denied", {"privileges": ", ".join(grant.privilege for grant in denied), "details": details}


def _about_processor(case: Situation) -> Found:
    machine = case.machine
    if slow := [governor for governor in machine.governors if governor != "performance"]:
        yield "governor", {"governors": " and ".join(slow)}
    if machine.clock_source not in _QUICK_CLOCKS:
        yield "clock_source", {"source": machine.clock_source}
    if machine.cores_allowed == 1:
        yield "single_core" if (machine.cores_online or 1) > 1 else "only_core", {}


def _about_limits(case: Situation) -> Found:
    quotas = [(limit / period, limit, period) for limit, period in _quotas(case.tree)]
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


def _quotas(tree: SystemFiles) -> Iterator[tuple[int, int]]:
    """Yields the limits of processor time, each µs in a period of µs: of this process's control group and of those
    that it is in, by version 2 and by version 1."""
    for line in tree.text("proc/self/cgroup").splitlines():
        _, controllers, group = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        mount = "sys/fs/cgroup/cpu" if controllers else "sys/fs/cgroup"
        files = ("cpu.cfs_quota_us", "cpu.cfs_period_us") if controllers else ("cpu.max",)
        # A container may see its own group as the mount, under the name that its host has for it.
        for folder in (Path(group.lstrip("/")), *Path(group.lstrip("/")).parents):
            words = " ".join(tree.text(f"{mount}/{folder}/{file}") for file in files).split()
            if len(words) == 2 and all(word.isdigit() for word in words) and int(words[1]):
                yield int(words[0]), int(words[1])


def _about_kernel(case: Situation) -> Found:
    stolen = 0.0 if case.load is None else case.load.stolen_share
    if case.wakes_late and not case.machine.preempt_rt:
        yield "kernel", {"late": short_duration(case.worst_wakeup_s)}
    if case.machine.virtual and (case.wakes_late or stolen >= _STOLEN_SHARE):
        share = share_in_percent(stolen)
        taken = f", whose host took {share} of the time for others" if stolen >= _STOLEN_SHARE else ""
        yield "host", {"virtual": case.machine.virtual, "taken": taken}
