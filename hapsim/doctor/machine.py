"""The machine as its system files describe it: what it is, and what else runs on it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class SystemFiles:
    """A file system with /sys, /proc and /dev in it; tests give one of their own making."""

    root: Path = Path("/")

    def text(self, path: str) -> str:
        """What a file says, without the white space around it; "" where it is missing or not to be read."""
        try:
            return (self.root / path).read_text(encoding="utf-8", errors="replace").strip()
        except (OSError, ValueError):
            return ""

    def texts(self, pattern: str) -> list[str]:
        """What every file of a pattern says, in the order of their names; those that say nothing left out."""
        try:
            paths = sorted(path.relative_to(self.root).as_posix() for path in self.root.glob(pattern))
        except OSError:
            return []
        return [text for text in map(self.text, paths) if text]

    def resolve(self, path: str) -> Path:
        """Where a path such as /dev/serial/by-id/… leads to, told from this root: /dev/ttyUSB0."""
        target = (self.root / path.lstrip("/")).resolve()
        root = self.root.resolve()
        return Path("/") / target.relative_to(root) if target.is_relative_to(root) else target


@dataclass(frozen=True)
class Machine:
    """A machine in a few words; "" and None where it does not tell."""

    cpu: str
    """Its model."""
    cores_allowed: int | None
    """Cores that this process may run on."""
    cores_online: int | None
    kernel: str
    preempt_rt: bool
    """Whether the kernel is a real-time one (PREEMPT_RT)."""
    governors: tuple[str, ...]
    """How the cores choose their frequency: performance, powersave, …; none on most virtual machines."""
    clock_source: str
    """What the kernel reads the time from."""
    virtual: str
    """The hypervisor where it is a virtual machine, by its name where that is known."""
    smt: bool | None
    """Whether two threads share a core."""
    isolated: str
    """Cores that the kernel keeps free of other work, such as 2-3."""


def machine_of(tree: SystemFiles) -> Machine:
    """The machine that a tree of /sys and /proc describes."""
    return Machine(
        cpu=_cpu(tree),
        cores_allowed=_count(_status(tree, "Cpus_allowed_list")),
        cores_online=_count(tree.text("sys/devices/system/cpu/online")),
        kernel=tree.text("proc/sys/kernel/osrelease"),
        preempt_rt=tree.text("sys/kernel/realtime") == "1" or "PREEMPT_RT" in tree.text("proc/sys/kernel/version"),
        governors=tuple(sorted(set(tree.texts("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")))),
        clock_source=tree.text("sys/devices/system/clocksource/clocksource0/current_clocksource"),
        virtual=_hypervisor(tree),
        smt={"1": True, "0": False}.get(tree.text("sys/devices/system/cpu/smt/active")),
        isolated=tree.text("sys/devices/system/cpu/isolated"),
    )


def _cpu(tree: SystemFiles) -> str:
    """The model's name: x86 says "model name", ARM boards "Model" or nothing here but a name in the device tree."""
    fields = _fields(tree.text("proc/cpuinfo"))
    named = fields.get("model name") or fields.get("Model") or fields.get("Hardware")
    return " ".join((named or tree.text("proc/device-tree/model").strip("\0")).split())


def _hypervisor(tree: SystemFiles) -> str:
    if "hypervisor" not in _fields(tree.text("proc/cpuinfo")).get("flags", "").split():
        return tree.text("sys/hypervisor/type")
    maker = " ".join(
        filter(None, (tree.text("sys/class/dmi/id/sys_vendor"), tree.text("sys/class/dmi/id/product_name")))
    )
    return maker or tree.text("sys/hypervisor/type") or "of unknown make"


def _status(tree: SystemFiles, name: str) -> str:
    return _fields(tree.text("proc/self/status")).get(name, "")


def _fields(text: str) -> dict[str, str]:
    """`name : value` lines; of a name that comes more than once, as for each core, the first."""
    fields: dict[str, str] = {}
    for line in text.splitlines():
        name, colon, value = line.partition(":")
        if colon:
            fields.setdefault(name.strip(), value.strip())
    return fields


def _count(cores: str) -> int | None:
    """How many cores a list such as 0-3,6 names."""
    try:
        ends = [tuple(map(int, part.split("-"))) for part in cores.split(",") if part]
    except ValueError:
        return None
    return sum(end[-1] - end[0] + 1 for end in ends) or None


_TICKS_PER_SECOND = 100.0  # USER_HZ: the unit of /proc's times, fixed on every architecture that hapsim runs on


@dataclass(frozen=True)
class CpuTimes:
    """Seconds since some beginning, over all cores."""

    everybody_s: float
    """Spent working, by any program or the kernel."""
    ours_s: float
    """Spent working by this process."""
    stolen_s: float
    """In which the host ran something else than this virtual machine."""
    all_s: float
    """Of all cores, idle or not."""


@dataclass(frozen=True)
class Load:
    """Of the time between two looks."""

    others_cores: float
    """Cores that others kept busy: 0.5 is half a core."""
    stolen_share: float
    """Of the time of all cores (0 to 1), taken by the host of a virtual machine."""
    average: float | None
    """The kernel's load average over a minute: how many tasks run or wait to."""


def cpu_times(tree: SystemFiles) -> CpuTimes | None:
    """The times so far; None where the tree does not tell them."""
    try:
        user, nice, system, idle, wait, irq, soft, stolen = map(int, tree.text("proc/stat").split()[1:9])
        # The name, in parentheses, may have blanks in it.
        ours = tree.text("proc/self/stat").rpartition(")")[2].split()[11:13]
        busy, own = user + nice + system + irq + soft, sum(map(int, ours))
    except ValueError:
        return None
    return CpuTimes(*(ticks / _TICKS_PER_SECOND for ticks in (busy, own, stolen, busy + idle + wait + stolen)))


def load_between(before: CpuTimes | None, after: CpuTimes | None, cores: int | None, tree: SystemFiles) -> Load | None:
    """The load between two looks; None where nothing is known of it, or no time went by."""
    if before is None or after is None or not after.all_s > before.all_s:
        return None
    span = after.all_s - before.all_s
    others = (after.everybody_s - before.everybody_s) - (after.ours_s - before.ours_s)
    seconds = span / (cores or 1)
    stolen = max(after.stolen_s - before.stolen_s, 0.0) / span
    return Load(max(others, 0.0) / seconds, stolen, _average(tree))


def _average(tree: SystemFiles) -> float | None:
    try:
        return float(tree.text("proc/loadavg").split()[0])
    except (IndexError, ValueError):
        return None
