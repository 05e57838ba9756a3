"""The guard of the sign: a motor that is wired the wrong way is stopped and named, and a right one is not."""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Callable, Container
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop_rig import run_with_loop

from firmware_protocol.compiled import new_record
from firmware_protocol.description import Description
from hapsim.bringup.faults import Injector
from hapsim.bringup.faults.in_memory import in_memory
from hapsim.bringup.faults.injector import parse_script
from hapsim.compiling.native import address_of
from hapsim.errors import GuardError
from hapsim.loop.buffers import IO_BUFFER
from hapsim.loop.force_history import FORCE_HISTORY, history_hook, keep
from hapsim.loop.guards.sign import RELEASE_S, SIGN, judge_signs, watch_signs
from hapsim.loop.hooks import TICK
from hapsim.loop.ring import SLEWED
from hapsim.prediction.force_bounds import sign_warning, unjudged_motors
from hapsim.prediction.predict import predict
from hapsim.recording.trace import Trace
from hapsim.running import run
from hapsim.scene import Scene
from tests import one_hand

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools" / "bench"))

import sign as bench

T, MASS = 1e-3, 0.2
FIRM: dict[str, Any] = {"rate": 1000.0, "force_limit": 10.0, "mass": MASS}
_INVERTED = '{"version": 1, "faults": [{"kind": "invert", "direction": "to_device", "at": 0}]}'


def touch(**device: Any) -> Scene:
    """first_touch in virtual time."""
    mock = {"initial": {"velocity": 0.1}, "mass": MASS}
    return one_hand.scene_of({"touch": one_hand.touch(2000, 5)}, device=device, mock=mock)


def inverted(scene: Scene, **mock: Any) -> GuardError:
    """Returns the error that ends a run whose forces have the wrong sign."""
    scene = scene.model_copy(update={"mock": scene.mock.model_copy(update=mock) if scene.mock else None})
    between = in_memory(Injector(parse_script(_INVERTED)), scene.period)
    with pytest.raises(GuardError) as caught:
        run(scene, duration=0.4, between=between, judges_sign=True)
    return caught.value


def trace_of(error: GuardError) -> Trace:
    assert isinstance(error.trace, Trace)
    return error.trace


def test_an_inverted_motor_is_stopped_within_centimetres_and_named() -> None:
    error = inverted(touch())
    assert error.exit_status == 4
    assert "motor and position of channel 0 disagree in sign" in str(error)
    assert "Swap the motor's two wires; or reverse the encoder, if the position falls when the hand moves" in str(error)
    trace = trace_of(error)
    assert trace.report.ending == "sign wrong"
    assert np.abs(trace.position).max() < 0.01
    assert trace.report.sign_tests == 1


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("correction", ["poles", "predictor", "adaptive"])
def test_an_inverted_motor_is_stopped_whatever_corrects_the_force(correction: str) -> None:
    mass: Any = {"from": 0.1, "to": 0.4} if correction == "adaptive" else MASS
    trace = trace_of(inverted(touch(correction=correction, mass=mass)))
    assert trace.report.ending == "sign wrong"
    assert np.abs(trace.position).max() < 0.03


def test_a_test_of_the_sign_takes_the_force_away_no_faster_than_the_slew_limit() -> None:
    trace = trace_of(inverted(touch(slew_limit=1000.0, energy_limit=1.0)))
    tested = trace.flags & SLEWED > 0
    forces = trace.force[:, 0]
    assert np.abs(np.diff(forces)).max() <= 1.0 + 1e-9
    first = int(np.flatnonzero(tested)[0])
    assert tested[first:].all()
    np.testing.assert_allclose(
        np.abs(forces[first : first + 3]), np.maximum(abs(forces[first - 1]) - np.arange(1.0, 4.0), 0.0), atol=1e-6
    )
    assert not forces[first + 3 :].any()


def test_a_motor_that_is_right_is_judged_no_more_and_its_forces_are_as_without() -> None:
    trace, loop = run_with_loop(touch(), duration=0.3, judges_sign=True)
    assert (loop.record.sign.is_right[0], loop.record.sign.is_over) == (1, 1)
    assert trace.report.sign_tests == 0
    np.testing.assert_array_equal(trace.force_counts, run(touch(), duration=0.3).force_counts)


# The whole loop in simulated hands: tools/bench/sign.


def test_most_runaways_are_stopped_within_three_centimetres() -> None:
    found = bench.wrong(80, 5, scene=FIRM, motors=-1.0)
    assert found["runaways"] > 50
    assert found["of these within 3 cm"] > 0.75


def test_no_hand_makes_a_motor_that_is_right_look_wrong() -> None:
    found = bench.right(120, 5, scene=FIRM)
    assert sum(found["stopped"].values()) == 0
    assert found["tests"] > 0


def test_no_mechanical_stop_makes_a_motor_that_is_right_look_wrong() -> None:
    found = bench.right(80, 5, scene=FIRM, kinds=bench.AT_STOP)
    assert sum(found["stopped"].values()) == 0
    assert found["tests"] > 0


@pytest.mark.parametrize("wrong", [0, 1])
def test_the_channel_is_named(wrong: int) -> None:
    scene = bench.drawn_scene(random.Random(1), **FIRM, channels=2)
    motors = np.diag([-1.0, 1.0] if wrong == 0 else [1.0, -1.0])
    outcome = bench.Bench(scene).run(random.Random(1), "thrown", motors=motors)
    assert (outcome.ending, outcome.channel) == ("sign wrong", wrong)


# The guard alone, told of forces and positions.


class Alone:
    """The guard before one channel of 10 N, with forces in counts of a micronewton. `count`: m."""

    def __init__(self, rate_hz: float = 1.0 / T, *, count: float = 1e-6, mass: float = MASS) -> None:
        self.record, self.io, self._past, self._tick = map(new_record, (SIGN, IO_BUFFER, FORCE_HISTORY, TICK))
        self._tick.io, self._tick.history = address_of(self.io), address_of(self._past)
        self.io.channels, self.io.position_scale[0], self.io.force_scale[0], self.io.force_limit[0] = 1, count, 1e-6, 10
        self._kept = history_hook(self._past, delay=1.0, keeps_last_force=True)
        watch_signs(self.record, rate_hz=rate_hz, masses=[(mass, mass)])

    def takes(self, gap: int, late: bool = False) -> int:
        """Takes what `io` has; returns the code of the guard."""
        self._tick.gap, self._tick.late = gap, late
        keep(address_of(self._past), address_of(self._tick))
        return int(judge_signs(address_of(self.record), address_of(self._tick)))


def judged(
    side: float,
    *,
    stiffness: float = 2000.0,
    lost: Container[int] = (),
    late: Container[int] = (),
    push: Callable[[int, float], float] = lambda *_: 0.0,
    samples: int = 300,
    velocity: float = 0.1,
    wire: float = 1e-6,
    encoder: float = 0.0,
) -> tuple[int, int]:
    """(at which sample the motor is found wrong, or -1; how often it was tested) of a mass on a spring, whose motor
    makes `side` of a force. `lost`: positions that never arrive; `late`: forces that come too late to act; `push`: the
    hand's, N, by sample and position (m); `wire`, `encoder`: m per count there, 0: as fine as the wire's."""
    guard = Alone(count=wire)
    record, io = guard.record, guard.io
    x, v, acts, gap, in_time = 0.0, velocity, 0.0, 1, True
    for n in range(samples):
        answer = acts
        if n not in lost:
            force = 0.0 if 0 <= record.since[0] < record.release[0] else min(max(-stiffness * x, -10.0), 10.0)
            read = round(x / encoder) * encoder if encoder else x
            io.position_counts[0], io.force_counts[0] = round(read / wire), round(force * 1e6)
            if guard.takes(gap, late=not in_time):
                return n, int(record.tests)
            answer = force
        gap = gap + 1 if n in lost else 1
        acceleration = (side * acts + push(n, x)) / MASS
        x, v = x + T * v + 0.5 * T * T * acceleration, v + T * acceleration
        in_time = n not in lost and n not in late
        acts = answer if in_time else acts
    return -1, int(record.tests)


EVERY = frozenset(range(0, 300, 4))


@pytest.mark.parametrize(
    "fault", [{}, {"lost": EVERY}, {"late": EVERY}, {"lost": EVERY, "late": frozenset(range(2, 300, 7))}]
)
def test_lost_positions_and_late_forces_hide_no_wrong_motor(fault: dict[str, Any]) -> None:
    found, _ = judged(-1.0, **fault)
    assert 0 < found < 60
    assert judged(1.0, **fault) == (-1, 0)


def test_a_hand_that_swings_with_the_spring_s_own_rate_is_found_out_by_a_release() -> None:
    """It makes of the force just what a wrong motor would, until the force is gone."""

    def like_a_wrong_motor(_: int, x: float) -> float:
        return 4000.0 * x if abs(x) < 0.01 else 0.0

    found, tests = judged(1.0, push=like_a_wrong_motor, velocity=0.02)
    assert (found, tests > 0) == (-1, True)


def test_after_a_long_gap_the_sums_begin_anew_and_lost_positions_count_as_time() -> None:
    guard, kept, since = Alone(), [], []
    record = guard.record
    record.since[0] = 0  # a test has just begun
    for gap in (1, 1, 1, 1, 2, 3, 4, 1):
        guard.takes(gap)
        kept.append(int(record.kept[0]))
        since.append(int(record.since[0]))
    assert kept == [0, 0, 1, 2, 3, 4, 1, 2]
    assert since == [1, 2, 3, 4, 6, 9, 13, 14]


def test_below_a_tenth_of_the_force_limit_nothing_is_tested() -> None:
    assert judged(-1.0, velocity=1e-4, samples=60) == (-1, 0)


def test_a_release_lasts_for_its_time_where_nothing_comes_of_it() -> None:
    guard = Alone(2000.0)
    guard.takes(1)
    assert guard.record.release[0] == round(RELEASE_S * 2000.0) == 24


@pytest.mark.parametrize(
    ("count", "mass", "times"),
    [(1e-6, 0.2, 1.0), (16e-6, 0.2, 1.0), (1e-4, 0.2, 2.5), (1e-4, 0.8, 5.0), (4e-4, 0.2, 5.0)],
)
def test_all_times_are_longer_for_coarse_counts_and_heavy_hands(count: float, mass: float, times: float) -> None:
    guard = Alone(count=count, mass=mass)
    guard.takes(1)
    record = guard.record
    assert record.pole[0] == pytest.approx(math.exp(-1.0 / (2.0 * times)))
    assert record.forget[0] == pytest.approx(math.exp(-1.0 / (5.0 * times)))
    found = [int(record[name][0]) for name in ("least", "row", "release", "verdict")]
    np.testing.assert_allclose(found, np.array([7.0, 3.0, 12.0, 28.0]) * times, atol=0.5)


@pytest.mark.parametrize("count", [5e-5, 1e-4, 2e-4])
def test_a_wrong_motor_is_found_at_coarse_counts(count: float) -> None:
    found, tests = judged(-1.0, wire=count, velocity=0.3)
    assert (found > 0, tests) == (True, 1)
    assert judged(1.0, wire=count, velocity=0.3)[0] == -1


@pytest.mark.parametrize("encoder", [9e-5, 87.89e-6])
def test_a_bridge_that_sends_finer_counts_than_its_encoder_has_hides_no_wrong_motor(encoder: float) -> None:
    behind = judged(-1.0, wire=1e-7, encoder=encoder, velocity=0.3)
    assert behind[0] > 0
    assert behind == judged(-1.0, wire=encoder, velocity=0.3)


# Hands in the plane.


def in_plane(
    name: str, *, kinds: tuple[str, ...] = bench.USUAL, count: float = 1e-5, known: bool = False
) -> list[bench.Outcome]:
    scene = {**FIRM, "counts": (count,)}
    return list(bench.runs(40, 7, each=10, scene=scene, kinds=kinds, motors=bench.PAIRS[name], known=known))


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("x inverted", 0.8),
        ("both inverted", 0.95),
        ("exchanged", 0.75),
        ("turned by 90", 0.85),
        ("turned by -90", 0.85),
    ],
)
def test_most_faults_of_a_pair_are_stopped_within_centimetres(name: str, share: float) -> None:
    found = bench.found_of_forced(in_plane(name))
    assert found["forced"] > 25
    assert found["stopped of forced"] >= share
    assert found["m until stopped: median, 95 %, most"][0] < 0.02
    assert found["lost"] == 0


@pytest.mark.parametrize(("name", "share"), [("both inverted", 0.8), ("x inverted", 0.6)])
def test_a_pair_with_coarse_counts_is_stopped_too(name: str, share: float) -> None:
    found = bench.found_of_forced(in_plane(name, count=1e-4))
    assert found["stopped of forced"] > share
    assert found["m until stopped: median, 95 %, most"][1] < 0.12


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("kinds", [bench.USUAL, bench.VIOLENT])
def test_no_hand_makes_a_right_pair_look_wrong_and_tests_acquit_it(kinds: tuple[str, ...]) -> None:
    ended = in_plane("right", kinds=kinds)
    assert not any(one.is_found for one in ended)
    assert sum(one.tests for one in ended) > len(ended)


def test_a_pair_that_is_known_is_tested_on_suspicion_alone() -> None:
    usual, known = (sum(one.tests for one in in_plane("right", known=one)) for one in (False, True))
    assert known < 0.5 * usual
    assert bench.found_of_forced(in_plane("both inverted", known=True))["stopped of forced"] > 0.8
    record = new_record(SIGN)
    watch_signs(record, rate_hz=1000.0, masses=[(MASS, MASS)] * 4, known=(2, 3))
    assert record.plans[:4].tolist() == [1, 1, 0, 0]


def test_tests_in_every_sector_acquit_both_motors_of_a_pair() -> None:
    """A hand circles with force in every direction: after two tests in each of four sectors the guard has done."""
    rig = bench.Bench(bench.plane_scene(bench.FORMS[0], **FIRM, count=1e-6), bench.PLANE_S)
    acquitted = []
    for seed in range(8):
        outcome = rig.run(random.Random(seed), "circling")
        sign = rig.record.sign
        assert outcome.ending == "done"
        passed = sign.passed[:4]
        assert sign.is_over == (passed >= 2).all()
        assert sign.is_right[:2].tolist() == [sign.is_over] * 2
        acquitted.append(bool(sign.is_over))
    assert any(acquitted)


def test_a_thrown_handle_with_a_fine_encoder_is_not_taken_for_a_coarse_one() -> None:
    rig = bench.Bench(bench.drawn_scene(random.Random(3), **FIRM, count=1e-6))
    for seed in range(6):
        rig.run(random.Random(seed), "thrown")
        assert rig.record.sign.count[0] <= 8e-6


# What the guard cannot judge.


@pytest.mark.parametrize(
    ("changes", "mock", "reason"),
    [
        ({}, {}, ""),
        ({"rate": 499}, {}, "it samples at less than 500 Hz"),
        ({}, {"quantum": 1.0e-4}, ""),
        (
            {},
            {"quantum": 1.1e-4},
            "its positions have counts of 0.11 mm, more than 0.1 mm for this mass and force limit",
        ),
    ],
)
def test_reasons_by_channel_name_what_the_guard_cannot_judge(
    changes: dict[str, Any], mock: dict[str, Any], reason: str
) -> None:
    document = touch(force_limit=10.0).model_dump(exclude_unset=True, by_alias=True) | changes
    scene = Scene.model_validate(document | {"mock": {"mass": MASS, **mock}})
    assert unjudged_motors(scene) == (reason,)
    warning = sign_warning(scene, predict(scene, with_margins=False))
    assert reason in warning if reason else warning == ""


def test_a_device_s_own_counts_and_limit_decide_and_a_pair_is_never_judged_wholly() -> None:
    scene = touch(force_limit=10.0)
    device = Description("d", 1000.0, 1, 500, (1e-4, 1.0), (1e-3,) * 2, (10.0,) * 2)
    assert unjudged_motors(scene, device) == ("",)
    assert "more than 0.02 mm" in unjudged_motors(scene, replace(device, force_limit=(2.0,) * 2))[0]
    pair = bench.plane_scene(bench.FORMS[0], **FIRM, count=1e-6)
    assert unjudged_motors(pair) == ("in the plane, motors that are turned by 30° to 45° seem right",) * 2
    assert "--pair 0,1" in sign_warning(pair, predict(pair, with_margins=False))
