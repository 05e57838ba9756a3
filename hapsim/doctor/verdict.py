"""What the measurements come to: with which rate this machine keeps up."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from hapsim.doctor import words
from hapsim.doctor.exchanges import MOCK, Exchanges

Answer = Literal["yes", "with gaps", "no", "no verdict"]

YES, WITH_GAPS = 0.999, 0.95

KEPT_BY_MOCK = 0.95  # of the rate: a mock that keeps less asks too little of the loop for any verdict

IN_TIME = {
    "device": "In time: the device had the force when it needed it, as it says itself.",
    "host": "In time: the loop woke up less than a period late, and its force answers the newest position, as the "
    "device says; a force that was never sent is a deadline miss.",
}
"""What it means, by clock."""

EXCHANGE = {
    "device": "An exchange lasts from a position's arrival until its force has left.",
    "host": "An exchange lasts from waking up for the tick until the position has arrived, the force sent in between.",
}
"""What is measured, by clock."""

ON_THE_MOCK = (
    "The rate is the mock's to keep, which runs on the same cores and wakes up late like any program; a device's "
    "own timer is not. Where it keeps less than 95 % of the rate, there is no verdict."
)
"""With clock: device."""


@dataclass(frozen=True)
class Verdict:
    """On one rate under one clock."""

    rate_hz: float
    clock: str
    where: str
    answer: Answer
    share_in_time: float | None
    """0 to 1; None where nothing was measured."""
    why: str = ""
    """Why there is no better answer, where more is known than the share."""

    @property
    def sentence(self) -> str:
        """4 kHz: yes, 99.98 % in time."""
        share = "" if self.share_in_time is None else f", {words.share(self.share_in_time)} in time"
        return f"{words.rate(self.rate_hz)}: {self.answer}{share}{f' ({self.why})' if self.why else ''}"


def answer_for(share_in_time: float | None) -> Answer:
    """Whether a rate is kept that has this share (0 to 1) of its forces in time.

    `yes` from 99.9 %: at 1 kHz at most one force a second is late. `with gaps` from 95 %: it runs, but every late force
    is a moment of twice the delay, delay eats damping, and a stiff scene that is stable on paper may hum. Below, `no`.
    libfranka's communication_test, for a robot at 1 kHz, warns below 95 % and calls a machine not sufficient below
    90 %. A robot's controller bridges a gap by extrapolating its commands; a force that is held goes on pushing: so
    its warning is our refusal.
    """
    if share_in_time is None:
        return "no verdict"
    return "yes" if share_in_time >= YES else "with gaps" if share_in_time >= WITH_GAPS else "no"


def verdict_on(exchanges: Exchanges) -> Verdict:
    """The verdict on one run. One that ended before its time is a no, whatever was in time until then."""
    share = exchanges.share_in_time
    answer = answer_for(share)
    why = exchanges.failure
    if why:
        answer = "no" if share is not None else "no verdict"
    elif share is not None and _mock_is_slow(exchanges):
        answer, why = (
            "no verdict",
            f"the mock itself kept only {words.share(exchanges.share_of_rate or 0.0)} of the rate",
        )
    return Verdict(exchanges.rate_hz, exchanges.clock, exchanges.where, answer, share, why)


def _mock_is_slow(exchanges: Exchanges) -> bool:
    kept = exchanges.share_of_rate
    return exchanges.where == MOCK and exchanges.clock == "device" and kept is not None and kept < KEPT_BY_MOCK


def best_rate(verdicts: Iterable[Verdict], clock: str) -> float | None:
    """The fastest rate (Hz) on the mock under `clock` that is a yes, with every slower one; None where none is."""
    best = None
    for verdict in sorted((v for v in verdicts if v.clock == clock and v.where == MOCK), key=lambda v: v.rate_hz):
        if verdict.answer != "yes":
            break
        best = verdict.rate_hz
    return best
