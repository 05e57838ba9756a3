"""Least and largest stiffness and damping that hands on several ports feel over all phases of their clocks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.one_thread import one_thread
from hapsim.theory import Network
from hapsim.theory.arrays import Floats
from hapsim.theory.network.felt import Tie, continuous_tie, felt_pair, tie_of
from hapsim.theory.network.phases import Phases, extremes
from hapsim.theory.sample import several_clocks


class OverPhases(NamedTuple):
    """Least and largest k and b that the n hands of a part feel over all phases of their clocks; NaN if there are none
    at some phase."""

    k: tuple[Floats, Floats]
    """N/m, (n, n) each; off the diagonal, what one hand feels of another is negative."""
    b: tuple[Floats, Floats]
    """N·s/m, (n, n) each."""
    tie: tuple[Tie, Tie] | None
    """One spring and damper between two hands that nothing else holds, and how they move together; None for others."""
    desired_tie: Tie | None
    """The same without sampling, hold and delay."""
    reason: str
    """Reason why there are no k and b at some phase; "" if there are."""


@np.errstate(all="ignore")
def over_phases(network: Network, most: float) -> OverPhases:
    """Returns what the hands of a part feel over all phases of their clocks. ``most``: as of ``felt_pair``."""
    ports, count, reasons = several_clocks(network), network.channel_mass.size, set[str]()
    desired = continuous_tie(network)

    def values(at: Phases) -> Floats:
        """k, b and the tie, one after the other."""
        change = ports.change(at)
        if not np.isfinite(change).all():
            return np.full(2 * count**2 + 3, np.nan)
        eigen = np.linalg.eig(change)
        pair = felt_pair(network, eigen, most, at)
        reasons.update([pair.reason] if pair.reason else [])
        tie = tie_of(network, eigen, at) if desired else Tie(*[np.nan] * 3)
        return np.concatenate([pair.k.ravel(), pair.b.ravel(), np.array(tie)])

    with one_thread():
        least, largest = extremes(network, values)
    ends = [(*end[:-3].reshape(2, count, count), Tie(*end[-3:].tolist())) for end in (least, largest)]
    k, b, tie = zip(*ends, strict=True)
    return OverPhases(k, b, tie if desired else None, desired, "; ".join(sorted(reasons)))
