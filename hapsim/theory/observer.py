"""Observer of a mass as a stage of the loop: links answer the state in which the mass will receive their force.

``correction.py`` derives the numbers of an ``interface.StatePredictor``. Here its equations stand once, on rows
(``rows.py``), for a single hand and for the hands of a network.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.interface import STATES, StatePredictor
from hapsim.theory.rows import Rows, stack, times


class Observers:
    """Predictors of C channels of these masses (C,), kg, in metres, sample periods and T²/m f. On rows their state is
    the positions (C), the velocities (C) and the pushes (C); forces stand by age, C each."""

    def __init__(self, predictors: Sequence[StatePredictor], mass: Floats, rate: float) -> None:
        self.channels, self.lags = len(predictors), max(one.lags for one in predictors)
        units, width = np.stack([mass**0, rate * mass**0, mass * rate**2]), STATES + self.lags
        columns = units[np.minimum(np.arange(width), 2)]

        def rows(name: str) -> Floats:
            """Returns a matrix of all predictors in the units of rows."""
            every = [getattr(one, name) for one in predictors]
            out = np.zeros((len(every[0]), width, len(every)))
            for c, one in enumerate(every):
                out[:, : one.shape[1], c] = one
            return out * columns / units[: len(out), None]

        self._moves, self._reading, self._ahead = rows("step"), rows("reading"), rows("ahead")
        self._moves -= np.eye(2, width)[:, :, None]
        self.readings = len(self._reading)
        self._gains = np.stack([one.gains for one in predictors], 2) / units[:, None] * units[None, : self.readings]

    def _of(self, weights: Floats, every: Rows) -> Rows:
        """Returns the sum of state and forces with their weights (3 + lags, C)."""
        count = self.channels
        if isinstance(every, np.ndarray):
            return np.einsum("ic,icn->cn", weights, every[: count * len(weights)].reshape(len(weights), count, -1))
        return sum(times(one, every[i * count : (i + 1) * count]) for i, one in enumerate(weights))

    def ahead(self, state: Rows, held: Rows) -> tuple[Rows, Rows]:
        """Returns the positions and velocities ahead, (C) each. ``held``: forces before the sample's own."""
        every = stack([state, held])
        return self._of(self._ahead[0], every), self._of(self._ahead[1], every)

    def change(self, state: Rows, forces: Rows, read: Sequence[Rows]) -> Rows:
        """Returns the change of the state until the next sample, after its readings ``read`` (R, of C each).
        ``forces``: the sample's own, and those before."""
        every = stack([state, forces])
        off = [one - self._of(weights, every) for one, weights in zip(read, self._reading, strict=True)]
        moved = [*(self._of(weights, every) for weights in self._moves), 0.0 * read[0]]
        for i, gains in enumerate(self._gains):
            for gain, one in zip(gains, off, strict=True):
                moved[i] = moved[i] + times(gain, one)
        return stack(moved)
