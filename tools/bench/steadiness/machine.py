"""Machine of a measurement, and its permissions."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np

from steadiness.wakeups import PRIORITY, has_cyclictest

_POWER = Path("/dev/cpu_dma_latency")


def describe_machine(compiler: str) -> dict[str, Any]:
    """Everything that a figure depends on and that can be read here. `compiler`: of the C loop."""
    return {
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "virtual": "hypervisor" in _cpu_info(),
        "kernel": f"{platform.system()} {platform.release()} {platform.version()}",
        "python": platform.python_version(),
        "numba": numba.__version__,
        "numpy": np.__version__,
        "c_compiler": compiler,
        "cyclictest": _cyclictest_version(),
        "load_at_start": os.getloadavg()[0],
    }


@contextlib.contextmanager
def awake() -> Iterator[str]:
    """Keeps all processors from deep idle states while open. Yields the result in a sentence."""
    try:
        descriptor = os.open(_POWER, os.O_RDWR)
    except OSError as error:
        yield f"{_POWER} was not to be had ({error.strerror}): the processors may sleep deeply, for every peer"
        return
    try:
        os.write(descriptor, (0).to_bytes(4, "little"))
        yield f"{_POWER} held at 0 for every peer"
    finally:
        os.close(descriptor)


def may_use_fifo() -> bool:
    """Returns whether the system permits SCHED_FIFO, by trying it."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


def share_out_processors() -> tuple[set[int], set[int]]:
    """(The device's processor, the others, for the loop and its load): a device does not run on its host's processor.
    Where there is but one, it is everybody's.

    Left to the scheduler, the two of them are now on one processor and now on two, and an exchange takes a quarter of
    the time on one: a wake-up across processors of a virtual machine is what costs most.
    """
    cpus = os.sched_getaffinity(0)
    first = min(cpus)
    return {first}, cpus - {first} or cpus


def processor_time() -> tuple[float, float]:
    """(stolen by the machine beneath a virtual one, all): seconds since the start, of all cores."""
    fields = [float(field) for field in Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()[1:9]]
    ticks = os.sysconf("SC_CLK_TCK")
    return fields[7] / ticks, sum(fields) / ticks


def _cpu_info() -> str:
    return Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")


def _cpu_model() -> str:
    model = re.search(r"(?m)^model name\s*:\s*(.+)$", _cpu_info())
    return model.group(1).strip() if model else platform.machine()


def _cyclictest_version() -> str | None:
    if not has_cyclictest():
        return None
    answer = subprocess.run(["cyclictest", "--help"], capture_output=True, text=True, check=False)
    version = re.search(r"cyclictest V (\S+)", answer.stdout + answer.stderr)
    return version.group(1) if version else "unknown"
