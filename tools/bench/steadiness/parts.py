"""The four comparisons. In each round every peer has its turn, in another order each time: a machine that slows down
slows all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from steadiness.bench import Bench, numbers_of
from steadiness.mock import mock_device
from steadiness.processes import PeerError
from steadiness.record import (
    BUSY,
    COMPILED,
    CYCLICTEST,
    FIFO,
    GARBAGE,
    NO_LOAD,
    ORDINARY,
    PORTABLE,
    C,
    Case,
    Records,
)

COMPUTE, EXCHANGES, WAKEUPS, LATE = "compute", "exchanges", "wakeups", "late"
PARTS = (COMPUTE, EXCHANGES, WAKEUPS, LATE)

Numbers = dict[str, float | None]


@dataclass(frozen=True)
class Effort:
    """Size of a measurement."""

    rounds: int
    seconds: float
    late_seconds: float
    exchanges: int
    rates_hz: tuple[int, ...]


def measure_round(bench: Bench, number: int, parts: list[str], effort: Effort, fifo: bool, records: Records) -> None:
    """One round of every part that was asked for."""
    for part in parts:
        for case, peer, measure in _turns(bench, part, effort, fifo, number):
            setting = ", ".join(str(s) for s in (case.load, case.rate_hz or "", case.scheduling) if s)
            bench.log(f"round {number + 1} of {effort.rounds}, {part}: {peer} ({setting})")
            try:
                records.add(case, number, peer, measure())
            except PeerError as error:
                # One that fails under a load is no reason to throw away an hour's figures.
                bench.log(f"    failed, and has no figure in this round: {error}")


def _turns(
    bench: Bench, part: str, effort: Effort, fifo: bool, number: int
) -> Iterator[tuple[Case, str, Callable[[], Numbers]]]:
    for case in _CASES[part](effort, fifo):
        peers = bench.peers(*_PEERS[part])
        first = number % len(peers)
        for peer in peers[first:] + peers[:first]:
            yield case, peer, lambda case=case, peer=peer: _MEASURES[part](bench, case, peer, effort)


def _compute(bench: Bench, _case: Case, peer: str, effort: Effort) -> Numbers:
    return {"ns_per_exchange": bench.compute(peer, effort.exchanges)["ns_per_exchange"]}


def _on_device(clock: str) -> Callable[[Bench, Case, str, Effort], Numbers]:
    def measure(bench: Bench, case: Case, peer: str, effort: Effort) -> Numbers:
        seconds = effort.seconds if clock == "lockstep" else effort.late_seconds
        with mock_device(bench.scenes[clock], bench.device_cpus) as port:
            return numbers_of(bench.run(peer, clock, port, case.load, seconds=seconds))

    return measure


def _wakeups(bench: Bench, case: Case, peer: str, effort: Effort) -> Numbers:
    return dict(bench.lateness(peer, case.rate_hz, effort.seconds, case.scheduling == FIFO))


_CASES: dict[str, Callable[[Effort, bool], list[Case]]] = {
    COMPUTE: lambda _effort, _fifo: [Case(COMPUTE)],
    EXCHANGES: lambda _effort, _fifo: [Case(EXCHANGES, load) for load in (NO_LOAD, BUSY, GARBAGE)],
    WAKEUPS: lambda effort, fifo: [
        Case(WAKEUPS, rate_hz=rate, scheduling=scheduling)
        for scheduling in ((ORDINARY, FIFO) if fifo else (ORDINARY,))
        for rate in effort.rates_hz
    ],
    LATE: lambda _effort, _fifo: [Case(LATE, load, 1000) for load in (NO_LOAD, GARBAGE)],
}
_PEERS = {
    COMPUTE: (C, COMPILED),
    EXCHANGES: (C, COMPILED, PORTABLE),
    WAKEUPS: (C, COMPILED, CYCLICTEST),
    LATE: (C, COMPILED, PORTABLE),
}
_MEASURES: dict[str, Callable[[Bench, Case, str, Effort], Numbers]] = {
    COMPUTE: _compute,
    EXCHANGES: _on_device("lockstep"),
    WAKEUPS: _wakeups,
    LATE: _on_device("device"),
}
