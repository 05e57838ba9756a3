"""What would help: each piece says what was found, why it matters to a haptic loop, and what to do about it.

One piece of advice is one function of `EVERY_ADVICE`, in the order of what helps most; it returns None where it has
nothing to say. Nothing here changes the machine.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hapsim.doctor.machine import Load, Machine, SystemFiles
from hapsim.number_format import plural, share_in_percent, short_duration

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult

_LATE_S = 0.5e-3  # a wake-up that much late is half a period at 1 kHz; a real-time kernel stays far below
_BUSY_SHARE = 0.2  # of the cores, kept busy by others
_STOLEN_SHARE = 0.005
#: Those that are read without a system call, one of them on each kind of machine.
_QUICK_CLOCKS = ("tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "riscv_clocksource")


@dataclass(frozen=True)
class Advice:
    """One thing that can be done, in sentences."""

    found: str
    why: str
    do: str
    commands: tuple[str, ...] = ()
    """For a shell, where some do it."""


@dataclass(frozen=True)
class Situation:
    """What is known of the machine when it is advised upon."""

    tree: SystemFiles
    machine: Machine
    port: str | None = None
    """The device's, where there is one."""
    grants: Sequence[PrivilegeResult] | None = None
    """What was asked for of real time; None where nothing was."""
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

    @property
    def device(self) -> str:
        """The name of the port's device, such as ttyUSB0, whatever link leads to it; "" without a port."""
        return "" if self.port is None else self.tree.resolve(self.port).name


def advice_on(case: Situation) -> list[Advice]:
    """All that would help, what helps most first."""
    return [advice for advise in EVERY_ADVICE if (advice := advise(case)) is not None]


def _busy(case: Situation) -> Advice | None:
    cores, load = case.machine.cores_online, case.load
    if load is None or cores is None:
        return None
    crowded = load.average is not None and load.average > cores
    if not crowded and load.others_cores < _BUSY_SHARE * cores:
        return None
    average = "" if load.average is None else f", and the load average was {load.average:.3g}"
    return Advice(
        found=f"Other programs kept {load.others_cores:.2g} of {plural(cores, 'core')} busy "
        f"while this measured{average}.",
        why="The figures are of a busy machine: the loop and its serial port wait for a core like everybody else.",
        do="Close what need not run, then measure again. What runs:",
        commands=("top",),
    )


def _port_not_permitted(case: Situation) -> Advice | None:
    if case.port is None:
        return None
    path = case.tree.root / case.tree.resolve(case.port).relative_to("/")
    if not path.exists() or case.may_open(path):
        return None
    return Advice(
        found=f"You may not read and write {case.port}.",
        why="Serial ports belong to a group, dialout on most systems, and you are not in it.",
        do="Join it, then log out and in again:",
        commands=("sudo usermod -aG dialout $USER",),
    )


def _ftdi_gathers(case: Situation) -> Advice | None:
    latency = case.tree.text(f"sys/bus/usb-serial/devices/{case.device}/latency_timer") if case.device else ""
    if not latency.isdigit() or int(latency) <= 1:
        return None
    return Advice(
        found=f"The USB converter of {case.port} keeps bytes for up to {latency} ms before it hands them on.",
        why=f"FTDI chips gather bytes to save interrupts; a position {latency} ms old is of no use to the loop.",
        do="Set it to 1 ms; that lasts until it is unplugged:",
        commands=(f"echo 1 | sudo tee /sys/bus/usb-serial/devices/{case.device}/latency_timer",),
    )


def _modem_manager(case: Situation) -> Advice | None:
    if not case.device.startswith("ttyACM") or "ModemManager" not in case.tree.texts("proc/[0-9]*/comm"):
        return None
    return Advice(
        found=f"ModemManager is running, and the device is on {case.port}.",
        why="It takes every new /dev/ttyACM* for a modem and talks to it for some seconds: the port is busy meanwhile, "
        "and a device may hear bytes that are not for it.",
        do='Stop it, or write a udev rule for the device with ENV{ID_MM_DEVICE_IGNORE}="1":',
        commands=("sudo systemctl disable --now ModemManager",),
    )


def _denied(case: Situation) -> Advice | None:
    denied = [grant for grant in case.grants or () if not grant.granted]
    if not denied:
        return None
    return Advice(
        found=f"Not granted: {', '.join(grant.privilege for grant in denied)}.",
        why="Without it the loop waits its turn behind other programs, for memory that was moved away, or for a "
        "processor that sleeps.",
        do="; ".join(f"{grant.privilege}: {grant.detail}" for grant in denied) + ".",
    )


def _not_asked(case: Situation) -> Advice | None:
    if case.grants is not None or (case.keeps_up and not case.wakes_late):
        return None
    return Advice(
        found="These figures are of a program like any other: real-time scheduling was not asked for.",
        why="Every other program may keep the loop waiting for a few milliseconds.",
        do="Measure again with it; what you are not allowed will be said:",
        commands=(f"{case.again} --realtime",),
    )


def _governor(case: Situation) -> Advice | None:
    slow = [governor for governor in case.machine.governors if governor != "performance"]
    if not slow:
        return None
    return Advice(
        found=f"The cores choose their frequency by the governor {' and '.join(slow)}.",
        why="A loop that sleeps most of its period looks idle: the core clocks down, and each wake-up starts slowly.",
        do="Keep them at their full speed; that lasts until the next start:",
        commands=("echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",),
    )


def _clock_source(case: Situation) -> Advice | None:
    source = case.machine.clock_source
    if not source or source in _QUICK_CLOCKS:
        return None
    return Advice(
        found=f"The kernel reads the time from {source}.",
        why="The loop looks at the clock several times a period, and this one takes a system call and a microsecond or "
        "more each time.",
        do="See why the kernel does not trust the processor's own counter, and if it has it, choose it:",
        commands=(
            "sudo dmesg | grep -i -e clocksource -e tsc",
            "echo tsc | sudo tee /sys/devices/system/clocksource/clocksource0/current_clocksource",
        ),
    )


def _single_core(case: Situation) -> Advice | None:
    if case.machine.cores_allowed != 1:
        return None
    elsewhere = (case.machine.cores_online or 1) > 1
    return Advice(
        found="hapsim may run on one core only.",
        why="The kernel's part of the serial port, the display and everything else share it with the loop.",
        do="Let it run on the others too. What it may run on:"
        if elsewhere
        else "Take a machine with two cores or more.",
        commands=("taskset -cp $$",) if elsewhere else (),
    )


def _quota(case: Situation) -> Advice | None:
    group = next((line[3:] for line in case.tree.text("proc/self/cgroup").splitlines() if line[:3] == "0::"), "/")
    quota = case.tree.text(f"sys/fs/cgroup/{group.strip('/')}/cpu.max").split()
    if len(quota) != 2 or not (quota[0].isdigit() and quota[1].isdigit()):
        return None
    limit_ms, period_ms = int(quota[0]) / 1e3, int(quota[1]) / 1e3
    return Advice(
        found=f"This container or service may use {limit_ms:g} ms of processor time in every {period_ms:g} ms.",
        why="When that is used up, everything in it stands still until the next turn, the loop as well.",
        do="Start it without a limit of processor time (docker: without --cpus), and give it cores of its own instead "
        "(--cpuset-cpus).",
    )


def _swap(case: Situation) -> Advice | None:
    sizes = {name: value.split() for name, _, value in map(_colon, case.tree.text("proc/meminfo").splitlines())}
    try:
        used_mb = (int(sizes["SwapTotal"][0]) - int(sizes["SwapFree"][0])) / 1024
    except (KeyError, IndexError, ValueError):
        return None
    locked = any(grant.granted and "mem" in grant.privilege.lower() for grant in case.grants or ())
    if used_mb < 1.0 or locked:
        return None
    return Advice(
        found=f"{used_mb:.0f} MB of memory are in swap.",
        why="A page of the loop that was moved to disk takes milliseconds to come back, when it is needed.",
        do="Close what need not run, or lock the loop's memory: --realtime does so.",
    )


def _kernel(case: Situation) -> Advice | None:
    if case.machine.preempt_rt or not case.wakes_late:
        return None
    return Advice(
        found=f"A wake-up came {short_duration(case.worst_wakeup_s)} late, and the kernel is not a real-time one.",
        why="Without PREEMPT_RT the kernel finishes much of its own work before it lets a program run, however urgent.",
        do="Install one, start it, and measure again (Debian; Ubuntu has it as: sudo pro enable realtime-kernel):",
        commands=("sudo apt install linux-image-rt-amd64",),
    )


def _host(case: Situation) -> Advice | None:
    stolen = 0.0 if case.load is None else case.load.stolen_share
    if not case.machine.virtual or (stolen < _STOLEN_SHARE and not case.wakes_late):
        return None
    taken = f", whose host took {share_in_percent(stolen)} of the time for others" if stolen >= _STOLEN_SHARE else ""
    return Advice(
        found=f"This is a virtual machine ({case.machine.virtual}){taken}.",
        why="Its host decides when a core runs at all, and nothing that is set in here changes that.",
        do="Run the loop on the hardware itself, or give this machine cores of its own on the host.",
    )


def _colon(line: str) -> tuple[str, str, str]:
    return line.partition(":")


EVERY_ADVICE: tuple[Callable[[Situation], Advice | None], ...] = (
    _busy,
    _port_not_permitted,
    _ftdi_gathers,
    _modem_manager,
    _not_asked,
    _denied,
    _governor,
    _clock_source,
    _single_core,
    _quota,
    _swap,
    _kernel,
    _host,
)
