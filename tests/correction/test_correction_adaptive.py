"""A hand of unknown and changing mass: estimated while it runs, and never across the stability boundary."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hapsim import run, start
from hapsim.loop.adaptive import SLEW_S
from hapsim.measuring.measure_trace import measure_trace
from hapsim.prediction.correction import CORRECTIONS, rendered
from hapsim.prediction.correction.element import schedule_for
from hapsim.prediction.correction.kind import predictor_for
from hapsim.running import Excitation, Session
from hapsim.scene import Scene
from hapsim.theory import Configuration
from tests import one_hand, thorough

LEAST, MOST, RATE = 0.1, 0.4, 1000.0


def gripped(stiffness: float, damping: float, *, mass: float = LEAST, **mock: Any) -> Scene:
    """A hand of this true mass on a spring, which the scene knows to have between LEAST and MOST."""
    device = {"mass": {"from": LEAST, "to": MOST}, "correction": "adaptive", "force_limit": 1000.0}
    own = {"initial": {"velocity": 0.1}, "mass": mass} | mock
    return one_hand.scene_of({"touch": one_hand.touch(stiffness, damping)}, device=device, mock=own)


@pytest.mark.parametrize("mass", [0.1, 0.15, 0.4])
def test_once_settled_the_hand_feels_the_values_of_the_scene(mass: float) -> None:
    """Pushes every tenth of a second reveal the mass; the second half of the run is identified."""
    scene = gripped(5000.0, 20.0, mass=mass)
    pushes = Excitation(0, 5.0, 4, 100, start=0, first=True)
    trace = run(scene, duration=4.0, excitation=pushes)
    assert trace.report.estimated_mass_kg[0] == pytest.approx(mass, rel=2e-3)
    felt = measure_trace(trace.since(2000), mass, 0)
    assert felt.k == pytest.approx(5000.0, rel=2e-3)
    assert felt.b == pytest.approx(21.0, rel=5e-3)


def test_the_estimate_stays_where_nothing_moves() -> None:
    scene = gripped(5000.0, 60.0, mass=0.3, quantum=1e-6)
    traces = [run(scene, duration=duration) for duration in (0.5, 1.5)]
    assert np.ptp(traces[1].position_counts[500:]) <= 2
    (at_rest,), (later,) = (trace.report.estimated_mass_kg for trace in traces)
    assert LEAST < at_rest == later


SCENES = [(500.0, 2.0), (3000.0, 10.0), (9000.0, 40.0), (30000.0, 60.0)]


def schedules(count: int) -> list[tuple[tuple[float, float], tuple[tuple[float, float], ...]]]:
    """Springs, and when the hand grips and releases: seconds and kg, at random within 50 ms, three times."""
    random = np.random.default_rng(20)
    made = []
    for n in range(count):
        times = 0.01 + np.cumsum(random.uniform(0.005, 0.05, 6))
        masses = [MOST, LEAST] * 3 if n % 2 else random.uniform(LEAST, MOST, 6)
        made.append((SCENES[n % len(SCENES)], tuple(zip(times.tolist(), np.asarray(masses).tolist(), strict=True))))
    return made


POINTS = thorough.points(1, 3)


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("n", range(4 * POINTS))
def test_a_hand_that_grips_and_releases_never_swings_more_and_more(n: int) -> None:
    (stiffness, damping), grips = schedules(4 * POINTS)[n]
    scene = gripped(stiffness, damping, grips=grips)
    trace = run(scene, duration=0.6)
    assert largest_growth(trace.position[:, 0], grips) < 1.05
    assert not trace.report.limited_ticks


def largest_growth(x: NDArray[np.float64], grips: Any) -> float:
    """Returns the largest growth from one extreme to the next while the mass is constant. A mass added in motion keeps
    the speed and so adds energy."""
    events = [0, *(round(second * RATE) for second, _ in grips), len(x)]
    worst = 0.0
    floor = 1e-3 * np.abs(x).max()
    for begin, end in itertools.pairwise(events):
        piece = np.abs(x[begin + 1 : end])
        peaks = piece[1:-1][(piece[1:-1] >= piece[:-2]) & (piece[1:-1] >= piece[2:])]
        peaks = peaks[peaks > floor]
        if peaks.size > 1:
            worst = max(worst, float((peaks[1:] / peaks[:-1]).max()))
    return worst


@pytest.mark.parametrize("n", range(POINTS))
def test_the_force_follows_the_estimate_no_faster_than_stated(n: int) -> None:
    """At every sample it is that of a mass which differs from the last one's by no more than the slew allows: followed
    through the record, of all masses there are, while the hand grips and releases."""
    (stiffness, damping), grips = schedules(4 * POINTS)[4 * n + 1]
    scene = gripped(stiffness, damping, grips=grips)
    trace = run(scene, duration=0.4)
    (port,) = rendered(scene).ports
    elements = port.schedule.elements
    predictors = [predictor_for(replace(port.declared, mass=one.made_for), one.observer) for one in elements]
    K, B = (np.array([getattr(one, name) for one in elements]) for name in ("stiffness", "damping"))
    numbers = [np.array(column) for column in zip(*predictors, strict=True)][:5]
    rows, last = np.log(MOST / LEAST) / (len(elements) - 1), len(elements) - 1.0

    def at(log_mass: float, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Between the rows of a table."""
        row = min(max(log_mass / rows, 0.0), last)
        low = min(int(row), len(elements) - 2)
        return np.asarray(columns[low] * (1.0 - row + low) + columns[low + 1] * (row - low))

    y, f, asked = trace.position[:, 0], trace.force[:, 0], trace.asked_force[:, 0]
    slew = 1.0 / (SLEW_S * RATE)
    step, reading, gains, first, ahead = numbers
    mass, state, worst, heaviest = 0.0, np.array([y[0], 0.0, 0.0]), 0.0, 0.0
    for sample in range(1, y.size):
        forces = [f[sample - 1], f[sample - 2] if sample > 1 else 0.0]
        known = np.append(state, forces)
        off = y[sample] - at(mass, reading)[0] @ known
        correct = np.append(at(mass, first)[:, 0], 0.0) if sample == 1 else at(mass, gains)[:, 0]
        state = np.append(at(mass, step) @ known, state[2]) + correct * off
        known = np.append(state, forces)
        tried = np.clip(mass + np.linspace(-slew, slew, 33), 0.0, np.log(MOST / LEAST))
        answers = np.array([-at(one, K) * x - at(one, B) * v for one in tried for x, v in [at(one, ahead) @ known]])
        best = int(np.argmin(np.abs(answers - asked[sample])))
        worst = max(worst, abs(answers[best] - asked[sample]) - np.abs(np.diff(answers)).max())
        mass = float(tried[best])
        heaviest = max(heaviest, mass)
    assert worst < 1e-6 * np.abs(asked).max()
    assert heaviest > slew


def test_nothing_is_simulated_that_some_mass_of_the_span_makes_unstable() -> None:
    """Every (K, B) over the whole plane is stable for every mass of the span, whether the estimate is right or
    wrong."""
    random = np.random.default_rng(3)
    kind = CORRECTIONS["adaptive"]
    limited = 0
    for _ in range(6):
        declared = Configuration(mass=0.2, rate=RATE, friction=0.5, delay=float(random.choice([0.37, 1.0, 2.0])))
        k = declared.stiffness_unit * 10.0 ** random.uniform(-3.5, 0.3)
        b = 2.0 * random.uniform(0.1, 1.5) * np.sqrt(k * 0.2)
        schedule = schedule_for(declared, (LEAST, MOST), (float(k), float(b)))
        limited += schedule.safe < MOST
        for element in schedule.elements[::6]:
            for mass in np.geomspace(LEAST, MOST, 7):
                loop = kind.closed(
                    replace(declared, mass=float(mass)), replace(declared, mass=element.made_for), element.observer
                )
                assert abs(loop.poles(element.stiffness, element.damping)[0]) <= 1.0 + 1e-6
    assert 0 < limited < 6  # some are free, some are not


def test_a_contact_is_stable_for_every_mass_too() -> None:
    """A light device, released while it is pressed against a contact, with a force for a heavy hand."""
    declared = Configuration(mass=0.2, rate=RATE, friction=1.0)
    contact = (30000.0, 60.0)
    alone = schedule_for(declared, (LEAST, MOST), (3000.0, 11.0))
    beside = schedule_for(declared, (LEAST, MOST), (3000.0, 11.0), [contact])
    assert beside.safe < alone.safe
    kind = CORRECTIONS["adaptive"]
    for element in beside.elements[::6]:
        for mass in (LEAST, 0.15, MOST):
            loop = kind.closed(replace(declared, mass=mass), replace(declared, mass=element.made_for), element.observer)
            pole = loop.poles(element.stiffness + contact[0], element.damping + contact[1])[0]
            assert abs(pole) <= 1.0 + 1e-6


def test_another_spring_comes_without_a_step() -> None:
    """Live parameters pass through the correction, and its tables along the same ramp."""
    pushes = Excitation(0, 5.0, 4, 100, start=0, first=True)

    def change(session: Session) -> None:
        session.set({"touch": {"stiffness": 6000.0, "damping": 15.0}}, over=0.3)

    scene = gripped(3000.0, 10.0, mass=0.2)
    with start(scene, duration=2.0, excitation=pushes, on_arming=change) as session:
        session.wait()
    trace = session.trace
    assert trace.report.parameter_changes == 1
    assert trace.report.estimated_mass_kg[0] == pytest.approx(0.2, rel=5e-3)
    felt = measure_trace(trace.since(1200), 0.2, 0)
    assert felt.k == pytest.approx(6000.0, rel=2e-3)
    assert felt.b == pytest.approx(16.0, rel=1e-2)
    # From sample to sample the force changes no more than where it is the stiffer spring's from the beginning.
    unchanged = run(gripped(6000.0, 15.0, mass=0.2), duration=2.0, excitation=pushes)
    steps = [np.abs(np.diff(one.asked_force[3:, 0])).max() for one in (trace, unchanged)]
    assert steps[0] <= steps[1]
