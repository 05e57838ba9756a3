"""Digital words: the armed format with them, every bit out, and where one is wired to an input, when it comes back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from hapsim.bringup.probe.probing import Probing, Sample, Session

_EACH = 4  # samples for which each output is on
_ALL_ON_S = 0.5  # for an eye
_LEDS = (
    "LEDs, a meter or a scope at the outputs: each was on for 4 samples, then all for half a second; all are off now"
)
_WIRE_ONE = "the outputs themselves; or wire one to an input: this step then sees when it acts"


def probe_words(probing: Probing) -> None:
    """Always goes on."""
    device = probing.device
    if not device.has_words:
        probing.leave_out("words", f"no digital words (register {schema.REG_SENSORS}, bit 2)")
        return
    session = probing.arm_by_device("words", device.max_watchdog_samples, parts=schema.WITH_WORDS)
    if session is None:
        return
    sent: dict[int, int] = {}
    walk = [1 << bit for bit in range(32) for _ in range(_EACH)]
    walk += [0] * _EACH + [0xFFFFFFFF] * probing.samples_in(_ALL_ON_S, _EACH, 4000) + [0] * _EACH

    def answer(sample: Sample) -> None:
        word = walk[min(sample.n, len(walk) - 1)]
        sent[sample.n] = word
        session.force(sample.n, [0] * device.channels + [word - (word >> 31 << 32)])

    going = session.run(len(walk), answer)
    # Each force is taken, whatever its word.
    probing.judge_taken("words", session, going, [one for one in session.others if one.kind in schema.POSITIONS])
    _judge_looped(probing, session, sent)


def _judge_looped(probing: Probing, session: Session, sent: dict[int, int]) -> None:
    """Looks for an input that follows an output, by one sample as it has to, or by another number of them."""
    for late in (1, 0, 2, 3):
        rows = [(sent[s.n - late], s.counts[-1]) for s in session.samples if s.fresh and s.n - late in sent]
        pairs = _equal_pairs(*(np.array(each, np.int64) for each in zip(*rows, strict=True))) if rows else []
        if pairs:
            named = "output {} in input {}".format(*pairs[0]) + f" and {len(pairs) - 1} more" * (len(pairs) > 1)
            probing.judge("words_looped", late == 1, f"{named}: {late} after the position that the FORCE answers")
            return
    probing.not_seen("words_looped", f"no input follows an output. See {_LEDS}", _WIRE_ONE)


def _equal_pairs(outputs: NDArray[np.int64], inputs: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Returns the pairs of an output and an input that are equal in all samples, and not always off or on."""
    out, seen = (each[:, None] >> np.arange(32) & 1 for each in (outputs, inputs))
    both, on, seen_on = out.T @ seen, out.sum(0), seen.sum(0)
    equal = (both == on[:, None]) & (both == seen_on) & (on[:, None] > _EACH) & (on[:, None] < len(out))
    return [(int(o), int(i)) for o, i in np.argwhere(equal)]
