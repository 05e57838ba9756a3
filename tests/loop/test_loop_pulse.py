"""Pulses reach the device as asked, within every limit, and their energy comes out of the tank of changes."""

from __future__ import annotations

import contextlib
import math
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hapsim.errors import GuardError, UsageError
from hapsim.recording.trace import Trace
from hapsim.replaying.replay import Record, compare
from hapsim.running import start
from hapsim.running.pulse_shapes import Pulse
from hapsim.running.session import Session
from hapsim.scene import Scene
from tests import one_hand, thorough

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools" / "bench"))

from changes import Ticking
from energy_guard import passive_scenes, unstable_scenes

BEGIN, LIMIT = 20, 10.0
Act = Callable[[Session, int], None]


def hand_on_a_spring(stiffness: float = 0.0, friction_of_mock: float = 1.0, **device: Any) -> Scene:
    """A hand that moves towards the wall, with nothing but a spring of this stiffness on it."""
    touch = {"type": "spring", "between": ["hand", "wall"], "stiffness": stiffness}
    mock = {"initial": {"velocity": 0.1}, "friction": friction_of_mock}
    return one_hand.scene_of({"touch": touch}, device={"force_limit": LIMIT} | device, mock=mock)


def pulsed(scene: Scene, seconds: float, act: Act, **options: Any) -> tuple[Trace, Session]:
    """Runs a scene in virtual time; `act` is called before each sample with its number."""
    sessions: list[Session] = []

    def tick(_frame: int) -> None:
        if sessions and not sessions[0]._over.is_set():
            act(sessions[0], int(sessions[0]._loop.state.ticks))

    options = {"judges_energy": True, "on_arming": sessions.append} | options
    with start(scene, duration=seconds, between=lambda device: Ticking(device, tick), **options) as session:
        session.wait()
    return session.trace, session


def begin(session: Session, *pulse: Any) -> None:
    """Begins a pulse in the sample that comes next. `Session.pulse` would wait for it in this thread, the loop's."""
    session._live.pulse(Pulse(*pulse))


def once(*pulse: Any, at: int = BEGIN) -> Act:
    return lambda session, sample: begin(session, *pulse) if sample == at else None


def expected(shape: str, force: float, count: int, periods: float = 0.0) -> NDArray[np.float64]:
    """Forces of a pulse, once more from its formula, N."""
    s = (np.arange(count) + 0.5) / count
    if shape == "click":
        return force * np.sin(np.pi * s)
    if shape == "knock":
        return force * (np.exp(-5.0 * s) - np.exp(-5.0)) / (1.0 - np.exp(-5.0))
    edge = np.clip(np.minimum(s, 1.0 - s) * max(periods, 2.0), 0.0, 1.0)
    return force * (3.0 * edge**2 - 2.0 * edge**3) * np.sin(2.0 * np.pi * periods * s)


@pytest.mark.parametrize("pulse", [("click", 3.0, 0.01), ("knock", -5.0, 0.03), ("buzz", 2.0, 0.1, 12.0)])
def test_a_pulse_has_its_shape_and_impulse_to_the_count(pulse: tuple[Any, ...]) -> None:
    trace, session = pulsed(hand_on_a_spring(), 0.3, once(0, *pulse))
    scale = float(session._loop.record.io.force_scale[0])
    shape, force, seconds, *periods = pulse
    counts = np.rint(expected(shape, force, round(1000 * seconds), *periods) / scale)
    sent = np.rint(trace.force[:, 0] / scale)
    begin = int(sent.nonzero()[0][0])
    assert begin == BEGIN
    assert sent[begin : begin + counts.size].tolist() == counts.tolist()
    assert sent.sum() == counts.sum()
    assert not trace.asked_force.any()  # it is not the scene's own force


def test_the_tank_pays_for_the_work_of_a_pulse_on_the_hand() -> None:
    trace, session = pulsed(hand_on_a_spring(200.0), 0.5, once(0, "buzz", 4.0, 0.2, 5.0))
    record = session._loop.record
    scale = float(record.io.force_scale[0])
    step = np.diff(trace.position[:, 0])
    caused = (trace.force - trace.asked_force)[:-2, 0]  # acts a sample late
    work = float(np.sum(caused * step[1:]))
    rounding = scale * float(np.abs(step).sum())
    assert abs(work) > 10.0 * rounding
    assert float(record.pulses.spent) == pytest.approx(work, abs=rounding)
    assert float(record.tank.spent) == 0.0


def test_an_empty_tank_lowers_a_pulse_for_the_rest_of_its_time() -> None:
    trace, session = pulsed(hand_on_a_spring(energy_limit=0.01), 1.0, once(0, "click", 5.0, 0.4))
    record, sent = session._loop.record, trace.force[:, 0]
    given = float(record.pulses.spent)
    assert 0.005 < given < 0.01 + 0.001 * 1.0 + 0.002  # its content, what refills it, and the forces under way
    assert sent.max() < 0.8 * 5.0
    shares = sent[BEGIN : BEGIN + 400] / expected("click", 5.0, 400)
    assert (np.diff(shares) < 1e-3).all()


def test_passive_scenes_bear_hundreds_of_pulses_in_a_row() -> None:
    """Pulses of every shape, with the largest force, one after the other. The last device takes more energy
    out of the hand than it declares, so that what the pulses do to it adds up."""
    drawn, many = [one.scene for one in passive_scenes(2, seed=3)], thorough.points(200, 400)
    for scene, seconds in (*((one, 0.004) for one in drawn), (hand_on_a_spring(200.0, friction_of_mock=3.0), 0.02)):
        most, count = scene.device.force_limit, 0
        with start(scene, judges_energy=True) as session:
            while count < many and not session.wait(0.0):
                name, *periods = (("click",), ("knock",), ("buzz", 1.0))[count % 3]
                with contextlib.suppress(UsageError):
                    session.pulse(0, name, 0.99 * (-most if count % 2 else most), seconds, *periods)
                    count += 1
        assert session.trace.report.ending == "stopped"
        assert count == many


def test_an_unstable_scene_is_stopped_during_pulses_too() -> None:
    for drawn in unstable_scenes(3, seed=5):
        with pytest.raises(GuardError) as stopped:
            pulsed(drawn.scene, 5.0, once(0, "buzz", 1.0, 4.9, 100.0, at=2), unstable=True)
        assert "hand" in str(stopped.value) or "limit" in str(stopped.value)


def test_the_force_limit_holds_for_the_sum() -> None:
    scene = hand_on_a_spring(2000.0)
    trace, _ = pulsed(scene, 0.2, once(0, "knock", -LIMIT, 0.02, at=12))
    assert trace.asked_force[12] < -0.15 * LIMIT
    assert np.abs(trace.force).max() == pytest.approx(LIMIT)


def test_the_slew_limit_and_the_soft_start_hold_during_a_pulse() -> None:
    scene = hand_on_a_spring(slew_limit=500.0, soft_start=0.2)
    trace, _ = pulsed(scene, 0.3, once(0, "knock", 8.0, 0.2, at=2))
    assert np.abs(np.diff(trace.force[:, 0])).max() <= 500.0 * 1.001e-3
    assert trace.force[5, 0] < 0.5 * 8.0


def test_outside_its_travel_a_pulse_fades_and_costs_what_is_left() -> None:
    """The hand comes to rest 3 mm outside, where the fade leaves a part."""
    scene = hand_on_a_spring(travel=[-0.05, 0.017])
    trace, session = pulsed(scene, 1.0, once(0, "click", -1.0, 0.01, at=900))
    assert 0.019 < trace.position[900, 0] < 0.021
    assert -0.6 < trace.force.min() < -0.05
    step, sent = np.diff(trace.position[:, 0]), trace.force[:, 0]
    assert float(session._loop.record.pulses.spent) == pytest.approx(float(np.sum(sent[:-2] * step[1:])), rel=0.05)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("begins", [None, BEGIN + 30], ids=["from arming", "during a pulse"])
def test_a_record_with_pulses_is_replayed_to_the_bit(tmp_path: Path, begins: int | None) -> None:
    path = tmp_path / "run.trace"

    def act(session: Session, sample: int) -> None:
        if sample == BEGIN:
            begin(session, 0, "buzz", 3.0, 0.9, 70.0)
        if sample == 940 and begins is None:
            begin(session, 0, "knock", -2.0, 0.05)
        if sample == BEGIN + 5:
            session.set({"touch": {"stiffness": 300.0}})

    scene = hand_on_a_spring(200.0)
    if begins is None:
        pulsed(scene, 1.0, act, record=path)
    else:

        def record(session: Session, sample: int) -> None:
            act(session, sample)
            if sample == begins:
                threading.Thread(target=session.record, args=(path,)).start()

        pulsed(scene, 1.0, record)
    found = compare(Record(path), None, None, with_curves=False)
    assert found.difference is None, found.difference and found.difference.what
    assert found.changes == (3 if begins is None else 0)


REFUSED = {
    "shape: found 'clik'": (0, "clik", 1.0, 0.01),
    "channel: found 1": (1, "click", 1.0, 0.01),
    "force: found 11": (0, "click", 11.0, 0.01),
    "force: found nan": (0, "click", math.nan, 0.01),
    "seconds: found 0,": (0, "click", 1.0, 0.0),
    "seconds: found 6": (0, "click", 1.0, 6.0),
    "seconds: found nan": (0, "click", 1.0, math.nan),
    "periods: found no periods of a buzz": (0, "buzz", 1.0, 0.1),
    "periods: found 3 of a click": (0, "click", 1.0, 0.1, 3.0),
    "periods: found 80": (0, "buzz", 1.0, 0.1, 80.0),
}


def test_what_no_loop_can_render_is_refused_with_its_reason() -> None:
    reasons: list[str] = []

    def act(session: Session, sample: int) -> None:
        if sample == BEGIN:
            for pulse in REFUSED.values():
                reasons.append(refusal(Session.pulse, session, *pulse))
            begin(session, 0, "click", 1.0, 0.05)
        if sample == BEGIN + 49:
            reasons.append(refusal(begin, session, 0, "click", 1.0, 0.05))
        if sample == BEGIN + 50:
            begin(session, 0, "click", 1.0, 0.05)

    trace, _ = pulsed(hand_on_a_spring(), 0.2, act)
    assert len(reasons) == len(REFUSED) + 1
    for expected_words, reason in zip([*REFUSED, "found 0, on which a pulse runs"], reasons, strict=True):
        assert expected_words in reason
    assert trace.force[:, 0].nonzero()[0].tolist() == [*range(BEGIN, BEGIN + 100)]


def refusal(act: Callable[..., Any], *arguments: Any) -> str:
    try:
        act(*arguments)
    except UsageError as error:
        return str(error)
    return "none"
