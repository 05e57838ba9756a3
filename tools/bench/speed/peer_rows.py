"""The peers on the strings of the chart: where their modes ring, once; what it costs, round by round."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from hapsim.speed_accuracy.objects import MODES, RingingString
from hapsim.speed_accuracy.results import Row
from speed.peers import every_peer
from speed.peers.c_network import CNetwork
from speed.peers.c_stencil import CStencil
from speed.peers.faust_mi import FaustMi
from speed.peers.peer import Peer
from speed.peers.scipy_ivp import SciPy


class PeerRows:
    """Peers by strings by rates. A peer that chooses its own steps runs at the lowest and the highest rate only."""

    def __init__(self, strings: Sequence[RingingString], rates: Sequence[float], log: Callable[[str], None]) -> None:
        self._rows: list[tuple[Peer, RingingString, Row]] = []
        self._costs: list[list[float]] = []
        self.skipped: list[str] = []
        for peer in _taking_part():
            if why := peer.available():
                self.skipped.append(f"{peer.name} is skipped: {why}")
                continue
            at = sorted({min(rates), max(rates)}) if isinstance(peer, SciPy) else rates
            for one in strings:
                for rate in at:
                    log(f"{peer.name}, {one.title}, {rate:g} Hz")
                    self._rows.append((peer, one, _row(peer, one, rate)))
                    self._costs.append([])

    def round(self, log: Callable[[str], None]) -> None:
        """Times everybody once who rings somewhere."""
        for (peer, one, row), costs in zip(self._rows, self._costs, strict=True):
            if math.isfinite(row.error):
                log(f"timing {peer.name}, {one.title}, {row.rate_hz:g} Hz")
                costs.extend(peer.cost(one.string, row.rate_hz, 1))

    def rows(self) -> list[Row]:
        """Returns the rows with the costs so far."""
        return [replace(row, costs=tuple(costs)) for (_, _, row), costs in zip(self._rows, self._costs, strict=True)]


def _taking_part() -> list[Peer]:
    """Returns the participants, with a hand if they support one; the C programs with ordinary compiler options."""
    others = [peer for peer in every_peer() if not isinstance(peer, CStencil | CNetwork | FaustMi)]
    return [CStencil(hand=True, plain=True), CNetwork(plain=True), FaustMi(hand=True), *others]


def _row(peer: Peer, one: RingingString, rate: float) -> Row:
    found = peer.frequencies(one.string, rate, MODES)
    errors = [frequency / one.string.frequency(mode) - 1.0 for mode, frequency in zip(MODES, found, strict=True)]
    bad = not all(math.isfinite(error) for error in errors)
    error = math.nan if bad else max(errors, key=abs)
    gave_up = bad and peer.preparation_s is None and peer.note
    note = peer.note if gave_up or not bad else "unstable"
    return Row(one.name, peer.name, "", peer.precision, rate, one.quantities[0], error, (), note)
