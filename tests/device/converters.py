"""The mock's converters, compiled, and a simulation that goes from event to event: what the tests of both share.

The reference knows no ring of commands and no split of a sample: it sorts the instants at which something happens
(a sample is taken, a force changes) and lets the mass coast from one to the next, in thirty digits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mpmath as mp

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.device.mock import sampler
from hapsim.device.mock.sampler import CONVERTER
from tests.coasting import Coasting

T = 1e-3
DELAYS = [0.0, 0.37, 1.0, 1.5, 2.0]


@entry
def advance_body(how, body, converter, commands, n, h):
    sampler.advance_body(how, body, converter, commands, len(commands), 0, n, h)


@entry
def sample(body, converter, h):
    return sampler.sample(body, converter, h)


@entry
def sample_velocity(body, converter, h):
    return sampler.sample_velocity(body, converter, h)


@entry
def first_sample(body, converter):
    return sampler.first_sample(body, converter)


@entry
def to_counts(value, quantum):
    return sampler.to_counts(value, quantum)


def _act(mass: Coasting, force: Any, slope: Any = 0) -> None:
    mass.force, mass.slope = mp.mpf(force), mp.mpf(slope)


def _blow(mass: Coasting, force: Any) -> None:
    mass.v += force * mp.mpf(T) / mass.m


def _ramp(mass: Coasting, begin: Any, end: Any) -> None:
    _act(mass, begin, (mp.mpf(end) - begin) / mp.mpf(T))


def _blow_and_act(mass: Coasting, force: Any) -> None:
    _blow(mass, force * mp.mpf("0.4"))
    _act(mass, force * mp.mpf("0.6"))


Event = Callable[[Coasting, Sequence[float], int], None]

#: What a command n does, and how many samples after its delay.
EVENTS: dict[str, list[tuple[float, Event]]] = {
    "zoh": [(0.0, lambda mass, c, n: _act(mass, c[n]))],
    "impulse": [(0.0, lambda mass, c, n: _blow(mass, c[n]))],
    "ramp": [(0.0, lambda mass, c, n: _ramp(mass, c[n - 1] if n else 0, c[n]))],
    "straight": [(0.0, lambda mass, c, n: _ramp(mass, c[n], 2 * mp.mpf(c[n]) - (c[n - 1] if n else 0)))],
    "sawtooth": [(0.0, lambda mass, c, n: _ramp(mass, mp.mpf(3) * c[n] / 2, mp.mpf(c[n]) / 2))],
    "blow and level": [(0.0, lambda mass, c, n: _blow_and_act(mass, mp.mpf(c[n])))],
    "mean of two": [(0.0, lambda mass, c, n: _act(mass, (mp.mpf(c[n]) + (c[n - 1] if n else 0)) / 2))],
    "half as long": [(0.0, lambda mass, c, n: _act(mass, 2 * c[n])), (0.5, lambda mass, _c, _n: _act(mass, 0))],
    "two blows": [
        (0.0, lambda mass, c, n: _blow(mass, c[n] / 4)),
        (0.5, lambda mass, c, n: _blow(mass, mp.mpf(3) * c[n] / 4)),
    ],
}


#: Over how many sample periods a sampling is the mean.
WINDOWS = {"ideal": 0.0, "average": 1.0, "the last half": 0.5, "the last third": 1 / 3}


def event_by_event(
    hold: str, sampling: str, delay: float, m: float, b: float, x: float, v: float, commands: Sequence[float]
) -> tuple[list[float], list[float]]:
    """Returns the positions (m) and velocities (m/s) measured at the end of samples 0, 1, …; command n changes the
    force `delay` samples after n began."""
    with mp.workdps(30):
        T_, samples, acts, window = mp.mpf(T), len(commands), EVENTS[hold], mp.mpf(WINDOWS[sampling])
        events = [(mp.mpf(n + 1), 0, n) for n in range(samples)]
        events += [(n + 1 - window, 1, n) for n in range(samples)]
        events += [(n + mp.mpf(delay) + late, 2 + i, n) for n in range(samples) for i, (late, _) in enumerate(acts)]
        mass = Coasting(m, b, mp.mpf(x), mp.mpf(v))
        clock, positions, velocities, before = mp.mpf(0), [], [], mass.x
        for at, kind, n in sorted(events):
            mass.coast((at - clock) * T_)
            clock = at
            if kind == 0:
                positions.append(float(mass.travel / (window * T_) if window else mass.x))
                velocities.append(float((mass.x - before) / (window * T_) if window else mass.v))
            elif kind == 1:
                mass.travel, before = mp.mpf(0), mass.x
            else:
                acts[kind - 2][1](mass, commands, n)
        return positions, velocities


def converter_of(**fields: float) -> Any:
    converter = new_record(CONVERTER)
    converter.period, converter.quantum = T, 1e-9
    for name, value in fields.items():
        converter[name] = value
    return converter
