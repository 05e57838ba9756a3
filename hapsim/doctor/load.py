"""What else ran on the machine while it was examined: other programs, and other guests of its host."""

from __future__ import annotations

from dataclasses import dataclass

from hapsim.doctor.system_files import Tree

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


def cpu_times(tree: Tree) -> CpuTimes | None:
    """The times so far; None where the tree does not tell them."""
    try:
        user, nice, system, idle, wait, irq, soft, stolen = map(int, tree.text("proc/stat").split()[1:9])
        # The name, in parentheses, may have blanks in it.
        ours = tree.text("proc/self/stat").rpartition(")")[2].split()[11:13]
        busy, own = user + nice + system + irq + soft, sum(map(int, ours))
    except ValueError:
        return None
    return CpuTimes(*(ticks / _TICKS_PER_SECOND for ticks in (busy, own, stolen, busy + idle + wait + stolen)))


def load_between(before: CpuTimes | None, after: CpuTimes | None, cores: int | None, tree: Tree) -> Load | None:
    """The load between two looks; None where nothing is known of it, or no time went by."""
    if before is None or after is None or not after.all_s > before.all_s:
        return None
    span = after.all_s - before.all_s
    others = (after.everybody_s - before.everybody_s) - (after.ours_s - before.ours_s)
    seconds = span / (cores or 1)
    stolen = max(after.stolen_s - before.stolen_s, 0.0) / span
    return Load(max(others, 0.0) / seconds, stolen, _average(tree))


def _average(tree: Tree) -> float | None:
    try:
        return float(tree.text("proc/loadavg").split()[0])
    except (IndexError, ValueError):
        return None
