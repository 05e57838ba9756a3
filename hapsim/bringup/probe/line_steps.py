"""Lines: the armed format with them, and what is refused; with the user's permission, how the handle moves along them.

The host answers one kept sample again and again while the handle coasts away from it. So it knows the line's force at
each position, however late its frames are, and the positions' second differences show how much of it acts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from firmware_protocol import schema
from firmware_protocol.lines import Lines, line_counts, pack_line
from hapsim.bringup.probe.probing import LONG_LIFE, Probing, Sample, in_words
from hapsim.bringup.probe.pushing import STEP, Pusher, TravelledError

_REFUSED, _SPARE = 8, 8  # frames; samples by which a kept one is younger than it might be
_PUSHED, _SETTLES = 4, 8  # samples of a push; samples until a line acts alone, whose frame may be late
_OF_KEPT = 4  # both are at most this part of the reports that the device keeps
_SHARE, _PART = 0.8, 0.5  # of the force that is allowed
_BESIDE_FRICTION = ("line_stiffness", "line_bounds")
_WITHIN = 0.3  # of the response
_OFTEN = 0.3  # of 1/T: faster motion does not show in the samples


def probe_lines(probing: Probing) -> None:
    """Always goes on."""
    device = probing.device
    if (lines := device.lines) is None:
        probing.leave_out("lines", f"no lines are followed (register {schema.REG_SENSORS}, bit 3)")
        return
    session = probing.arm_by_device("lines", device.max_watchdog_samples, parts=schema.WITH_LINE)
    if session is None:
        return
    going = session.run(lines.kept + 2 * _SPARE, session.zero)
    last = in_words(session.ended) if session.ended else "nothing else"
    wrong = [one for one in session.others if one.wire.parts != schema.WITH_LINE]
    found = f"{len(session.samples)} positions; {in_words(wrong[0]) if wrong else last}"
    if not probing.judge("lines", going and not wrong, found):
        probing.wire.release()
        return
    crossed = [0] * device.channels + [*pack_line(0, 0, 1, 0)] * device.channels
    for _ in range(_REFUSED):
        session.wire.send(session.wire.frame(schema.FORCE, session.samples[-1].n, LONG_LIFE, crossed, armed=True))
        session.run(1, session.zero)
        session.wire.send(session.wire.frame(schema.FORCE, session.samples[-1].n - lines.kept, LONG_LIFE, armed=True))
        session.run(1, session.zero)
        session.force(session.samples[-1].n - lines.kept + _SPARE)
    if session.disarm() is None:
        return
    read = probing.wire.register
    accepted, rejected, expired = read(schema.REG_ACCEPTED), read(schema.REG_REJECTED), read(schema.REG_EXPIRED)
    kept = rejected is not None and _REFUSED <= rejected <= _REFUSED + 2
    probing.judge("line_rejected", kept, f"register 9: {rejected}; {_REFUSED} were sent with low above high")
    found = f"register 11: {expired}, register 8: {accepted}; {_REFUSED} answered a sample that is not kept, "
    late = (expired or 0) - _REFUSED
    kept = 0 <= late <= 3 and accepted == session.sent - late
    probing.judge("line_kept", kept, f"{found}{session.sent} others were sent")


@dataclass(frozen=True)
class _Line:
    """A line in SI units, of the pushed channel. `repeats`: its frame is sent for each sample, not once."""

    force: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    bound: float = math.inf
    repeats: bool = True

    def at(self, moved: float, velocity: float) -> float:
        """Returns the force (N) at a distance (m) from the kept sample, as the law is; after a miss if sent once."""
        u = self.force - (self.stiffness if self.repeats else max(self.stiffness, 0.0)) * moved
        if abs(u) >= self.bound:
            return math.copysign(self.bound, u)
        return min(max(u - self.damping * velocity, -self.bound), self.bound)


class _LinePusher(Pusher):
    """Pushes along lines, within the user's permission."""

    def send(self, sample: Sample, number: int, line: _Line, lives: int) -> None:
        """Sends a line that answers sample `number`, with a time to live in samples. Raises TravelledError, and sends
        no force, if the device is too far away."""
        self.push(sample, 0.0)  # looks at the travel
        lines, channel, channels = self.lines, self.leave.channel, self.device.channels
        bound = min(line.bound, self.leave.force)
        *counts, _ = line_counts(line.stiffness, line.damping, -bound, bound, lines.scales(channel), self.limit)
        words = [0] * (3 * channels)
        words[channel] = math.trunc(line.force / self.force_scale)
        words[channels + 2 * channel : channels + 2 * channel + 2] = pack_line(*counts)
        self.session.force(number, words, lives)

    @property
    def lines(self) -> Lines:
        """The board that follows them, as the device describes it."""
        assert self.device.lines is not None
        return self.device.lines


def probe_line_pushing(probing: Probing) -> None:
    """Always goes on."""
    leave, response, lines = probing.leave, probing.response, probing.device.lines
    names = ("line_stiffness", "line_damping", "line_bounds", "line_missed")
    if leave is None or response is None or lines is None:
        probing.not_seen(names, "no lines are followed" if lines is None else "see sign")
        return
    session = probing.arm_by_device(STEP, min(probing.device.max_watchdog_samples, 500), parts=schema.WITH_LINE)
    if session is None:
        return
    pusher = _LinePusher(probing, session, replace(leave, pair=()))
    hold = lines.kept - min(_SPARE, lines.kept // _OF_KEPT)
    speed = leave.travel / 8 / probing.periods(hold)
    force = min(_SHARE * min(leave.force, pusher.limit), speed / (abs(response) * probing.periods(_PUSHED)))
    far = abs(response) * force * probing.periods(_PUSHED) * probing.periods(hold)
    most_k, most_b = lines.scales(leave.channel)[2:]
    often = _OFTEN * probing.device.rate_hz
    allowed = _SHARE * min(leave.force, pusher.limit)
    k = min(allowed / far, most_k, often**2 / abs(response))
    b = min(3.0 / probing.periods(hold) / abs(response), most_b, often / abs(response))
    phases = {
        "line_stiffness": _Line(stiffness=k),
        "line_damping": _Line(damping=b),
        "line_bounds": _Line(force=allowed, bound=_PART * allowed),
        "line_missed": _Line(force=_PART * allowed, stiffness=-k, repeats=False),
    }
    try:
        for name, line in phases.items():
            _judge_phase(probing, pusher, name, line, force, hold)
    except TravelledError as error:
        probing.not_seen(names, str(error))
    finally:
        session.disarm()


def _judge_phase(probing: Probing, pusher: _LinePusher, name: str, line: _Line, force: float, hold: int) -> None:
    """Pushes to either side, then lets the handle move along a line; judges how much of the line's force acts."""
    session, response, units = pusher.session, probing.response, pusher.units
    assert response is not None
    period, rows = probing.periods(1), list[tuple[float, float, float]]()
    settles = min(_SETTLES, pusher.lines.kept // _OF_KEPT)
    for side in (1.0, -1.0, 1.0, -1.0):
        if not pusher.settle():
            probing.not_seen(name, pusher.why_stopped())
            return
        pusher.begin_here()
        own = replace(line, force=side * line.force)
        for _ in range(_PUSHED):
            pusher.send(session.samples[-1], session.samples[-1].n, _Line(force=side * force, bound=force), _SETTLES)
            session.run(1, None)
        kept = session.samples[-1]
        pusher.send(kept, kept.n, own, hold)
        again = (lambda sample: pusher.send(sample, kept.n, own, hold)) if own.repeats else None  # noqa: B023
        session.run(hold, again)
        _brake(pusher)
        places = {n: pusher.position(one) for n, one in pusher.samples_from(kept.n).items()}
        for n in range(kept.n + settles, kept.n + hold - 1):
            if all(one in places for one in (n - 1, n, n + 1)):
                before, here, after = (places[one] for one in (n - 1, n, n + 1))
                velocity = (after - before) / (2.0 * period)
                acts = own.at(here - places[kept.n], velocity)
                rows.append((after - 2.0 * here + before, acts * period**2, velocity * period**2))
    _judge_share(probing, name, rows, response, f"{units(force, 'N', '.3g')} before it")


def _brake(pusher: _LinePusher) -> None:
    """Lets damping end the motion."""
    most = pusher.lines.scales(pusher.leave.channel)[3]
    pusher.session.run(50, lambda sample: pusher.send(sample, sample.n, _Line(damping=most / 8.0), _SETTLES))


def _judge_share(
    probing: Probing, name: str, rows: list[tuple[float, float, float]], response: float, pushes: str
) -> None:
    """Judges the share of a line's force in the motion. The device's own friction is regressed beside it where it
    hides nothing."""
    table = np.array(rows)
    if len(table) < 20:
        probing.not_seen(name, f"only {len(table)} samples in a row came")
        return
    bend, columns = table[:, 0], table[:, 1:] if name in _BESIDE_FRICTION else table[:, 1:2]
    found, *_ = np.linalg.lstsq(columns, bend, rcond=None)
    spread = np.std(bend - columns @ found) / max(float(np.linalg.norm(columns[:, 0])), 1e-300)
    share, unsure = found[0] / response, 3.0 * spread / abs(response)
    words = f"{share:.3g} times the line's force acts (± {100 * unsure:.2g} %), from {len(table)} samples, {pushes}"
    kept = abs(share - 1.0) <= _WITHIN + unsure
    if kept and unsure > _WITHIN:
        probing.not_seen(name, f"{words}: a greater --push or --travel shows more")
    else:
        probing.judge(name, kept, words)
