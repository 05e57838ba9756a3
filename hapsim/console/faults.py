"""What `hapsim faults` shows: the kinds there are, and what a wire with faults did."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table

from hapsim.errors import RunError
from hapsim.faults import KINDS, Injector

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


def show_faults(out: Console, injector: Injector, unread_bytes: int) -> None:
    """What passed, what was done to it, and what reached the device."""
    table = Table("", "frames in", "frames out", "bytes in", "bytes out", title="What passed", title_justify="left")
    for way, name in _WAYS.items():
        traffic = injector.passed[way]
        table.add_row(name, *map(str, (traffic.frames_in, traffic.frames_out, traffic.bytes_in, traffic.bytes_out)))
    out.print(table)
    if unread_bytes:
        out.print(f"{unread_bytes} bytes of the device were fetched by no host.")
    table = Table("fault", "times", title="What was done to it", title_justify="left")
    for kind, count in injector.counts:
        table.add_row(kind, str(count))
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


def faults_document(name: str, injector: Injector, unread_bytes: int, failure: RunError | None) -> dict[str, Any]:
    """The same for JSON, and how it failed, where it did."""
    witness, release = injector.witness, injector.witness.release()
    return {
        "port": name,
        **{_WAYS[way].replace(" the", "").replace(" ", "_"): asdict(injector.passed[way]) for way in _WAYS},
        "unread_bytes": unread_bytes,
        "faults": [{"kind": kind, "times": count} for kind, count in injector.counts],
        "samples": injector.samples + 1,
        "forces": _forces(witness.all),
        "forces_since_fault": _forces(witness.since_fault),
        "release": None if release is None else asdict(release),
    } | ({} if failure is None else {"error": str(failure), "exit_status": failure.exit_status})


def _forces(forces: Any) -> dict[str, Any]:
    return {"count": forces.count, "largest_N": forces.largest, "largest_change_N": forces.largest_change}
