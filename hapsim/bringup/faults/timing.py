"""When a fault happens: in seconds since the first byte, or in samples of the device, so that virtual time does too."""

from __future__ import annotations

import math

from hapsim.bringup.faults.piece import Moment, tidy


class Window:
    """From when, and for how long, a fault is there. It opens once."""

    def __init__(
        self,
        begins_s: float | None = None,
        begins_sample: int | None = None,
        lasts_s: float | None = None,
        lasts_samples: int | None = None,
    ) -> None:
        """Without a beginning it opens with the first byte, without an end it never closes."""
        self.begins_s = 0.0 if begins_s is None and begins_sample is None else begins_s
        if self.begins_s is not None:
            self.begins_s = tidy(self.begins_s)
        """s since the first byte; None: in samples."""
        self.begins_sample = begins_sample
        """So many samples of the device; None: in seconds."""
        self._lasts_s, self._lasts_samples = lasts_s, lasts_samples
        self.opened: Moment | None = None
        """When it opened; None: not yet."""

    def is_open(self, now: Moment) -> bool:
        """Whether the fault is there now."""
        if self.opened is None and self._has_begun(now):
            self.opened = now
        return self.opened is not None and not self.is_over(now)

    def is_over(self, now: Moment) -> bool:
        """Whether the fault was there, and is no more."""
        if self.opened is None:
            return False
        over_s = self._lasts_s is not None and now.seconds >= tidy(self.opened.seconds + self._lasts_s)
        over_samples = self._lasts_samples is not None and now.samples >= self.opened.samples + self._lasts_samples
        return over_s or over_samples

    def next_s(self, now: Moment) -> float:
        """When time alone opens or closes it, s since the first byte; infinite where it does not."""
        if self.opened is None:
            return math.inf if self.begins_s is None else self.begins_s
        if self._lasts_s is None or self.is_over(now):
            return math.inf
        return tidy(self.opened.seconds + self._lasts_s)

    def _has_begun(self, now: Moment) -> bool:
        if self.begins_s is not None:
            return now.seconds >= self.begins_s
        return self.begins_sample is not None and now.samples >= self.begins_sample
