"""Ticks with a correction, without a device: to time them. What the loop does around them is in exchange.py."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.records import new_record
from hapsim.compiling import entry
from hapsim.compiling.native import address_of
from hapsim.cordis.program import Program
from hapsim.cordis.tick import tick
from hapsim.loop.exchange import LOOP
from hapsim.loop.predictor import call_add, call_predict


class CorrectedTicks:
    """A program before a loop's `predictor`, which whoever has the correction fills in `record`, a LOOP."""

    def __init__(self, program: Program, channels: int) -> None:
        self._program = program
        self.record: Any = new_record(LOOP)
        self.record.io.address = address_of(self.record.io)
        self.record.io.channels = channels

    def ticks(self, measured: NDArray[np.float64], samples: int) -> None:
        """So many samples, each with the next of the hands' positions (rows, channels), in m, over and over."""
        _ticks(self.record.predictor, self.record.io, self._program.record, measured, samples)


@entry
def _ticks(predictor, io, program, measured, samples):
    for n in range(samples):
        row = n % measured.shape[0]
        for c in range(io.channels):
            io.measured[c] = measured[row, c]
        call_predict(predictor.predict, (predictor.address, io.address, 1, 0, 1))
        tick(program, io.measured, io.velocity, io.asked)
        if predictor.add != 0:
            call_add(predictor.add, (predictor.address, io.address))
