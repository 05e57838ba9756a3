"""What the machine is, as far as it decides how punctually it wakes up a program."""

from __future__ import annotations

from dataclasses import dataclass

from hapsim.doctor.system_files import Tree


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


def machine_of(tree: Tree) -> Machine:
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


def _cpu(tree: Tree) -> str:
    """The model's name: x86 says "model name", ARM boards "Model" or nothing here but a name in the device tree."""
    fields = _fields(tree.text("proc/cpuinfo"))
    named = fields.get("model name") or fields.get("Model") or fields.get("Hardware")
    return " ".join((named or tree.text("proc/device-tree/model").strip("\0")).split())


def _hypervisor(tree: Tree) -> str:
    if "hypervisor" not in _fields(tree.text("proc/cpuinfo")).get("flags", "").split():
        return tree.text("sys/hypervisor/type")
    maker = " ".join(
        filter(None, (tree.text("sys/class/dmi/id/sys_vendor"), tree.text("sys/class/dmi/id/product_name")))
    )
    return maker or tree.text("sys/hypervisor/type") or "of unknown make"


def _status(tree: Tree, name: str) -> str:
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
