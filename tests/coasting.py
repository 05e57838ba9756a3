"""A real mass that coasts exactly from one event to the next: the referee of mock and theory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mpmath as mp


@dataclass
class Coasting:
    """One mass in continuous time, by the solution of m x'' + b x' = F; F is constant or a ramp."""

    m: Any
    b: Any
    x: mp.mpf
    v: mp.mpf
    force: Any = 0
    travel: Any = 0  # integral of x
    slope: Any = 0

    def coast(self, t: mp.mpf) -> None:
        force, slope = self.force, self.slope
        self.force += slope * t
        if self.b == 0:
            a, grows = force / self.m, slope / self.m
            self.travel += self.x * t + self.v * t**2 / 2 + a * t**3 / 6 + grows * t**4 / 24
            self.x += self.v * t + a * t**2 / 2 + grows * t**3 / 6
            self.v += a * t + grows * t**2 / 2
            return
        rate, grows = mp.mpf(self.b) / self.m, slope / self.b
        final = force / self.b - grows / rate
        gone = (1 - mp.exp(-rate * t)) / rate
        self.travel += self.x * t + final * t**2 / 2 + grows * t**3 / 6 + (self.v - final) * (t - gone) / rate
        self.x += final * t + grows * t**2 / 2 + (self.v - final) * gone
        self.v = final + grows * t + (self.v - final) * mp.exp(-rate * t)
