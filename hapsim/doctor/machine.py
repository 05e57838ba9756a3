"""The machine as its system files describe it: what it is, and what else runs on it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class SystemFiles:
    """A file system with /sys, /proc and /dev in it; tests make one of their own."""

    root: Path = Path("/")

    def text(self, path: str) -> str:
        """Returns the text of a file, without the white space around it; "" if it is missing or cannot be read."""
        try:
            return (self.root / path).read_text(encoding="utf-8", errors="replace").strip()
        except (OSError, ValueError):
            return ""

    def texts(self, pattern: str) -> list[str]:
        """Returns the texts of every file of a pattern, in the order of their names, without empty ones."""
        try:
            paths = sorted(path.relative_to(self.root).as_posix() for path in self.root.glob(pattern))
        except OSError:
            return []
        return [text for text in map(self.text, paths) if text]

    def fields(self, path: str) -> dict[str, str]:
        """Returns the `name : value` lines of a file; of a name that comes once for each core, the first."""
        lines = [line.partition(":") for line in self.text(path).splitlines()]
        return {name.strip(): value.strip() for name, colon, value in reversed(lines) if colon}

    def resolve(self, path: str) -> Path:
        """Returns where a path such as /dev/serial/by-id/… leads to, as seen from this root: /dev/ttyUSB0."""
        target = (self.root / path.lstrip("/")).resolve()
        root = self.root.resolve()
        return Path("/") / target.relative_to(root) if target.is_relative_to(root) else target


@dataclass(frozen=True)
class Machine:
    """A machine in a few words; "" and None if it does not say."""

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
    """The hypervisor of a virtual machine, by its name if that is known."""
    smt: bool | None
    """Whether two threads share a core."""
    isolated: str
    """Cores that the kernel keeps free of other work, such as 2-3."""


def machine_of(tree: SystemFiles) -> Machine:
    """Returns the machine that a tree of /sys and /proc describes."""
    cpus, processor = "sys/devices/system/cpu", tree.fields("proc/cpuinfo")
    # x86 has "model name", ARM boards "Model", or nothing here but a name in the device tree.
    model = processor.get("model name") or processor.get("Model") or processor.get("Hardware")
    return Machine(
        cpu=" ".join((model or tree.text("proc/device-tree/model").strip("\0")).split()),
        cores_allowed=_count(tree.fields("proc/self/status").get("Cpus_allowed_list", "")),
        cores_online=_count(tree.text(f"{cpus}/online")),
        kernel=tree.text("proc/sys/kernel/osrelease"),
        preempt_rt=tree.text("sys/kernel/realtime") == "1" or "PREEMPT_RT" in tree.text("proc/sys/kernel/version"),
        governors=tuple(sorted(set(tree.texts(f"{cpus}/cpu[0-9]*/cpufreq/scaling_governor")))),
        clock_source=tree.text("sys/devices/system/clocksource/clocksource0/current_clocksource"),
        virtual=_hypervisor(tree, processor.get("flags", "").split()),
        smt={"1": True, "0": False}.get(tree.text(f"{cpus}/smt/active")),
        isolated=tree.text(f"{cpus}/isolated"),
    )


def _hypervisor(tree: SystemFiles, flags: list[str]) -> str:
    kind, made = tree.text("sys/hypervisor/type"), "sys/class/dmi/id"
    if "hypervisor" not in flags:
        return kind
    maker = " ".join(filter(None, (tree.text(f"{made}/sys_vendor"), tree.text(f"{made}/product_name"))))
    return maker or kind or "of unknown make"


def _count(cores: str) -> int | None:
    """Returns how many cores a list such as 0-3,6 names."""
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
