"""Every fault of the wire, with every clock, on every carrier: the forces that the hand got, and the message.

    tools/bench/faults [--only KIND] [--carrier memory|terminal|firmware] [--clock device|host|lockstep]
    tools/bench/faults --resume | --from FILE

A cell is one run of a hand that a spring pulls, at 1 kHz, over a wire with one fault that begins after 700 samples.
Carriers: `memory`, the mock in virtual time; `terminal`, the mock behind `hapsim faults` in real time; `firmware`, the
reference firmware's Linux build behind it. The injector records the forces on the device's side of the fault. The
firmware also logs the forces that it puts out.

A cell is a defect if a program does not end, or ends with a traceback or status 1. A force above the limit is one, and
so is a larger step from the force that the device holds than the slew limit allows. So is a message that reports a
release that the device did not confirm.
"""

from __future__ import annotations

import argparse
import fcntl
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "tools" / "bench" / "results" / "faults.json"
PAGE = ROOT / "tools" / "bench" / "faults.md"
LIMIT_N, STEP_N, BEGIN, DURATION_S = 10.0, 10.0, 700, 1.5  # the step: of slew_limit, in a sample
LONGER_S = {"rate": 4.0}  # its guard wants a second of samples
TRIES = 3
PATIENCE_S = 60.0  # beyond the run's own time: then it hangs
FIRMWARE_FORCE_SCALE_N = 1e-8
REPORT = r"\. The last frames and the last second are in .*? reads it\)"  # of a file that goes with this bench
CONFIRMED = "the device confirmed that it released it"
ABBREVIATED = {
    f"the force is zero: {CONFIRMED}$": "*released*",
    "hapsim tried to disarm it, but the device did not confirm .*power it off$": "*not confirmed*",
}
"""Ends of messages, as the page has them."""

SCENE = """\
version: 1
rate: 1000
device: {{clock: {clock}, mass: 0.2, friction: 1.0, stiffness: 1000, delay: 1, force_limit: 10,
  slew_limit: 10000}}
modules:
  hand:  {{type: device, channel: 0}}
  wall:  {{type: ground, position: 0.004}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 3}}
"""
_MANY = f"after_samples: {BEGIN}, probability"
CASES = {
    "drop 20 %": [f"kind: drop, {_MANY}: 0.2"],
    "drop all positions": [f"kind: drop, direction: from_device, {_MANY}: 1"],
    "drop all forces": [f"kind: drop, direction: to_device, {_MANY}: 1"],
    "corrupt 20 %, 3 bits": [f"kind: corrupt, bits: 3, {_MANY}: 0.2"],
    "corrupt all, 1 bit": [f"kind: corrupt, {_MANY}: 1"],
    "duplicate 50 %": [f"kind: duplicate, {_MANY}: 0.5"],
    "delay 3 ms, 10 %": [f"kind: delay, seconds: 0.003, {_MANY}: 0.1"],
    "delay 0.4 s, once": [f"kind: delay, seconds: 0.4, after_samples: {BEGIN}, for_samples: 1"],
    "reorder 30 %": [f"kind: reorder, {_MANY}: 0.3"],
    "garbage 300 bytes every 10": [
        f"kind: garbage, bytes: 300, every_samples: 10, direction: both, after_samples: {BEGIN}"
    ],
    "garbage 100 000 bytes": [f"kind: garbage, bytes: 100000, direction: both, after_samples: {BEGIN}"],
    "wrong_baud 0.5, 100 samples": [f"kind: wrong_baud, ratio: 0.5, after_samples: {BEGIN}, for: 0.1"],
    "wrong_baud 2, for good": [f"kind: wrong_baud, ratio: 2, after_samples: {BEGIN}"],
    "wrong_baud 0.5, from the start": ["kind: wrong_baud, ratio: 0.5"],
    "half_frame from the device": [f"kind: half_frame, after_samples: {BEGIN}"],
    "half_frame to the device": [f"kind: half_frame, direction: to_device, after_samples: {BEGIN}"],
    "silence 10 ms": [f"kind: silence, direction: both, after_samples: {BEGIN}, for: 0.01"],
    "silence 0.1 s": [f"kind: silence, direction: both, after_samples: {BEGIN}, for: 0.1"],
    "silence both ways": [f"kind: silence, direction: both, after_samples: {BEGIN}"],
    "silence from the start": ["kind: silence, direction: both, at: 0"],
    "unplug": [f"kind: unplug, after_samples: {BEGIN}"],
    "replug after 0.1 s": [f"kind: unplug, after_samples: {BEGIN}", f"kind: replug, after_samples: {BEGIN + 100}"],
    "reboot": [f"kind: reboot, after_samples: {BEGIN}"],
    "reboot within 0.1 s": [f"kind: reboot, seconds: 0.1, after_samples: {BEGIN}"],
    "version": ["kind: version"],
    **{
        f"nonsense {register} {what}": [f"kind: nonsense, register: {register}, what: {what}"]
        for register, all_of_it in {
            "rate": ("nan", "zero", "negative", "huge"),
            "position_scale": ("nan", "zero", "negative", "huge"),
            "force_scale": ("nan", "zero", "negative", "huge"),
            "force_limit": ("nan", "zero", "negative", "huge"),
            "velocity_scale": ("nan", "huge"),
            "channels": ("zero", "negative", "huge"),
            "pacings": ("zero", "negative"),
            "max_watchdog": ("zero", "negative", "huge"),
            "schema": ("zero",),
        }.items()
        for what in all_of_it
    },
    "rate 0.5": [f"kind: rate, factor: 0.5, after_samples: {BEGIN}"],
    "rate 2": [f"kind: rate, factor: 2, after_samples: {BEGIN}"],
    "leap 0.1 m": [f"kind: leap, metres: 0.1, after_samples: {BEGIN}"],
    "leap 4 mm": [f"kind: leap, metres: 0.004, after_samples: {BEGIN}"],
    "leap to the end of the counts": [f"kind: leap, counts: 2147483647, after_samples: {BEGIN}"],
    "freeze": [f"kind: freeze, after_samples: {BEGIN}"],
    "refresh every 100 ms": [f"kind: refresh, every_samples: 100, after_samples: {BEGIN}"],
    "invert positions": [f"kind: invert, after_samples: {BEGIN}"],
    "invert forces": [f"kind: invert, direction: to_device, after_samples: {BEGIN}"],
}
CARRIERS = {"memory": ("lockstep",), "terminal": ("device", "host", "lockstep"), "firmware": ("device", "host")}
BEHIND_THE_GUARD = {"invert forces", "reorder 30 %", "rate 2"}
"""Cases that cause steps which the host did not send: another sign, another order, every second force."""
BEFORE_ARMING = {"version": {"memory", "terminal"}, "nonsense": {"memory", "terminal"}}
"""Kinds that end before a clock matters, and the carriers that run them, each with its first clock."""


def kind_of(case: str) -> str:
    return case.partition(" ")[0]


def duration_of(case: str) -> float:
    """Duration of a case's run, s."""
    return LONGER_S.get(kind_of(case), DURATION_S)


def script_of(case: str) -> str:
    return "\n".join(["version: 1", "seed: 1", "faults:", *(f"  - {{{fault}}}" for fault in CASES[case])]) + "\n"


def in_memory(case: str) -> dict[str, Any]:
    """Returns the report of a run in this process, as `hapsim run` and `hapsim faults` would print it."""
    import hapsim
    from hapsim.bringup.faults import Injector, parse_script
    from hapsim.bringup.faults.in_memory import in_memory as between_of
    from hapsim.cli.faults import faults_document
    from hapsim.errors import HapsimError

    scene = hapsim.parse_scene(SCENE.format(clock="lockstep"))
    no_delays: Any = SimpleNamespace(count=0, p50=None, p99=None)  # there is no relay
    injector = Injector(parse_script(script_of(case)))
    report: dict[str, Any] = {"exit_status": 0, "error": ""}
    try:
        trace = hapsim.run(scene, duration=duration_of(case), between=between_of(injector, scene.period))
        report["ticks"] = trace.report.ticks
        report["released"] = trace.report.released
    except HapsimError as error:
        report |= {"exit_status": error.exit_status, "error": str(error)}
    return {"run": report, "wire": faults_document("", injector, 0, no_delays, None)}


def finished(process: subprocess.Popen[str], within_s: float) -> tuple[str, str, bool]:
    """Returns (standard output, standard error, whether it had to be killed)."""
    try:
        out, err = process.communicate(timeout=within_s)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
        return out, err, True
    return out, err, False


def started(*words: object) -> subprocess.Popen[str]:
    command = [sys.executable, *map(str, words)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with suppress(PermissionError):  # before other programs, where that is granted: a device waits for none
        os.setpriority(os.PRIO_PROCESS, process.pid, -15)
    return process


@contextmanager
def device_of(carrier: str, scene: Path, log: Path) -> Iterator[list[str]]:
    """Yields the options of `hapsim faults` that lead to the device."""
    if carrier == "terminal":
        yield ["--scene", str(scene)]
        return
    board = ROOT / "firmware_protocol" / "firmware" / "board"
    with subprocess.Popen([board, "linux", log], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield ["--port", process.stdout.readline().strip()]
        finally:
            process.terminate()


def on_terminal(case: str, clock: str, carrier: str) -> dict[str, Any]:
    """Returns the report of a run of `hapsim run` through `hapsim faults`, each in its own process."""
    with tempfile.TemporaryDirectory() as folder:
        scene, script, port, log = (Path(folder) / name for name in ("scene.yaml", "script.yaml", "port", "log"))
        scene.write_text(SCENE.format(clock=clock), "utf-8")
        script.write_text(script_of(case), "utf-8")
        with device_of(carrier, scene, log) as options:
            relay = started("-m", "hapsim", "faults", script, *options, "--path", port, "--json")
            give_up = time.monotonic() + PATIENCE_S
            while not port.is_symlink() and relay.poll() is None and time.monotonic() < give_up:
                time.sleep(0.01)
            run = started(
                "-m",
                "hapsim",
                "run",
                scene,
                "--port",
                port,
                "--duration",
                duration_of(case),
                "--reports",
                folder,
                "--json",
            )
            out, err, hung = finished(run, duration_of(case) + PATIENCE_S)
            time.sleep(0.3)  # for a watchdog that ends meanwhile
            relay.send_signal(signal.SIGINT)
            wire_out, wire_err, wire_hung = finished(relay, PATIENCE_S)
        out, err, wire_out, wire_err = (without_paths(text, folder) for text in (out, err, wire_out, wire_err))
        report = json.loads(out) if out.strip() else {}
        report |= {"exit_status": run.returncode, "error": report.get("error", ""), "err": err, "hung": hung}
        wire = json.loads(wire_out) if wire_out.strip() else {}
        wire |= {"err": wire_err, "hung": wire_hung}
        return {"run": report, "wire": wire, "put_out": put_out(log)}


def without_paths(text: str, folder: str) -> str:
    """Returns a program's output without this machine's paths."""
    return re.sub(REPORT, "", text).replace(f"{folder}/", "")


def put_out(log: Path) -> dict[str, float] | None:
    """Returns the largest force in the firmware's log, and its largest change."""
    if not log.exists():
        return None
    lines = [line.split() for line in log.read_text("ascii").splitlines(keepends=True) if line.endswith("\n")]
    forces = [int.from_bytes(bytes.fromhex(words[1]), signed=True) * FIRMWARE_FORCE_SCALE_N for words in lines]
    if not forces:
        return None
    steps = [abs(after - before) for before, after in itertools.pairwise(forces)]
    return {"largest_N": max(map(abs, forces)), "largest_change_N": max(steps, default=0.0), "last_N": forces[-1]}


def cell(case: str, clock: str, carrier: str) -> dict[str, Any]:
    """Returns the results of a run in which the fault happened. A delay of the machine may end a run before that."""
    for _ in range(TRIES):
        found = tried(case, clock, carrier)
        if found["defects"] or happened(found):
            break
    return found


def happened(found: dict[str, Any]) -> bool:
    return any(fault["times"] for fault in found["wire"].get("faults", []))


def tried(case: str, clock: str, carrier: str) -> dict[str, Any]:
    """Returns the results of one run."""
    if carrier == "memory":
        process = started(__file__, "--in-memory", case)
        out, err, hung = finished(process, PATIENCE_S)
        found = (
            json.loads(out) if out.strip() else {"run": {"exit_status": process.returncode, "error": ""}, "wire": {}}
        )
        found["run"] |= {"err": err, "hung": hung}
    else:
        found = on_terminal(case, clock, carrier)
    found = {"case": case, "kind": kind_of(case), "clock": clock, "carrier": carrier} | found
    found["defects"] = defects_of(found)
    return found


def defects_of(found: dict[str, Any]) -> list[str]:
    """Returns the defects of a case."""
    run, wire = found["run"], found["wire"]
    release, forces = wire.get("release"), wire.get("forces") or {}
    largest, change = forces.get("largest_N") or 0.0, forces.get("largest_change_N") or 0.0
    confirmed = run.get("released") or CONFIRMED in run["error"]
    status, sentence = run["exit_status"], run["error"]
    wrong = {
        "it did not end": run.get("hung") or wire.get("hung"),
        "a traceback": "Traceback" in run.get("err", "") + wire.get("err", ""),
        "status 1, or an unknown status": status not in (0, 2, 3, 4),
        "a failure without a message": status != 0 and not sentence,
        f"a force above {LIMIT_N:g} N": largest > LIMIT_N * (1 + 1e-9),
        f"a step above {STEP_N:g} N": change > STEP_N * (1 + 1e-9) and found["case"] not in BEHIND_THE_GUARD,
        f"the device put out more than {LIMIT_N:g} N": (found.get("put_out") or {}).get("largest_N", 0.0) > LIMIT_N,
        "the message reports a confirmed release, which the device did not confirm": confirmed
        and release is not None
        and not release["confirmed"],
        "the device still pushes at the end": (found.get("put_out") or {}).get("last_N", 0.0) != 0.0,
    }
    return [what for what, is_so in wrong.items() if is_so]


def row(found: dict[str, Any]) -> str:
    run, wire = found["run"], found["wire"]
    since, release, out = wire.get("forces_since_fault") or {}, wire.get("release"), found.get("put_out")
    zero = "–"
    if release is not None:
        zero = f"{1e3 * release['after_last_force_s']:.3g} ms ({release['by']})"
    largest = _newtons(since.get("largest_N"), since.get("count"))
    change = _newtons(since.get("largest_change_N"), since.get("count"))
    if out is not None:
        largest += f" / {out['largest_N']:.3g}"
        change += f" / {out['largest_change_N']:.3g}"
    sentence = run["error"].partition(": ")[2] or (
        f"done, {run.get('ticks')} ticks" if not run["error"] else run["error"]
    )
    message = sentence.replace("|", "\\|").replace("\n", " ")
    for end, short in ABBREVIATED.items():
        message = re.sub(end, short, message)
    flag = "".join(f" **{defect}**" for defect in found["defects"])
    times = ", ".join(str(fault["times"]) for fault in wire.get("faults", []))
    return (
        f"| {found['case']} | {found['clock']} | {found['carrier']} | {times} | {largest} | {change} | {zero} | "
        f"{run['exit_status']} | {message}{flag} |"
    )


def _newtons(force: float | None, count: int | None) -> str:
    return "none" if not count or force is None else f"{force:.3g}"


HEAD = """\
# Faults of the wire

`tools/bench/faults` runs a scene over a wire with one fault, for every fault, clock and carrier.
The table is of {when}.

In the scene a spring of 2000 N/m pulls the hand at 1 kHz. A spring of 1000 N/m in the device pulls it back, so the
force is 2.7 N at rest. The firmware's mass has no such spring, and oscillates. The force limit is 10 N, and the slew
limit allows steps of 10 N. The fault begins after {begin} samples, or with the first byte.

* **carrier**: *memory* is the mock in virtual time. *terminal* is the mock in real time behind `hapsim faults`.
  *firmware* is the Linux build of the reference firmware behind `hapsim faults`.
* **times**: how often each fault of the case happened.
* **largest, N**: the largest force that reached the device after the first fault.
* **change, N**: the largest difference of such a force from the force that the device held. The held force is zero
  once its time to live is over.
* A value after a stroke is that of the force that the firmware put out over the whole run, its release included.
* **zero force**: the time from the last force that reached the device to zero force, and its cause. *disarm* is the
  host's DISARM, *device* the device itself, *time to live* the one that PROTOCOL.md promises. *lockstep* is the
  limit of 10 s for that clock, whose time stands still while the host is quiet.
* **status**: the exit status of `hapsim run`.
* **message**: the message of `hapsim run`. Two ends of a message are abbreviated:
  * *released*: "the force is zero: the device confirmed that it released it".
  * *not confirmed*: "hapsim tried to disarm it, but the device did not confirm that it released its force: one that
    keeps PROTOCOL.md, section 7, does so by itself …. If it still pushes, power it off". The dots stand for the time
    after the last force: 22 ms or 101 ms with the clock *device*, 101 ms with *host*, 10 s with *lockstep*.

Three cases cause steps that the host did not send. `invert forces` changes the sign, and `reorder` the order. With
`rate 2` the host sees the device at twice its rate, and only every second force reaches the device.

A row is a defect in these cases:

* a program does not end, or ends with a traceback or status 1;
* a force exceeds the limit, or a step exceeds the slew limit in any but these three cases;
* a message reports a release that the device did not confirm;
* the firmware still puts out a force at the end.

{verdict}

| fault | clock | carrier | times | largest, N | change, N | zero force | status | message |
|---|---|---|---:|---:|---:|---|---:|---|
"""


def write_page(cells: list[dict[str, Any]], when: str) -> None:
    wrong = sum(bool(found["defects"]) for found in cells)
    verdict = f"Of {len(cells)} rows {wrong or 'none'} {'is a defect' if wrong in (0, 1) else 'are defects'}."
    if len(cells) < len(every_cell()):
        verdict += f" {len(every_cell()) - len(cells)} were not run (`--resume` runs them)."
    head = HEAD.format(when=when, begin=BEGIN, verdict=verdict)
    PAGE.write_text(head + "".join(row(found) + "\n" for found in cells), "utf-8")


def kept_cells() -> dict[tuple[str, str, str], dict[str, Any]]:
    cells = json.loads(RESULTS.read_text("utf-8"))["cells"] if RESULTS.exists() else []
    return {(found["case"], found["clock"], found["carrier"]): found for found in cells}


def keep(found: dict[str, Any]) -> None:
    """Saves a cell among the results, in their order. Another process may do the same at the same time."""
    with open(RESULTS.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        kept = kept_cells() | {(found["case"], found["clock"], found["carrier"]): found}
        cells = [kept[key] for key in every_cell() if key in kept]
        when = time.strftime("%Y-%m-%d", time.gmtime())
        RESULTS.write_text(json.dumps({"when": when, "cells": cells}, indent=1) + "\n", "utf-8")
        write_page(cells, when)
    RESULTS.with_suffix(".lock").unlink(missing_ok=True)


def every_cell() -> list[tuple[str, str, str]]:
    """Returns (case, clock, carrier) of every cell."""
    return [
        (case, clock, carrier)
        for case in CASES
        for carrier, clocks in CARRIERS.items()
        if carrier in BEFORE_ARMING.get(kind_of(case), CARRIERS)
        for clock in (clocks[:1] if kind_of(case) in BEFORE_ARMING else clocks)
    ]


def asked_for(options: argparse.Namespace) -> list[tuple[str, str, str]]:
    return [
        (case, clock, carrier)
        for case, clock, carrier in every_cell()
        if options.only in (None, kind_of(case), case)
        and options.carrier in (None, carrier)
        and options.clock in (None, clock)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/faults", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", metavar="KIND", help="run only this kind, or this case")
    parser.add_argument("--carrier", choices=CARRIERS)
    parser.add_argument("--clock", choices=("device", "host", "lockstep"))
    parser.add_argument("--from", dest="source", type=Path, help="write the page from saved results")
    parser.add_argument("--resume", action="store_true", help="run only the cells without results")
    parser.add_argument("--in-memory", metavar="CASE", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.in_memory:
        print(json.dumps(in_memory(options.in_memory)))
        return
    if options.source:
        kept = json.loads(options.source.read_text("utf-8"))
        for found in kept["cells"]:
            found["defects"] = defects_of(found)
        write_page(kept["cells"], kept["when"])
        return
    wanted = asked_for(options)
    if not wanted:
        raise SystemExit(
            f"--only {options.only}: no such kind; there are {', '.join(dict.fromkeys(map(kind_of, CASES)))}"
        )
    before = kept_cells() if options.resume else {}
    cells = []
    for number, (case, clock, carrier) in enumerate(wanted):
        if (case, clock, carrier) in before:
            continue
        cells.append(cell(case, clock, carrier))
        print(f"{number + 1}/{len(wanted)} {row(cells[-1])}", flush=True)
        if cells[-1]["defects"] or happened(cells[-1]):
            keep(cells[-1])
    wrong = [found for found in cells if found["defects"]]
    print(f"{len(cells)} cells, {len(wrong)} defects")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    os.environ.setdefault("COLUMNS", "200")
    main()
