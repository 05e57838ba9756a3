"""What `hapsim faults` shows: the kinds there are, and what a wire with faults did."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table

from hapsim.bringup.faults import KINDS, Injector
from hapsim.bringup.faults.passing import PassingTimes
from hapsim.errors import RunError

_WAYS = {True: "to the device", False: "from the device"}


def show_kinds(out: Console, scripts: Sequence[str]) -> None:
    """Every kind of fault with its sentence."""
    table = Table("kind", "what happens", title="Faults", title_justify="left")
    for kind, fault in KINDS.items():
        table.add_row(kind, fault.told)
    out.print(table)
    out.print(f"Scripts that ship: {', '.join(scripts)}.")


def kinds_document(scripts: Sequence[str]) -> dict[str, Any]:
    """The same for JSON."""
    return {"kinds": {kind: fault.told for kind, fault in KINDS.items()}, "scripts": list(scripts)}


def passing_on(injector: Injector) -> str:
    """What passed until now, for a live line."""
    frames = sum(traffic.frames_in for traffic in injector.passed.values())
    return f"passing on: {frames} frames, {sum(count for _, count in injector.counts)} faults · Ctrl-C ends it"


def show_faults(out: Console, injector: Injector, unread_bytes: int, passing: PassingTimes) -> None:
    """What passed, how long that took, what was done to it, and what reached the device."""
    table = Table("", "frames in", "frames out", "bytes in", "bytes out", title="What passed", title_justify="left")
    for way, name in _WAYS.items():
        traffic = injector.passed[way]
        table.add_row(name, *map(str, (traffic.frames_in, traffic.frames_out, traffic.bytes_in, traffic.bytes_out)))
    out.print(table)
    if unread_bytes:
        out.print(f"{unread_bytes} bytes of the device were fetched by no host.")
    if passing.count:
        median, most = (f"{1e3 * (passing.quantile_s(share) or 0.0):.2g} ms" for share in (0.5, 0.99))
        out.print(
            f"Passing a frame on took {median} in the median, and at most {most} for 99 % of them, beside what a fault "
            "held up."
        )
    out.print("What was done to it", style="italic")  # not as a title, which breaks where the table is narrow
    table = Table("", "fault", "when", "how often")
    for fault in injector.happened:
        table.add_row(str(fault.place), fault.kind, fault.when, f"{fault.times} {fault.counted}")
    out.print(table)
    for sentence in _of_the_device(injector):
        out.print(sentence)


def _of_the_device(injector: Injector) -> list[str]:
    witness = injector.witness
    if not witness.all.count:
        return ["No force reached the device."]
    told = [
        f"{witness.all.count} forces reached the device, at most {_newtons(witness.all.largest)}, from one to the next "
        f"at most {_newtons(witness.all.largest_change)}."
    ]
    since = witness.since_fault
    if since.count:
        told.append(
            f"Since the first fault {since.count} of them, at most {_newtons(since.largest)}, from one to the next at "
            f"most {_newtons(since.largest_change)}."
        )
    release = witness.release()
    if release is not None:
        how = {
            "disarm": "by the host's DISARM",
            "device": "by the device itself",
            "time to live": "when its time to live was over, where the device keeps PROTOCOL.md, section 6",
            "lockstep": "when the simulated device has heard nothing for so long (PROTOCOL.md, section 7)",
        }[release.by]
        told.append(f"The last one ended after {1e3 * release.after_last_force_s:.3g} ms, {how}.")
    return told


def _newtons(force: float) -> str:
    return "a force of unknown scale" if math.isnan(force) else f"{force:.4g} N"


def faults_document(
    name: str, injector: Injector, unread_bytes: int, passing: PassingTimes, failure: RunError | None
) -> dict[str, Any]:
    """The same for JSON, and how it failed, where it did."""
    witness, release = injector.witness, injector.witness.release()
    return {
        "port": name,
        **{_WAYS[way].replace(" the", "").replace(" ", "_"): asdict(injector.passed[way]) for way in _WAYS},
        "unread_bytes": unread_bytes,
        "passed_on": {"frames": passing.count, "p50_s": passing.quantile_s(0.5), "p99_s": passing.quantile_s(0.99)},
        "faults": [fault._asdict() for fault in injector.happened],
        "samples": injector.samples + 1,
        "forces": _forces(witness.all),
        "forces_since_fault": _forces(witness.since_fault),
        "release": None if release is None else asdict(release),
    } | ({} if failure is None else {"error": str(failure), "exit_status": failure.exit_status})


def _forces(forces: Any) -> dict[str, Any]:
    return {"count": forces.count, "largest_N": forces.largest, "largest_change_N": forces.largest_change}
