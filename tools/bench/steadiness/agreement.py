"""Comparison before any measurement: the C loop has to send the same bytes as hapsim."""

from __future__ import annotations

from steadiness.bench import Bench
from steadiness.mock import mock_device
from steadiness.processes import PeerError
from steadiness.record import COMPILED, NO_LOAD, PORTABLE, C

_EXCHANGES = 3 * 4096 + 17
_TICKS = 20_000
_AMPLITUDES = (0.004, 0.008)  # m: the second one is cut to the force's limit now and then


def require_agreement(bench: Bench) -> list[str]:
    """Runs every peer once, which compiles what is not yet compiled. Raises PeerError where two of them differ. Which
    loops were compared, in sentences."""
    for amplitude in _AMPLITUDES:
        bench.log(f"the same answers in memory, {1e3 * amplitude:g} mm?")
        answers = {peer: bench.compute(peer, _EXCHANGES, amplitude) for peer in bench.peers(C, COMPILED)}
        for what in ("frames_crc32", "answers_crc32", "limited"):
            _require_one(f"in memory, {1e3 * amplitude:g} mm, {what}", {p: t[what] for p, t in answers.items()})
    answers = {}
    for peer in bench.peers(C, COMPILED, PORTABLE):
        bench.log(f"the same forces against the same device? {peer}")
        with mock_device(bench.scenes["lockstep"], bench.device_cpus) as port:
            answers[peer] = bench.run(peer, "lockstep", port, NO_LOAD, ticks=_TICKS)
    for what in ("forces_crc32", "positions_crc32", "ticks"):
        _require_one(f"on a port, {what}", {p: t[what] for p, t in answers.items()})
    return [
        f"{', '.join(bench.peers(C, COMPILED))}: the same answers to {_EXCHANGES} positions in memory, byte for byte",
        f"{', '.join(answers)}: the same {_TICKS} forces in virtual time against the mock",
    ]


def _require_one(what: str, values: dict[str, object]) -> None:
    if len(set(values.values())) > 1:
        raise PeerError(f"{what}: the peers do not do the same job: {values}")
