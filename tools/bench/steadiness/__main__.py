"""Speed and jitter of hapsim's loop, next to a C loop, the same loop in Python, and cyclictest.

    tools/bench/loop [--rounds 5] [--seconds 5] [--quick] [--only PART ...]
                     [--json FILE] [--data FILE.csv] [--picture FILE] [--from FILE.json]

compute    cost of an exchange, decode to encode, without a wire: C loop, compiled loop
exchanges  exchanges per second over a pseudo-terminal, the mock in a process of its own, in lockstep: C loop, compiled
           loop, portable loop; idle, beside a busy Python thread, beside one that collects garbage
wakeups    wake-up latency of a program that sleeps on a grid of 1 to 10 kHz: C loop, compiled loop, cyclictest;
           ordinary scheduling, SCHED_FIFO
late       forces too late for a device that keeps its own 1 kHz: C loop, compiled loop, portable loop

The loads run in the loop's own process; for the C loop, which has no Python, in another one. The peers take turns.
Their forces are compared first, byte for byte. `--seconds` is the duration of each measurement, twice that for a late
one. `--from` draws and prints the results saved by `--json`.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NoReturn

from hapsim.chart.figure import require_writable
from hapsim.errors import HapsimError, UsageError
from steadiness.agreement import require_agreement
from steadiness.bench import Bench
from steadiness.machine import awake, describe_machine, may_use_fifo, processor_time
from steadiness.parts import PARTS, Effort, measure_round
from steadiness.picture import draw
from steadiness.processes import PeerError
from steadiness.record import C, Records
from steadiness.reference import build_reference
from steadiness.report import load_json, print_report, save_csv, save_json

_QUICK = Effort(rounds=1, seconds=0.5, late_seconds=1.0, exchanges=1_000_000, rates_hz=(1000, 10_000))


def main() -> int:
    arguments = _arguments()
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _leave)
    try:
        _require_writable(arguments)
        about, records = load_json(arguments.kept) if arguments.kept else _measure(arguments)
    except (PeerError, HapsimError, OSError) as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, UsageError | OSError) else 1
    if not records.all:
        print("Nothing was measured to its end.", file=sys.stderr)
        return 130
    print_report(about, records)
    if arguments.json:
        save_json(about, records, arguments.json)
    if arguments.data:
        save_csv(records, arguments.data)
    if arguments.picture:
        draw(records, arguments.picture)
    return 0


def _measure(arguments: argparse.Namespace) -> tuple[dict[str, Any], Records]:
    effort = _effort(arguments)
    records = Records()
    fifo = may_use_fifo()
    with tempfile.TemporaryDirectory(prefix="hapsim-bench-") as place, awake() as power:
        program, compiler = build_reference(Path(place))
        bench = Bench(Path(place), program)
        about = {"machine": describe_machine(compiler), "rounds": effort.rounds, "seconds": effort.seconds}
        if program is None:
            bench.leave_out(C, compiler)
        agreed = require_agreement(bench)
        before = processor_time()
        _measure_rounds(bench, arguments.only, effort, fifo, records)
        about["conditions"] = [*agreed, *_conditions(bench, power, fifo), *_stolen(before)]
    return about, records


def _measure_rounds(bench: Bench, parts: list[str], effort: Effort, fifo: bool, records: Records) -> None:
    """Ctrl-C ends it; what was measured until then is reported."""
    begin = time.monotonic()
    for number in range(effort.rounds):
        try:
            measure_round(bench, number, parts, effort, fifo, records)
        except KeyboardInterrupt:
            bench.log("interrupted: here is what there is")
            return
        left = (effort.rounds - number - 1) * (time.monotonic() - begin) / (number + 1)
        bench.log(f"    {left / 60.0:.0f} min to go")


def _conditions(bench: Bench, power: str, fifo: bool) -> list[str]:
    permitted = "SCHED_FIFO at the same priority" if fifo else "SCHED_FIFO is not permitted here and not measured"
    return [
        f"{power}; a timer slack of 1 ns; no memory locked",
        f"wake-ups: clock_nanosleep to an absolute time, the sleeper on processor {bench.cpu}; {permitted}",
        "against the device: ordinary scheduling; "
        f"the device on processor {_numbers(bench.device_cpus)}, the loop and its load on {_numbers(bench.loop_cpus)}",
        *bench.without.values(),
    ]


def _numbers(cpus: set[int]) -> str:
    return ", ".join(str(cpu) for cpu in sorted(cpus))


def _stolen(before: tuple[float, float]) -> list[str]:
    stolen, every = (now - then for now, then in zip(processor_time(), before, strict=True))
    return [f"of the processors' time {100.0 * stolen / every:.1f} % went to other machines on the same host"]


def _effort(arguments: argparse.Namespace) -> Effort:
    if arguments.quick:
        return _QUICK
    return Effort(arguments.rounds, arguments.seconds, 2.0 * arguments.seconds, 5_000_000, (1000, 2000, 4000, 10_000))


def _require_writable(arguments: argparse.Namespace) -> None:
    require_writable(arguments.picture)
    require_writable(arguments.data, (".csv",))
    require_writable(arguments.json, (".json",))


def _leave(_number: int, _frame: object) -> NoReturn:
    """Ends as Ctrl-C would before the first round: through every with-block, so that no process stays behind."""
    raise SystemExit(130)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        "tools/bench/loop", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--quick", action="store_true", help="one short round: whether it works, no figures")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every number, and what it was measured on")
    parser.add_argument("--data", type=Path, metavar="FILE.csv", help="every number")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    parser.add_argument("--from", dest="kept", type=Path, metavar="FILE.json", help="measure nothing")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
